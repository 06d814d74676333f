"""The contract: every backend on every geometry; and the exact ones against analytic spectra."""

import pickle
from functools import cache

import numpy as np
import pytest
from conftest import GEOMETRIES, Backend, bumpy, creature
from scipy import sparse

from spectra_kit import (
    AmbientFourier,
    Arpack,
    ConvergenceError,
    Dense,
    InvalidSpectrumError,
    Laplacian,
    Lobpcg,
    Neo,
    PointCloud,
    RayleighRitz,
    Spectrum,
    TriangleMesh,
    Union,
    eigensolve,
    robust_laplacian,
)
from spectra_kit.eigensolvers import Eigenpairs, Eigensolver, NotConvergedError
from spectra_kit.geometry import rectangle, sphere, torus

K = 16


@cache
def once(laplacian: Laplacian, k: int, solver: Eigensolver) -> Spectrum:
    """Solve what several tests compare with."""
    return eigensolve(laplacian, k, solver)


def test_contract(backend: Backend, any_laplacian: Laplacian) -> None:
    s = eigensolve(any_laplacian, K, backend.solver)
    assert (s.n, s.k) == (any_laplacian.n, K)
    assert s.certificate.orthonormality_error < 1e-10
    assert s.certificate.relative_residuals.max() < backend.residual
    assert s.certificate.n_zero_modes == any_laplacian.kernel_dimension
    assert (s.eigenvectors[any_laplacian.fixed] == 0).all()
    assert s.residuals(any_laplacian) == pytest.approx(s.certificate.residuals)
    assert s.provenance.solver == repr(backend.solver)
    exact = once(any_laplacian, K, Dense()).eigenvalues
    # Ritz values lie above the true ones, by the square of the relative residual.
    assert (s.eigenvalues >= exact - 1e-9 * exact.max()).all()
    assert s.eigenvalues == pytest.approx(exact, rel=min(max(1e-8, backend.residual**2), 0.1))


def test_deterministic(backend: Backend, bumpy_laplacian: Laplacian) -> None:
    a, b = (f(bumpy_laplacian, K, backend.solver) for f in (once, eigensolve))
    assert np.array_equal(a.eigenvalues, b.eigenvalues)
    assert np.abs(a.eigenvectors - b.eigenvectors).max() < 1e-10


# Largest relative error of the first 15 non-zero eigenvalues; house figures times about 1.5.
ANALYTIC = [
    ("sphere 642", lambda: sphere(subdivisions=3), False, 2.1e-2),
    ("sphere 642 cloud", lambda: sphere(subdivisions=3), True, 2.1e-2),
    ("sphere 2562", lambda: sphere(subdivisions=4), False, 5.4e-3),
    ("rectangle 1000", lambda: rectangle(n=1000), False, 2.1e-2),
    ("rectangle 4000", lambda: rectangle(n=4000), False, 5.1e-3),
    ("torus 1800", lambda: torus(n=1800), False, 2.1e-2),
    ("torus 7200", lambda: torus(n=7200), False, 5.3e-3),
]


@pytest.mark.parametrize(
    ("name", "build", "cloud", "tolerance"), ANALYTIC, ids=[row[0] for row in ANALYTIC]
)
def test_analytic(exact_backend: Backend, name: str, build, cloud: bool, tolerance: float) -> None:
    reference = build()
    mesh = reference.geometry
    if mesh.n > 3000 and not isinstance(exact_backend.solver, Arpack):
        pytest.skip("the largest meshes are for Arpack alone; the contract ties the others to it")
    L = robust_laplacian(mesh.as_cloud() if cloud else mesh)
    values = eigensolve(L, K, exact_backend.solver).eigenvalues
    assert values[1:] == pytest.approx(reference.eigenvalues[1:K], rel=tolerance)


def test_dirichlet_rectangle() -> None:
    reference = rectangle(n=4000)
    L = robust_laplacian(reference.geometry).dirichlet(reference.geometry.boundary_vertices)
    s = eigensolve(L, K)
    assert s.eigenvalues == pytest.approx(reference.dirichlet[:K], rel=1.5e-2)
    assert s.certificate.n_zero_modes == 0


def test_second_order() -> None:
    """Eigenvalue errors fall as h^2."""
    errors = []
    for level in (2, 3, 4):
        reference = sphere(subdivisions=level)
        values = eigensolve(robust_laplacian(reference.geometry), K).eigenvalues
        errors.append(np.abs(values[1:] / reference.eigenvalues[1:K] - 1).max())
    assert np.polyfit([0, -1, -2], np.log2(errors), 1)[0] == pytest.approx(2, abs=0.1)


@pytest.mark.parametrize("scale", [1e-12, 1e12])
def test_arpack_is_exact_in_any_unit(scale: float) -> None:
    """ARPACK's own test of convergence is absolute for small Ritz values."""
    mesh = sphere(subdivisions=2).geometry
    s = eigensolve(robust_laplacian(mesh.with_points(scale * mesh.points)), 13)
    assert s.certificate.relative_residuals.max() < 1e-12


def test_rectangle_eigenfunctions() -> None:
    reference = rectangle(n=4000)
    s = eigensolve(robust_laplacian(reference.geometry), 10)
    cosines = np.einsum("ij,i,ij->j", s.eigenvectors, s.mass, reference.eigenfunctions[:, :10])
    assert np.abs(cosines) == pytest.approx(np.ones(10), abs=2e-3)


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_scale_law(backend: Backend, bumpy_laplacian: Laplacian, scale: float) -> None:
    mesh = bumpy()
    base = once(bumpy_laplacian, K, backend.solver)
    s = eigensolve(robust_laplacian(mesh.with_points(scale * mesh.points)), K, backend.solver)
    assert s.eigenvalues[1:] * scale**2 == pytest.approx(base.eigenvalues[1:], rel=1e-7)
    relative = s.certificate.relative_residuals
    if backend.residual < 1:
        assert relative.max() < backend.residual
    else:
        assert relative == pytest.approx(base.certificate.relative_residuals, rel=1e-4, abs=1e-8)


def test_rigid_motion_and_permutation(backend: Backend, bumpy_laplacian: Laplacian) -> None:
    mesh = bumpy()
    rng = np.random.default_rng(3)
    q = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    q[:, 0] *= np.linalg.det(q)
    order = rng.permutation(mesh.n)
    place = np.argsort(order)
    moved = TriangleMesh((mesh.points @ q + [3, -1, 2])[order], place[mesh.faces])
    base = once(bumpy_laplacian, K, backend.solver)
    s = eigensolve(robust_laplacian(moved), K, backend.solver)
    assert s.eigenvalues[1:] == pytest.approx(base.eigenvalues[1:], rel=backend.rounding)
    cosines = np.einsum("ij,i,ij->j", s.eigenvectors, s.mass, base.eigenvectors[order])
    assert np.abs(cosines) == pytest.approx(np.ones(K), abs=max(backend.rounding, 1e-5))


@pytest.mark.parametrize("copies", [2, 5])
def test_identical_components_give_every_mode_that_often(exact_backend, copies: int) -> None:
    one = bumpy()
    points = np.vstack([one.points + [4 * i, 0, 0] for i in range(copies)])
    faces = np.vstack([one.faces + i * one.n for i in range(copies)])
    single = eigensolve(robust_laplacian(one), 6).eigenvalues
    s = eigensolve(robust_laplacian(TriangleMesh(points, faces)), 6 * copies, exact_backend.solver)
    assert s.eigenvalues == pytest.approx(np.repeat(single, copies), rel=1e-8, abs=1e-9)
    assert s.n_zero_modes == copies


def test_a_small_component_that_owns_the_low_modes() -> None:
    """Weyl's guess by area is wrong on purpose: a long thin strip beside a large sphere."""
    strip = rectangle(n=400, width=30.0, height=0.3).geometry
    ball = sphere(subdivisions=2, radius=5.0).geometry
    points = np.vstack([ball.points, strip.points + [0, 20, 0]])
    mesh = TriangleMesh(points, np.vstack([ball.faces, strip.faces + ball.n]))
    L = robust_laplacian(mesh)
    assert eigensolve(L, 30).eigenvalues == pytest.approx(
        eigensolve(L, 30, Dense()).eigenvalues, rel=1e-8, abs=1e-9
    )
    # ... which the dense solve of the whole, not split into components, confirms.
    root = np.sqrt(L.mass)
    whole = np.linalg.eigvalsh(L.stiffness.toarray() / root / root[:, None])[:30]
    assert eigensolve(L, 30).eigenvalues == pytest.approx(whole, rel=1e-7, abs=1e-9)


@pytest.mark.parametrize("ratio", [1e-2, 1e-3, 1e-4, 1e-5])
def test_a_speck_beside_a_large_part(
    backend: Backend, bumpy_laplacian: Laplacian, ratio: float
) -> None:
    """Dust does not blur the zero modes or the certificate, however small it is."""
    one = bumpy_laplacian
    L = Laplacian(
        sparse.block_diag([one.stiffness, one.stiffness], format="csr"),
        np.r_[one.mass, ratio**2 * one.mass],
        np.vstack([one.points, ratio * one.points + 5]),
    )
    s = eigensolve(L, 6, backend.solver)
    alone = once(one, 5, backend.solver)
    assert s.n_zero_modes == 2
    assert s.eigenvalues[:2].tolist() == [0.0, 0.0]
    assert s.eigenvalues[1:] == pytest.approx(alone.eigenvalues, rel=max(backend.rounding, 1e-7))
    assert s.certificate.relative_residuals.max() < backend.residual
    assert s.certificate.orthonormality_error < 1e-10


def test_isolated_points_of_a_user_matrix() -> None:
    L = robust_laplacian(bumpy())
    n, lone = L.n, 700
    stiffness = sparse.block_diag([L.stiffness, sparse.csr_array((lone, lone))], format="csr")
    points = np.vstack([L.points, np.arange(3.0 * lone).reshape(-1, 3)])
    both = Laplacian(stiffness, np.r_[L.mass, np.ones(lone)], points)
    assert (both.n_components, both.kernel_dimension) == (lone + 1, lone + 1)
    s = eigensolve(both, lone + 4)
    assert s.n_zero_modes == lone + 1
    assert s.eigenvalues[lone + 1 :] == pytest.approx(eigensolve(L, 4).eigenvalues[1:], rel=1e-8)
    nothing = Laplacian(sparse.csr_array((1, 1)), [2.0], [[0, 0, 0]])
    assert eigensolve(nothing, 1).eigenvectors[0, 0] == pytest.approx(np.sqrt(0.5))
    assert n == 642


def test_very_different_strengths() -> None:
    L = robust_laplacian(bumpy())
    parts = [1e-12 * L.stiffness, 1e-12 * L.stiffness, L.stiffness]
    three = Laplacian(
        sparse.block_diag(parts, format="csr"), np.tile(L.mass, 3), np.tile(L.points, (3, 1))
    )
    s = eigensolve(three, 9)
    single = eigensolve(L, 5).eigenvalues
    assert s.n_zero_modes == 3
    assert s.eigenvalues[3:] == pytest.approx(1e-12 * np.repeat(single[1:4], 2), rel=1e-7)
    assert s.certificate.relative_residuals.max() < 1e-8


@pytest.mark.parametrize("k", [41, 42])
def test_nearly_and_exactly_all_modes(backend: Backend, k: int) -> None:
    L = robust_laplacian(sphere(subdivisions=1).geometry)
    assert L.n == 42
    s = eigensolve(L, k, backend.solver)
    assert s.certificate.relative_residuals.max() < 1e-8
    assert s.eigenvalues == pytest.approx(eigensolve(L, k, Dense()).eigenvalues, rel=1e-8, abs=1e-9)


class Lies:
    """Backends that break one promise each."""

    class Constant:
        def eigenpairs(self, laplacian, k):
            return np.arange(float(k)), np.ones((laplacian.n, k))

    class Few:
        def eigenpairs(self, laplacian, k):
            return np.zeros(k - 1), np.zeros((laplacian.n, k - 1))

    class Negative:
        def eigenpairs(self, laplacian, k):
            values, vectors = Dense().eigenpairs(laplacian, k)[:2]
            return values - 1, vectors

    class Nan:
        def eigenpairs(self, laplacian, k):
            return np.arange(float(k)), np.full((laplacian.n, k), np.nan)


@pytest.mark.parametrize(
    ("liar", "message"),
    [
        (Lies.Constant(), "not M-orthonormal"),
        (Lies.Few(), r"must return shapes \(4,\) and \(642, 4\)"),
        (Lies.Negative(), "returned a negative eigenvalue"),
        (Lies.Nan(), "`eigenvectors` must be finite"),
    ],
    ids=["constant", "few", "negative", "nan"],
)
def test_liars_are_caught(liar, message: str, bumpy_laplacian: Laplacian) -> None:
    with pytest.raises(InvalidSpectrumError, match=message):
        eigensolve(bumpy_laplacian, 4, liar)


def test_a_plain_function_of_a_user_is_a_backend(bumpy_laplacian: Laplacian) -> None:
    class Mine:
        def eigenpairs(self, laplacian, k):
            pairs = Dense().eigenpairs(laplacian, k)
            return pairs.eigenvalues[::-1], pairs.eigenvectors[:, ::-1]  # any order will do

    s = eigensolve(bumpy_laplacian, 5, Mine())
    assert s.eigenvalues == pytest.approx(eigensolve(bumpy_laplacian, 5).eigenvalues, abs=1e-9)


@pytest.mark.parametrize("solver", [Arpack(max_restarts=1), Lobpcg(max_steps=8)], ids=repr)
@pytest.mark.parametrize("name", ["bumpy", "two-parts"])
def test_no_convergence_keeps_what_converged(solver, name: str) -> None:
    L = GEOMETRIES[name]()
    with pytest.raises(ConvergenceError, match="raise max_") as caught:
        eigensolve(L, 60, solver)
    partial = caught.value.partial
    assert partial.k > 0
    assert partial.n == L.n
    assert partial.certificate.relative_residuals.max() < 1e-6
    assert partial.certificate.orthonormality_error < 1e-8


def test_no_convergence_keeps_the_components_solved_before() -> None:
    class OnlyOnce:
        """Solves one component and gives up on the next."""

        calls = 0

        def eigenpairs(self, laplacian, k):
            self.calls += 1
            if self.calls > 1:
                raise NotConvergedError("too tired", None)
            return Dense().eigenpairs(laplacian, k)

    L = GEOMETRIES["two-parts"]()
    with pytest.raises(ConvergenceError, match="too tired") as caught:
        eigensolve(L, 20, OnlyOnce())
    partial = caught.value.partial
    assert partial.n_zero_modes == 1
    first = eigensolve(L.restricted(np.flatnonzero(L.component_labels == 0)), partial.k)
    assert partial.eigenvalues == pytest.approx(first.eigenvalues, abs=1e-9)


def test_no_convergence_keeps_what_the_work_cost() -> None:
    class Tired:
        """Solves small components; of large ones it trusts one pair."""

        def eigenpairs(self, laplacian, k):
            values, vectors, *_ = Dense().eigenpairs(laplacian, k)
            if laplacian.n > 200:
                pairs = Eigenpairs(values[:1], vectors[:, :1], {"sweep": 2.0}, 7)
                raise NotConvergedError("too tired", pairs)
            return Eigenpairs(values, vectors, {"sweep": 1.0}, 4)

    for name, seconds, iterations in (("bumpy", 2.0, 7), ("two-parts", 3.0, 11)):
        with pytest.raises(ConvergenceError, match="too tired") as caught:
            eigensolve(GEOMETRIES[name](), 5, Tired())
        provenance = caught.value.partial.provenance
        assert provenance.iterations == iterations
        assert provenance.seconds["sweep"] == seconds


def test_convergence_error_without_any_pair(bumpy_laplacian: Laplacian) -> None:
    class Hopeless:
        def eigenpairs(self, laplacian, k):
            raise NotConvergedError("nothing at all", None)

    for laplacian in (bumpy_laplacian, GEOMETRIES["two-parts"]()):
        with pytest.raises(ConvergenceError, match="nothing at all") as caught:
            eigensolve(laplacian, 3, Hopeless())
        assert caught.value.partial is None


# --- Rayleigh-Ritz without weights -----------------------------------------------------------


def test_rayleigh_ritz_of_an_exact_span_is_exact(bumpy_laplacian: Laplacian) -> None:
    exact = eigensolve(bumpy_laplacian, 30)
    mixed = exact.eigenvectors @ np.random.default_rng(0).standard_normal((30, 30))
    s = eigensolve(bumpy_laplacian, 30, RayleighRitz(subspace=lambda points, mass: mixed))
    assert s.eigenvalues == pytest.approx(exact.eigenvalues, rel=1e-10, abs=1e-10)
    assert s.certificate.relative_residuals.max() < 1e-7


@pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulSpectrumWarning")
def test_a_larger_subspace_lowers_every_ritz_value(bumpy_laplacian: Laplacian) -> None:
    basis = AmbientFourier(m=200, bandwidth=4.0)(bumpy_laplacian.points, bumpy_laplacian.mass)
    values = [
        eigensolve(
            bumpy_laplacian, 20, RayleighRitz(subspace=lambda p, w, m=m: basis[:, :m])
        ).eigenvalues
        for m in (60, 120, 200)
    ]
    assert (values[0] >= values[1] - 1e-9).all()
    assert (values[1] >= values[2] - 1e-9).all()


def test_lobpcg_from_a_subspace_needs_fewer_steps(bumpy_laplacian: Laplacian) -> None:
    start = AmbientFourier(m=120, bandwidth=4.0)
    steps = 3
    warm = Lobpcg(rtol=1e-3, max_steps=steps, start=start)
    assert eigensolve(bumpy_laplacian, 10, warm).k == 10
    with pytest.raises(ConvergenceError):
        eigensolve(bumpy_laplacian, 10, Lobpcg(rtol=1e-3, max_steps=steps))


# --- other inputs ----------------------------------------------------------------------------


def test_user_matrices() -> None:
    """A path graph with unit weights: eigenvalues 2 - 2 cos(pi j / n)."""
    n = 60
    diagonal = np.r_[1.0, np.full(n - 2, 2.0), 1.0]
    off = -np.ones(n - 1)
    L = sparse.diags_array([off, diagonal, off], offsets=[-1, 0, 1])
    laplacian = Laplacian(sparse.csr_array(L), np.ones(n), np.c_[np.arange(n), np.zeros((n, 2))])
    expected = 2 - 2 * np.cos(np.pi * np.arange(8) / n)
    assert eigensolve(laplacian, 8).eigenvalues == pytest.approx(expected, abs=1e-12)


def test_potential_shifts_the_spectrum(bumpy_laplacian: Laplacian) -> None:
    L = bumpy_laplacian
    lifted = Laplacian(L.stiffness + 3.0 * sparse.diags_array(L.mass), L.mass, L.points)
    s = eigensolve(lifted, 8)
    assert s.eigenvalues == pytest.approx(eigensolve(L, 8).eigenvalues + 3.0, rel=1e-9)
    assert s.n_zero_modes == 0


def test_tiny_inputs() -> None:
    triangle = TriangleMesh(np.eye(3), [[0, 1, 2]])
    assert eigensolve(robust_laplacian(triangle), 3).n_zero_modes == 1
    assert eigensolve(robust_laplacian(triangle), 3, RayleighRitz()).k == 3
    square = PointCloud([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    assert eigensolve(robust_laplacian(square), 4).n_zero_modes == 1


# Extents from 0.8 to 502; open, closed and of three components; edges 4,000 times as long as others
# (hippo). A larger mesh, the bunny, is in test_geodesics_data.py.
REAL = [
    "3holes", "camelhead", "casting", "cheburashka", "cow", "fandisk", "hippo", "homer", "laurana",
    "plane", "spot", "teapot", "trim_star",
]  # fmt: skip


@pytest.mark.data
@pytest.mark.slow
def test_arpack_on_real_meshes(real_shapes) -> None:
    """Relative residuals of at most 1e-8 on real graphics models, in their own units."""
    worst = {}
    for name in REAL:
        with np.load(real_shapes / f"{name}.npz") as data:
            mesh = TriangleMesh(data["V"], data["F"]).without_unreferenced()
        L = robust_laplacian(mesh.without_degenerate_faces().without_unreferenced())
        s = eigensolve(L, 96)
        worst[name] = s.certificate.relative_residuals.max()
        assert s.certificate.n_zero_modes == L.kernel_dimension, name
    assert max(worst.values()) <= 1e-8, worst


# --- Neo, with the shipped weights -----------------------------------------------------------


def test_neo_predicts_each_component_on_its_own() -> None:
    """Two bodies far apart: the same modes as each alone, and two exact zeros."""
    a, b = creature(1200, seed=0), creature(1000, seed=1)
    points = np.vstack([a.points, b.points + [50.0, 3.0, 0.0]])
    both = robust_laplacian(TriangleMesh(points, np.vstack([a.faces, b.faces + a.n])))
    solver = Neo(poses=1)
    alone = [eigensolve(robust_laplacian(mesh), 20, solver).eigenvalues for mesh in (a, b)]
    s = eigensolve(both, 20, solver)
    assert s.n_zero_modes == 2
    expected = np.sort(np.concatenate(alone))[:20]
    assert s.eigenvalues == pytest.approx(expected, rel=1e-3, abs=1e-9)
    assert (s.eigenvectors[: a.n] == 0).all(axis=0).sum() + (s.eigenvectors[a.n :] == 0).all(
        axis=0
    ).sum() == 20


def test_more_poses_lower_every_ritz_value() -> None:
    laplacian = robust_laplacian(creature(1500, seed=0))
    exact = eigensolve(laplacian, 40).eigenvalues
    one, two, four = (
        eigensolve(laplacian, 40, Neo(poses=poses)).eigenvalues[1:] for poses in (1, 2, 4)
    )
    # Up to the rounding of float32 features, which differs between the three.
    assert (two <= one * (1 + 1e-4)).all()
    assert (four <= two * (1 + 1e-4)).all()
    assert (four >= exact[1:] * (1 - 1e-9)).all()
    error = [np.mean(values / exact[1:] - 1) for values in (one, two, four)]
    assert error[2] < 0.5 * error[0]


@pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulSpectrumWarning")
def test_neo_joined_with_plane_waves_beats_both() -> None:
    laplacian = robust_laplacian(creature(3000, seed=0))
    exact = eigensolve(laplacian, 60).eigenvalues[1:]
    waves, network = AmbientFourier(m=160, bandwidth=6.0), Neo(poses=1).subspace
    errors = {
        name: np.mean(
            eigensolve(laplacian, 60, RayleighRitz(subspace=subspace)).eigenvalues[1:] / exact - 1
        )
        for name, subspace in {
            "waves": waves,
            "neo": network,
            "both": Union(network, waves),
        }.items()
    }
    assert errors["both"] < 0.7 * min(errors["waves"], errors["neo"]), errors


def test_a_used_neo_pickles_small() -> None:
    """What travels to another process is the name of the weights, not the weights."""
    solver = Neo(poses=1)
    eigensolve(robust_laplacian(creature(1000, seed=0)), 4, solver)
    sent = pickle.dumps(solver)
    assert len(sent) < 1000
    assert repr(pickle.loads(sent)) == repr(solver)
