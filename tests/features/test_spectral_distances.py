"""Distances from a spectrum, and the points that they spread: closed forms and matrix algebra."""

import numpy as np
import pytest
from conftest import bumpy, two_parts
from scipy.linalg import expm
from scipy.special import spence
from test_descriptors import harmonics

from spectra_kit import Dense, Spectrum, cotan_laplacian, eigensolve
from spectra_kit.features import (
    biharmonic_distances,
    commute_time_distances,
    diffusion_distances,
    farthest_points,
)
from spectra_kit.geometry import rectangle, sphere, torus


@pytest.fixture(scope="module")
def complete():
    """All modes of a small mesh, with its matrices: sums over modes are then exact."""
    laplacian = cotan_laplacian(torus(n=60).geometry)
    return eigensolve(laplacian, laplacian.n, Dense()), laplacian


@pytest.fixture(scope="module")
def bumps():
    return eigensolve(cotan_laplacian(bumpy()), 40)


@pytest.fixture(scope="module")
def pair():
    laplacian = cotan_laplacian(two_parts())
    return eigensolve(laplacian, 30), laplacian.component_labels


def biharmonic_on_the_sphere(cosine):
    """Squared distance on the unit sphere; the sum over all modes is a dilogarithm."""
    return (np.pi**2 / 6 - spence((1 - cosine) / 2)) / (2 * np.pi)


def test_biharmonic_distance_of_the_sphere():
    degree = 80
    spectrum, cosine = harmonics(n=40, degree=degree, radius=2.0)
    found = biharmonic_distances(spectrum, range(40)) / 2.0
    left_out = 1 / (2 * np.pi * (degree + 1) ** 2)
    expected = biharmonic_on_the_sphere(np.clip(cosine, -1, 1))
    np.testing.assert_allclose(found**2, expected, atol=2 * left_out)


def test_diffusion_distances_are_those_of_heat_kernels(complete):
    spectrum, laplacian = complete
    generator = laplacian.stiffness.toarray() / laplacian.mass[:, None]
    root = np.sqrt(laplacian.mass)
    kernel = expm(-0.05 * generator) / laplacian.mass * root  # columns weighted by area
    expected = np.linalg.norm(kernel[:, None] - kernel[None], axis=2)
    np.testing.assert_allclose(
        diffusion_distances(spectrum, range(spectrum.n), time=0.05), expected, atol=1e-9
    )


def test_commute_times_are_resistances(complete):
    spectrum, laplacian = complete
    inverse = np.linalg.pinv(laplacian.stiffness.toarray())
    diagonal = np.diag(inverse)
    resistance = diagonal[:, None] + diagonal - 2 * inverse
    found = commute_time_distances(spectrum, range(spectrum.n))
    np.testing.assert_allclose(found**2, laplacian.area * resistance, atol=1e-9)


def test_biharmonic_distances_solve_two_poisson_problems(complete):
    spectrum, laplacian = complete
    n, mass = spectrum.n, laplacian.mass
    inverse = np.linalg.pinv(laplacian.stiffness.toarray())
    for x, y in [(0, 1), (0, n // 2), (3, n - 1)]:
        potential = inverse[x] - inverse[y]
        potential -= mass @ potential / mass.sum()
        found = biharmonic_distances(spectrum, [x])[0, y]
        assert found == pytest.approx(np.sqrt(mass @ potential**2), rel=1e-9)


def test_other_components_are_infinitely_far(pair):
    spectrum, labels = pair
    first, second = np.flatnonzero(labels == 0)[0], np.flatnonzero(labels == 1)[0]
    for distance in (biharmonic_distances, commute_time_distances):
        found = distance(spectrum, [second, first])
        np.testing.assert_array_equal(np.isfinite(found), labels == [[1], [0]])
    # Heat that never meets has a finite difference: the norms of both kernels, added in squares.
    assert np.isfinite(diffusion_distances(spectrum, [first], time=0.1)).all()


def test_each_component_has_its_own_commute_times():
    ball, torus_ = (
        eigensolve(laplacian, laplacian.n, Dense())
        for laplacian in (
            cotan_laplacian(sphere(subdivisions=1).geometry),
            cotan_laplacian(torus(n=60).geometry),
        )
    )
    values = np.concatenate([ball.eigenvalues, torus_.eigenvalues])
    order = np.argsort(values, kind="stable")
    vectors = np.zeros((len(values), len(values)))
    vectors[: ball.n, : ball.n] = ball.eigenvectors
    vectors[ball.n :, ball.n :] = torus_.eigenvectors
    mass = np.concatenate([ball.mass, torus_.mass])
    # Zero modes mixed, as a solver that sees one matrix returns them.
    turn = np.eye(len(values))
    turn[:2, :2] = [[0.6, -0.8], [0.8, 0.6]]
    both = Spectrum(values[order], vectors[:, order] @ turn, mass)
    for distance in (biharmonic_distances, commute_time_distances):
        together = distance(both, [0, ball.n])
        np.testing.assert_allclose(together[0, : ball.n], distance(ball, [0])[0], atol=1e-9)
        np.testing.assert_allclose(together[1, ball.n :], distance(torus_, [0])[0], atol=1e-9)


def test_distances_scale(bumps):
    big = bumps.rescale(10.0)
    for distance in (biharmonic_distances, commute_time_distances):
        np.testing.assert_allclose(distance(big, [3]), 10 * distance(bumps, [3]))


def test_fixed_points_are_one():
    mesh = rectangle(n=300).geometry
    laplacian = cotan_laplacian(mesh).dirichlet(mesh.boundary_vertices)
    spectrum = eigensolve(laplacian, 30)
    a, b = mesh.boundary_vertices[:2]
    assert spectrum.n_zero_modes == 0
    assert biharmonic_distances(spectrum, [a])[0, b] == 0
    assert np.isfinite(biharmonic_distances(spectrum, [a])).all()


def test_farthest_points_are_greedy(bumps):
    chosen = farthest_points(bumps, 12)
    d = biharmonic_distances(bumps, range(bumps.n))
    for i in range(1, 12):
        gap = d[chosen[:i]].min(axis=0)
        assert gap[chosen[i]] == pytest.approx(gap.max(), rel=1e-9)
    middle = np.sqrt(np.sum((bumps.eigenvectors[:, 1:] / bumps.eigenvalues[1:]) ** 2, axis=1))
    assert chosen[0] == middle.argmax()
    assert farthest_points(bumps, 3, start=7)[0] == 7
    np.testing.assert_array_equal(farthest_points(bumps, 5), chosen[:5])


def test_every_component_gets_a_point_first(pair):
    spectrum, labels = pair
    assert set(labels[farthest_points(spectrum, 2)]) == {0, 1}
    assert set(labels[farthest_points(spectrum, 2, start=0)]) == {0, 1}


def test_all_points_can_be_chosen(complete):
    spectrum, _ = complete
    assert sorted(farthest_points(spectrum, spectrum.n)) == list(range(spectrum.n))
    # Two modes map many points of the torus to one place: still each once.
    assert len(set(farthest_points(spectrum.truncate(2), spectrum.n))) == spectrum.n
