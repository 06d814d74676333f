"""ShapeDNA: laws of scaling, Weyl's law, and surfaces told apart."""

import numpy as np
import pytest
from conftest import bumpy

from spectra_kit import InvalidInputError, Spectrum, cotan_laplacian, eigensolve
from spectra_kit.descriptors import shape_dna, shape_dna_distance, shape_dna_distances
from spectra_kit.geometry import sphere


def exact_sphere(k, radius=1.0):
    """A spectrum with the exact eigenvalues of a sphere and its area, on one point."""
    values = sphere(subdivisions=0, radius=radius, k=k).eigenvalues
    return Spectrum(values, np.ones((1, k)), [4 * np.pi * radius**2])


@pytest.fixture(scope="module")
def bumps():
    return eigensolve(cotan_laplacian(bumpy()), 40)


def test_dna_of_the_sphere():
    ball = exact_sphere(16, radius=3.0)
    degree = np.repeat([1, 2, 3], [3, 5, 7])
    np.testing.assert_allclose(shape_dna(ball), 4 * np.pi * degree * (degree + 1))
    np.testing.assert_allclose(shape_dna(ball, normalize="first"), degree * (degree + 1) / 2)
    np.testing.assert_allclose(shape_dna(ball, normalize=None), degree * (degree + 1) / 9)
    np.testing.assert_array_equal(shape_dna(ball, 4), shape_dna(ball)[:4])


def test_weyls_law_finds_the_area():
    ball = exact_sphere(2500)
    ratio = shape_dna(ball, normalize="weyl") / shape_dna(ball)
    np.testing.assert_allclose(ratio, ratio[0])
    assert ratio[0] == pytest.approx(1, rel=2e-3)


def test_distances_by_their_formulas():
    a, b = np.array([1.0, 3.0, 4.0]), np.array([2.0, 3.5, 8.0])
    index = np.array([1, 2, 3])
    assert shape_dna_distance(a, b, weight=None) == pytest.approx(np.linalg.norm(a - b))
    assert shape_dna_distance(a, b) == pytest.approx(np.linalg.norm((a - b) / index))
    inverse = shape_dna_distance(a, b, weight="inverse")
    assert inverse == pytest.approx(np.linalg.norm((a - b) / (a * b)))


def test_the_matrix_holds_the_distances_of_all_pairs():
    rows = np.cumsum(np.random.default_rng(0).uniform(0.5, 2, (5, 12)), axis=1)
    for weight in ("index", "inverse", None):
        matrix = shape_dna_distances(rows, weight=weight)
        expected = [[shape_dna_distance(a, b, weight=weight) for a in rows] for b in rows]
        np.testing.assert_allclose(matrix, expected)
        np.testing.assert_array_equal(matrix, matrix.T)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: shape_dna(s, 0), r"`count` must be in \[1, 39\], got 0"),
        (lambda s: shape_dna(s, 40), r"`count` must be in \[1, 39\], got 40"),
        (lambda s: shape_dna(s.truncate(1)), "`spectrum` must have modes outside its kernel"),
        (lambda s: shape_dna(s, normalize="volume"), "must be 'area', 'weyl', 'first' or None"),
        (lambda s: shape_dna_distances([[1.0]], weight="weyl"), "must be 'index', 'inverse' or"),
        (lambda s: shape_dna_distances([1.0, 2.0]), r"must have shape \(s, count\).*got \(2,\)"),
        (lambda s: shape_dna_distances(np.ones((2, 0))), r"must have shape \(s, count\)"),
        (lambda s: shape_dna_distances([[1.0, 2.0], [1.0]]), "must have rows of one length"),
        (lambda s: shape_dna_distances([[0.0, 2.0]]), "must be positive, got 1 of 2 <= 0"),
        (lambda s: shape_dna_distances([[np.nan, 2.0]]), "`dnas` must be finite"),
        (lambda s: shape_dna_distance([1.0], [1.0, 2.0]), "`a` and `b` must have the same shape"),
        (lambda s: shape_dna_distance(["x"], [1.0]), "`a` must hold real numbers"),
    ],
)
def test_bad_input_is_refused(bumps, call, message):
    with pytest.raises(InvalidInputError, match=message):
        call(bumps)
