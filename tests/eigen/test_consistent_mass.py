"""A mass that is a matrix: linear elements as they are, others, and all that is proved."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from conftest import bumpy, creature, joined, refused, two_parts
from scipy import linalg, sparse

import spectra_kit as sk
from spectra_kit.eigen.metrics import compare_spectra
from spectra_kit.geometry import rectangle, sphere, torus

EXACT = [sk.Arpack(), sk.Lanczos(), sk.Dense(), sk.Refined(rtol=1e-10)]


@cache
def dense_values(laplacian: sk.Laplacian, k: int) -> np.ndarray:
    free = laplacian.free
    L, M = (
        a.toarray()[np.ix_(free, free)] for a in (laplacian.stiffness, laplacian.consistent_mass)
    )
    return linalg.eigh(L, M, eigvals_only=True, subset_by_index=(0, k - 1))


def held_rectangle() -> sk.Laplacian:
    mesh = rectangle(n=700).geometry
    return sk.laplacian(mesh, mass="consistent", boundary="dirichlet")


def quadratic() -> sk.Laplacian:
    """Of a unit square, by elements of second order: the sums of rows of corners vanish."""
    skfem = pytest.importorskip("skfem")
    from skfem.models.poisson import laplace, mass

    basis = skfem.Basis(skfem.MeshTri().refined(4), skfem.ElementTriP2())
    at = np.vstack([basis.doflocs, np.zeros(basis.N)]).T
    return sk.Laplacian(laplace.assemble(basis), mass.assemble(basis), at)


CASES = {
    "bumpy": lambda: sk.cotan_laplacian(bumpy(2562), mass="consistent"),
    "delaunay": lambda: sk.delaunay_laplacian(bumpy(), mass="consistent"),
    "cloud": lambda: sk.laplacian(bumpy().as_cloud(), mass="consistent"),
    "two parts": lambda: sk.laplacian(two_parts(), mass="consistent"),
    "boundary at zero": held_rectangle,
    "quadratic": quadratic,
}
made = cache(lambda case: CASES[case]())


@pytest.mark.parametrize("solver", EXACT, ids=repr)
@pytest.mark.parametrize("case", CASES)
def test_exact_solvers_agree_with_lapack(case: str, solver: sk.Dense) -> None:
    laplacian, k = made(case), 40
    truth = dense_values(laplacian, k)
    s = sk.eigensolve(laplacian, k, solver)
    assert s.eigenvalues == pytest.approx(truth, rel=1e-9, abs=1e-9 * truth[-1])
    assert s.certificate.level == "verified"
    assert s.certificate.n_zero_modes == laplacian.kernel_dimension
    U = s.eigenvectors
    assert np.abs(U.T @ (laplacian.consistent_mass @ U) - np.eye(k)).max() < 1e-10
    assert s.certificate.errors[s.certificate.bounded].max() < 1e-3  # k may cut a cluster


def test_lumped_and_consistent_are_on_either_side_and_converge() -> None:
    # A disk of radius 1: squares of the zeros of the derivatives of Bessel functions.
    from scipy.special import jnp_zeros

    truth = np.sort([*np.repeat([jnp_zeros(m, 1)[0] for m in (1, 2, 3)], 2), jnp_zeros(0, 1)[0]])
    errors, sizes = [], []
    for n in (1000, 4000, 16000):
        side = round(np.sqrt(n))
        u, v = (a.ravel() for a in np.indices((side, side)) / (side - 1) * 2 - 1)
        at = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()[:, None]
        faces = np.vstack([at + [0, side, 1], at + [1, side, side + 1]])
        points = np.column_stack([u * np.sqrt(1 - v**2 / 2), v * np.sqrt(1 - u**2 / 2), 0 * u])
        mesh = sk.TriangleMesh(points, faces).without_degenerate_faces()
        found = sk.eigensolve(sk.laplacian(mesh, mass="consistent"), 8).eigenvalues[1:]
        lumped = sk.eigensolve(sk.laplacian(mesh, operator="delaunay"), 8).eigenvalues[1:]
        assert (found > lumped).all()
        errors.append(np.abs(found / truth**2 - 1).max())
        sizes.append(1 / side)
    rate = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert 1.8 < rate < 2.2


@pytest.mark.parametrize(
    "mesh",
    [bumpy(), rectangle(n=500).geometry, torus(n=800).geometry, sphere(subdivisions=3).geometry],
    ids=["bumpy", "rectangle", "torus", "sphere"],
)
def test_numbers_of_lapy(mesh: sk.TriangleMesh) -> None:
    lapy = pytest.importorskip("lapy")
    theirs = lapy.Solver(lapy.TriaMesh(np.array(mesh.points), np.array(mesh.faces)), lump=False)
    laplacian = sk.cotan_laplacian(mesh, mass="consistent")
    # Their matrices are of float32, in which the modes of these are not theirs to 1e-10.
    assert abs(laplacian.consistent_mass - theirs.mass).max() < 1e-6 * abs(theirs.mass).max()
    A, B = (sparse.csr_array(a, dtype=np.float64) for a in (theirs.stiffness, theirs.mass))
    own = sk.eigensolve(sk.Laplacian((A + A.T) / 2, (B + B.T) / 2, mesh.points), 30)
    values = np.sort(theirs.eigs(30)[0])
    assert own.eigenvalues[1:] == pytest.approx(values[1:], rel=1e-10)


def test_any_positive_definite_mass() -> None:
    rng, laplacian = np.random.default_rng(0), sk.robust_laplacian(bumpy())
    links = sparse.random_array((642, 642), density=0.005, rng=rng)  # not those of the stiffness
    mass = sparse.csr_array(links @ links.T + 0.01 * sparse.diags_array(rng.uniform(1, 3, 642)))
    brought = sk.Laplacian(laplacian.stiffness, mass, laplacian.points)
    truth = dense_values(brought, 30)
    for solver in EXACT:
        s = sk.eigensolve(brought, 30, solver)
        assert s.eigenvalues == pytest.approx(truth, rel=1e-8, abs=1e-8 * truth[-1])
        assert s.certificate.n_verified >= 29
    alone = sk.eigensolve(laplacian.stiffness, 30, mass=mass)
    assert alone.eigenvalues == pytest.approx(truth, rel=1e-8, abs=1e-8 * truth[-1])


@pytest.mark.parametrize(
    "solver", [sk.Cascade(coarsest=200), sk.Neo(), sk.RayleighRitz(), sk.Automatic(accuracy=1e-2)]
)
def test_approximate_solvers_bound_from_above(solver: sk.Cascade) -> None:
    laplacian = made("delaunay")
    truth = dense_values(laplacian, 20)
    s = sk.eigensolve(laplacian, 20, solver)
    assert (s.eigenvalues >= truth - 1e-9 * truth[-1]).all()
    assert s.eigenvalues[1:] == pytest.approx(truth[1:], rel=0.1)
    assert s.certificate.orthonormality_error < 1e-10
    # Some true eigenvalue lies within each residual, in the M^-1 norm.
    apart = np.abs(s.eigenvalues[:, None] - dense_values(laplacian, 200)).min(axis=1)
    assert (apart <= s.certificate.residuals + 1e-9 * truth[-1]).all()


def test_a_count_finds_what_is_missing() -> None:
    laplacian = sk.cotan_laplacian(sphere(subdivisions=3).geometry, mass="consistent")
    s = sk.eigensolve(laplacian, 16)
    keep = [0, 1, *range(3, 16)]  # two of three equal ones
    gap = sk.Spectrum(s.eigenvalues[keep], s.eigenvectors[:, keep], laplacian.consistent_mass)
    assert sk.verify(s, laplacian).certificate.level == "verified"
    assert sk.verify(gap, laplacian).certificate.n_verified == 1
    assert sk.verify(gap, laplacian).certificate.count.missing >= 1


@pytest.mark.parametrize("unit", [1e-120, 1e-3, 1e120])
def test_units(unit: float) -> None:
    mesh = bumpy()
    scaled = sk.TriangleMesh(unit * mesh.points, mesh.faces)
    one, other = (
        sk.eigensolve(sk.cotan_laplacian(m, mass="consistent"), 12) for m in (mesh, scaled)
    )
    assert other.eigenvalues * unit**2 == pytest.approx(one.eigenvalues, rel=1e-10, abs=1e-12)
    assert other.orthonormality_error() < 1e-12
    moved = one.rescale(unit)
    assert moved.orthonormality_error() < 1e-12
    assert moved.eigenvalues == pytest.approx(other.eigenvalues, rel=1e-10, abs=1e-12 / unit**2)


def test_coefficients_files_and_copies(tmp_path) -> None:
    mesh = bumpy()
    laplacian = sk.cotan_laplacian(mesh, mass="consistent")
    s = sk.eigensolve(laplacian, 25)
    c = np.random.default_rng(0).standard_normal((25, 3))
    assert s.project(s.reconstruct(c)) == pytest.approx(c, abs=1e-12)
    assert s.project(s.reconstruct(c)[:, 0]) == pytest.approx(c[:, 0], abs=1e-12)
    s.save(tmp_path / "s.npz")
    for again in (sk.Spectrum.load(tmp_path / "s.npz", mmap=m) for m in (False, True)):
        assert (again.consistent_mass != s.consistent_mass).nnz == 0
        found = again.certify(laplacian).certificate.residuals
        assert np.array_equal(found, s.certificate.residuals)
    few = s.nonzero().truncate(5)
    assert few.consistent_mass is s.consistent_mass
    hash_of = sk.eigensolve(replace(laplacian, consistent_mass=None), 5).provenance.input_hash
    assert hash_of != s.provenance.input_hash


def test_many_at_once_are_as_one_by_one() -> None:
    laplacians = [
        sk.laplacian(m, mass="consistent") for m in (bumpy(), joined(bumpy(), bumpy(162)))
    ]
    for solver in (sk.Neo(), sk.Arpack()):
        for one, s in zip(laplacians, sk.eigensolve_many(laplacians, 12, solver), strict=True):
            assert s.eigenvalues == pytest.approx(sk.eigensolve(one, 12, solver).eigenvalues)


def test_what_is_refused() -> None:
    mesh = bumpy()
    laplacian, at = sk.cotan_laplacian(mesh, mass="consistent"), mesh.points
    L, M = laplacian.stiffness, laplacian.consistent_mass
    refused("mass", "be symmetric", sk.Laplacian, L, sparse.triu(M), at)
    refused("mass", "be positive definite", sk.Laplacian, L, -M, at)
    refused("mass", "have shape", sk.Laplacian, L, M[:5], at)
    lifted = sparse.lil_array(M)
    lifted[0, 5] = lifted[5, 0] = 10 * M.diagonal().max()
    refused("mass", "be positive definite", sk.eigensolve, sk.Laplacian(L, lifted.tocsr(), at), 4)
    refused("mass", "be lumped for 'knn'", sk.laplacian, mesh, operator="knn", mass="consistent")
    both = joined(mesh, mesh)
    pair = sk.cotan_laplacian(both, mass="consistent")
    across = sparse.lil_array(pair.consistent_mass)
    across[0, mesh.n] = across[mesh.n, 0] = 0.1 * M.diagonal().min()
    coupled = sk.Laplacian(pair.stiffness, across.tocsr(), both.points)
    refused("mass", "join no points of parts", sk.eigensolve, coupled, 4)
    bare = {"consistent_mass": sparse.diags_array(M.diagonal())}
    refused("consistent_mass", "be a matrix", sk.Laplacian, L, M.diagonal(), at, **bare)
    half = {"consistent_mass": sparse.triu(M)}
    refused("consistent_mass", "be symmetric", sk.Laplacian, L, M.diagonal(), at, **half)


def test_a_mass_may_join_what_the_stiffness_does_not() -> None:
    """Across a diagonal of right angles there is no weight: two free corners meet there alone."""
    side = 9
    i, j = (a.ravel() for a in np.indices((side, side)))
    first = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()[:, None]
    faces = np.vstack([first + [0, side, 1], first + [1, side, side + 1]])
    mesh = sk.TriangleMesh(np.column_stack([i, j, 0 * i]) / (side - 1), faces)
    free = [40, 48]  # ends of a diagonal of the triangles
    held = np.setdiff1d(np.arange(mesh.n), free)
    laplacian = sk.cotan_laplacian(mesh, mass="consistent").dirichlet(held)
    assert abs(laplacian.stiffness[*free]) < 1e-12 < laplacian.consistent_mass[*free]
    s = sk.eigensolve(laplacian, 2)
    assert s.eigenvalues == pytest.approx(dense_values(laplacian, 2), rel=1e-12)
    assert s.certificate.level == "verified"


def test_a_constant_potential_lifts_all_eigenvalues_by_as_much() -> None:
    laplacian = made("delaunay")
    lifted = sk.operators.schroedinger(laplacian, 3.0)
    values = sk.eigensolve(lifted, 12).eigenvalues
    assert values == pytest.approx(dense_values(laplacian, 12) + 3.0, abs=1e-9)


def test_maps_project_by_the_whole_mass() -> None:
    s = sk.eigensolve(sk.laplacian(creature(900), mass="consistent"), 40)
    refined = sk.maps.zoomout(s, s, np.eye(12), k_final=40)
    assert refined.functional_map == pytest.approx(np.eye(40), abs=1e-10)
    assert (refined.point_map == np.arange(s.n)).all()


def test_the_unit_of_each_point_does_not_matter() -> None:
    laplacian, rng = made("delaunay"), np.random.default_rng(0)
    unit = sparse.diags_array(10 ** rng.uniform(-3, 3, laplacian.n))
    both = (unit @ m @ unit for m in (laplacian.stiffness, laplacian.consistent_mass))
    found = sk.eigensolve(sk.Laplacian(*both, laplacian.points), 10, sk.Dense()).eigenvalues
    assert found == pytest.approx(dense_values(laplacian, 10), abs=1e-6)


def test_who_consumes_such_a_spectrum() -> None:
    mesh = sphere(subdivisions=4).geometry
    laplacian = sk.cotan_laplacian(mesh, mass="consistent")
    s = sk.eigensolve(laplacian, 50)
    found = compare_spectra(s, sk.eigensolve(laplacian, 49, sk.Lanczos(seed=3)))
    assert max(found.cluster_error.max(), found.span_error.max()) < 1e-12
    truth = np.arccos(np.clip(mesh.points @ mesh.points[0], -1, 1))
    plain, deflated = (
        sk.HeatGeodesics(mesh, spectrum=given).distance(0).distance for given in (None, s)
    )
    assert deflated == pytest.approx(plain, abs=1e-4)
    assert np.abs(plain - truth).max() < 0.05
    # Of a sphere, heat kernels are the same at all points.
    times = np.geomspace(0.1, 1, 4)
    heat = sk.features.heat_kernel_signature(s, times=times)
    exact = sum((2 * l + 1) * np.exp(-l * (l + 1) * times) for l in range(7)) / (4 * np.pi)
    assert heat == pytest.approx(np.tile(exact, (mesh.n, 1)), rel=0.01)


def test_equations_are_of_the_whole_mass() -> None:
    """In its own modes, heat decays and Poisson's equation is solved mode by mode, to rounding."""
    for laplacian in (made("delaunay"), made("boundary at zero")):
        s = sk.eigensolve(laplacian, 12)
        time = 0.3 / s.eigenvalues[5]
        later = sk.operators.diffuse(laplacian, s.eigenvectors, time)
        assert later == pytest.approx(np.exp(-time * s.eigenvalues) * s.eigenvectors, abs=1e-9)
        varying = s.nonzero()
        found = sk.operators.poisson(laplacian, varying.eigenvectors)
        assert found == pytest.approx(varying.eigenvectors / varying.eigenvalues, abs=1e-8)
