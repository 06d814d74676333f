"""The reference surfaces: exact spectra against formulas, laws, and discrete operators."""

import numpy as np
import pytest
from scipy.special import jv, jvp

from spectra_kit.eigensolvers import eigensolve
from spectra_kit.geometry.reference import _torus_eigenvalues, disk, rectangle, sphere, torus
from spectra_kit.operators import cotan_laplacian, robust_laplacian

MAKERS = [sphere, rectangle, disk, torus]


def euler_characteristic(mesh):
    return mesh.n - len(np.unique(mesh.edges, axis=0)) + len(mesh.faces)


def relative_error(values, exact):
    return np.abs(values[1:] / exact[1 : len(values)] - 1).max()


@pytest.mark.parametrize("make", MAKERS)
@pytest.mark.parametrize("k", [1, 7, 300])
def test_spectra_are_sorted_and_start_at_zero(make, k):
    reference = make(k=k)
    assert reference.eigenvalues.shape == (k,)
    assert reference.eigenvalues[0] == 0
    assert (np.diff(reference.eigenvalues) >= 0).all()
    assert reference.multiplicities.sum() == k
    assert not reference.eigenvalues.flags.writeable


@pytest.mark.parametrize("make", MAKERS)
def test_fewer_eigenvalues_are_the_first_of_more(make):
    np.testing.assert_allclose(make(k=20).eigenvalues, make(k=400).eigenvalues[:20], rtol=1e-9)


@pytest.mark.parametrize(
    ("make", "characteristic", "area"),
    [(sphere, 2, 4 * np.pi), (rectangle, 1, (1 + 5**0.5) / 2), (disk, 1, np.pi)],
)
def test_meshes_have_the_right_topology_and_area(make, characteristic, area):
    mesh = make().geometry
    assert euler_characteristic(mesh) == characteristic
    assert mesh.area == pytest.approx(area, rel=0.02)
    assert not mesh.component_labels.any()


def test_torus_mesh_is_a_torus():
    mesh = torus(n=7200).geometry
    assert euler_characteristic(mesh) == 0
    assert mesh.area == pytest.approx(4 * np.pi**2 * 0.4, rel=0.005)
    assert mesh.n == pytest.approx(7200, rel=0.05)


@pytest.mark.parametrize("make", [sphere, torus])
def test_closed_meshes_are_oriented_outwards(make):
    mesh = make().geometry
    assert len(mesh.boundary_vertices) == 0
    volume = np.linalg.det(mesh.points[mesh.faces]).sum() / 6
    assert volume > 0


@pytest.mark.parametrize("make", MAKERS)
def test_weyl_law_counts_the_eigenvalues(make):
    k = 2000
    reference = make(k=k)
    area = {"sphere": 4 * np.pi, "rectangle": (1 + 5**0.5) / 2, "disk": np.pi}.get(
        make.__name__, 4 * np.pi**2 * 0.4
    )
    boundary = {"rectangle": 2 + (1 + 5**0.5), "disk": 2 * np.pi}.get(make.__name__, 0.0)
    # Two terms: N(lambda) = area lambda / 4 pi +- length sqrt(lambda) / 4 pi (Ivrii 1980).
    top = reference.eigenvalues[-1]
    neumann = (area * top + boundary * top**0.5) / (4 * np.pi)
    assert neumann == pytest.approx(k, rel=0.02)
    if reference.dirichlet is not None:
        top = reference.dirichlet[-1]
        assert (area * top - boundary * top**0.5) / (4 * np.pi) == pytest.approx(k, rel=0.02)


def test_sphere_multiplicities_are_odd_numbers():
    reference = sphere(radius=2.0, k=121)
    np.testing.assert_array_equal(reference.multiplicities, 2 * np.arange(11) + 1)
    np.testing.assert_allclose(
        np.unique(reference.eigenvalues), [n * (n + 1) / 4 for n in range(11)]
    )


def test_golden_rectangle_is_simple_and_its_modes_are_orthonormal():
    reference = rectangle(n=20_000, k=30)
    assert (reference.multiplicities == 1).all()
    laplacian = cotan_laplacian(reference.geometry)
    modes = reference.eigenfunctions
    gram = modes.T @ (laplacian.mass[:, None] * modes)
    np.testing.assert_allclose(gram, np.eye(30), atol=1e-2)
    residual = laplacian.stiffness @ modes - laplacian.mass[:, None] * modes * reference.eigenvalues
    norms = np.sqrt((residual**2 / laplacian.mass[:, None]).sum(axis=0))
    assert (norms[1:] < 0.02 * reference.eigenvalues[1:]).all()


def test_computed_modes_of_the_rectangle_are_the_exact_ones():
    reference = rectangle(n=4000, k=12)
    spectrum = eigensolve(robust_laplacian(reference.geometry), 12)
    cosines = spectrum.eigenvectors.T @ (spectrum.mass[:, None] * reference.eigenfunctions)
    np.testing.assert_allclose(np.abs(cosines), np.eye(12), atol=5e-3)


def test_dirichlet_lies_above_neumann():
    for reference in (rectangle(), disk()):
        assert (reference.dirichlet > reference.eigenvalues).all()


def test_disk_eigenvalues_are_squares_of_bessel_zeros():
    reference = disk(radius=1.0, k=1000)
    for values, function in ((reference.eigenvalues[1:], jvp), (reference.dirichlet, jv)):
        roots = np.sqrt(np.unique(values.round(10)))
        orders = np.arange(80)
        smallest = np.abs(function(orders[:, None], roots)).min(axis=0)
        assert smallest.max() < 1e-9
    assert reference.dirichlet[0] == pytest.approx(2.404825557695773**2, rel=1e-12)
    assert reference.eigenvalues[1] == pytest.approx(1.841183781340659**2, rel=1e-12)


@pytest.mark.parametrize(("major", "minor"), [(1.0, 0.4), (1.0, 0.9), (2.0, 0.5)])
def test_torus_collocation_has_converged(major, minor):
    coarse = _torus_eigenvalues(major, minor, 100)
    fine = _torus_eigenvalues(major, minor, 100, refine=2)
    np.testing.assert_allclose(coarse[1:], fine[1:], rtol=1e-10)


def test_thin_torus_approaches_the_flat_one():
    # (a / major)^2 + (b / minor)^2, each sign of a and b once.
    values = torus(major=1.0, minor=0.01, k=40).eigenvalues
    a = np.arange(-20, 21)
    np.testing.assert_allclose(values, np.sort(a**2)[:40].astype(float), rtol=1e-3, atol=1e-9)


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


@pytest.mark.parametrize("operator", [robust_laplacian, cotan_laplacian])
@pytest.mark.parametrize(
    ("make", "sizes", "budget"),
    [
        (lambda n: sphere(subdivisions=n), (2, 3, 4), 6.2e-3),
        (lambda n: rectangle(n=n), (500, 1000, 4000), 5.1e-3),
        (lambda n: disk(rings=n), (9, 18, 36), 3.8e-3),
        (lambda n: torus(n=n), (900, 1800, 7200), 5.2e-3),
    ],
    ids=["sphere", "rectangle", "disk", "torus"],
)
def test_discrete_eigenvalues_converge_at_second_order(operator, make, sizes, budget):
    errors, lengths = [], []
    for size in sizes:
        reference = make(size)
        spectrum = eigensolve(operator(reference.geometry), 16)
        errors.append(relative_error(spectrum.eigenvalues, reference.eigenvalues))
        lengths.append(reference.geometry.n**-0.5)
    order = np.polyfit(np.log(lengths), np.log(errors), 1)[0]
    assert order == pytest.approx(2.0, abs=0.1)
    assert errors[-1] < budget


@pytest.mark.parametrize("make", [lambda: rectangle(n=4000), lambda: disk(rings=36)])
def test_discrete_dirichlet_eigenvalues(make):
    reference = make()
    laplacian = robust_laplacian(reference.geometry)
    fixed = laplacian.dirichlet(reference.geometry.boundary_vertices)
    values = eigensolve(fixed, 10).eigenvalues
    np.testing.assert_allclose(values, reference.dirichlet[:10], rtol=8e-3)
