"""The reference surfaces: exact spectra against formulas, laws, and discrete operators."""

import numpy as np
import pytest
from scipy.special import jv, jvp

from spectra_kit.eigen import eigensolve
from spectra_kit.geometry.reference import (
    Reference,
    _torus_eigenvalues,
    disk,
    rectangle,
    sphere,
    torus,
)
from spectra_kit.operators import cotan_laplacian, robust_laplacian

MAKERS = [sphere, rectangle, disk, torus]


def relative_error(values, exact):
    return np.abs(values[1:] / exact[1 : len(values)] - 1).max()


@pytest.mark.parametrize("make", MAKERS)
def test_spectra_are_sorted_start_at_zero_and_are_the_first_of_more(make):
    more = make(k=300)
    for k in (1, 7, 300):
        reference = make(k=k)
        assert reference.eigenvalues.shape == (k,)
        assert reference.eigenvalues[0] == 0
        assert (np.diff(reference.eigenvalues) >= 0).all()
        assert reference.multiplicities.sum() == k
        assert not reference.eigenvalues.flags.writeable
        np.testing.assert_allclose(reference.eigenvalues, more.eigenvalues[:k], rtol=1e-9)


def test_numbers_may_come_as_tuples():
    reference = Reference(sphere(k=1).geometry, (0.0, 2.0, 2.0, 2.0), "d", dirichlet=(1.0, 2.0))
    assert reference.multiplicities.tolist() == [1, 3]
    assert not reference.eigenvalues.flags.writeable
    assert not reference.dirichlet.flags.writeable


@pytest.mark.parametrize(
    ("make", "characteristic", "area", "rim"),
    [
        (sphere, 2, 4 * np.pi, 0),
        (rectangle, 1, (1 + 5**0.5) / 2, 3 + 5**0.5),
        (disk, 1, np.pi, 2 * np.pi),
        (lambda **k: torus(n=7200, **k), 0, 4 * np.pi**2 * 0.4, 0),
    ],
    ids=["sphere", "rectangle", "disk", "torus"],
)
def test_meshes_and_weyls_law(make, characteristic, area, rim):
    k = 1000
    reference = make(k=k)
    mesh = reference.geometry
    assert mesh.n - len(mesh.unique_edges[0]) + len(mesh.faces) == characteristic
    assert mesh.area == pytest.approx(area, rel=0.02)
    assert not mesh.component_labels.any()
    if not rim:
        assert len(mesh.boundary_vertices) == 0
        assert np.linalg.det(mesh.points[mesh.faces]).sum() > 0  # oriented outwards
    # Two terms: N(lambda) = area lambda / 4 pi +- length sqrt(lambda) / 4 pi (Ivrii 1980).
    for values, sign in ((reference.eigenvalues, 1), (reference.dirichlet, -1)):
        if values is not None:
            top = values[-1]
            assert (area * top + sign * rim * top**0.5) / (4 * np.pi) == pytest.approx(k, rel=0.03)
    if rim:
        assert (reference.dirichlet > reference.eigenvalues).all()


def test_golden_rectangle_is_simple_and_its_modes_are_those_computed():
    reference = rectangle(n=4000, k=12)
    assert (reference.multiplicities == 1).all()
    spectrum = eigensolve(robust_laplacian(reference.geometry), 12)
    cosines = spectrum.eigenvectors.T @ (spectrum.mass[:, None] * reference.eigenfunctions)
    np.testing.assert_allclose(np.abs(cosines), np.eye(12), atol=5e-3)


def test_disk_eigenvalues_are_squares_of_bessel_zeros():
    reference = disk(radius=1.0, k=1000)
    for values, function in ((reference.eigenvalues[1:], jvp), (reference.dirichlet, jv)):
        roots = np.sqrt(np.unique(values.round(10)))
        orders = np.arange(80)
        smallest = np.abs(function(orders[:, None], roots)).min(axis=0)
        assert smallest.max() < 1e-9
    assert reference.dirichlet[0] == pytest.approx(2.404825557695773**2, rel=1e-12)
    assert reference.eigenvalues[1] == pytest.approx(1.841183781340659**2, rel=1e-12)


@pytest.mark.parametrize(("major", "minor"), [(1.0, 0.9), (2.0, 0.5)])
def test_torus_collocation_has_converged(major, minor):
    coarse = _torus_eigenvalues(major, minor, 100)
    fine = _torus_eigenvalues(major, minor, 100, refine=2)
    np.testing.assert_allclose(coarse[1:], fine[1:], rtol=1e-10)


@pytest.mark.parametrize(
    ("make", "factor"),
    [
        (lambda s: sphere(radius=s), 10.0),
        (lambda s: rectangle(width=s, height=1.6 * s), 1000.0),
        (lambda s: disk(radius=s), 1e-3),
        (lambda s: torus(major=s, minor=0.3 * s), 7.0),
    ],
)
def test_scale_law(make, factor):
    unit, scaled = make(1.0), make(factor)
    np.testing.assert_allclose(scaled.eigenvalues * factor**2, unit.eigenvalues, rtol=1e-9)
    np.testing.assert_allclose(scaled.geometry.points, factor * unit.geometry.points, rtol=1e-12)


@pytest.mark.parametrize(
    ("make", "operator", "sizes", "budget"),
    [
        (lambda n: sphere(subdivisions=n), robust_laplacian, (2, 3, 4), 6.2e-3),
        (lambda n: rectangle(n=n), cotan_laplacian, (500, 1000, 4000), 5.1e-3),
        (lambda n: disk(rings=n), robust_laplacian, (9, 18, 36), 3.8e-3),
        (lambda n: torus(n=n), cotan_laplacian, (900, 1800, 7200), 5.2e-3),
    ],
    ids=["sphere", "rectangle", "disk", "torus"],
)
def test_discrete_eigenvalues_converge_at_second_order(make, operator, sizes, budget):
    references = [make(size) for size in sizes]
    operators = [operator(reference.geometry) for reference in references]
    errors = [
        relative_error(eigensolve(L, 16).eigenvalues, reference.eigenvalues)
        for L, reference in zip(operators, references, strict=True)
    ]
    order = np.polyfit(np.log([L.n**-0.5 for L in operators]), np.log(errors), 1)[0]
    assert order == pytest.approx(2.0, abs=0.1)
    assert errors[-1] < budget
    if references[-1].dirichlet is not None:
        fixed = operators[-1].dirichlet(references[-1].geometry.boundary_vertices)
        values = eigensolve(fixed, 10).eigenvalues
        np.testing.assert_allclose(values, references[-1].dirichlet[:10], rtol=8e-3)
