"""The contract: every backend on every geometry; and the exact ones against analytic spectra."""

import pickle
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from conftest import Backend, bumpy, creature, joined, moved, refused, two_parts, whole_spectrum
from scipy import sparse

import spectra_kit as sk
from spectra_kit._sparse import _degree_kernels
from spectra_kit.eigen import Eigenpairs, Eigensolver, NotConvergedError
from spectra_kit.geometry import rectangle, sphere, torus

K = 16


@cache
def once(laplacian: sk.Laplacian, k: int, solver: Eigensolver) -> sk.Spectrum:
    """Solve what several tests compare with."""
    return sk.eigensolve(laplacian, k, solver)


def test_contract(backend: Backend, any_laplacian: sk.Laplacian) -> None:
    s = sk.eigensolve(any_laplacian, K, backend.solver)
    assert (s.n, s.k) == (any_laplacian.n, K)
    assert s.certificate.orthonormality_error < 1e-10
    assert s.certificate.relative_residuals.max() < backend.residual
    assert s.certificate.n_zero_modes == any_laplacian.kernel_dimension
    assert (s.eigenvectors[any_laplacian.fixed] == 0).all()
    assert s.residuals(any_laplacian) == pytest.approx(s.certificate.residuals)
    other = s.provenance.solver != repr(backend.solver)  # chosen, or blocks have no room here
    assert not other or isinstance(backend.solver, sk.Automatic | sk.Lanczos)
    assert bool(s.provenance.reason) == other or "of 2 components" in s.provenance.reason
    exact = once(any_laplacian, K, sk.Dense()).eigenvalues
    # Ritz values lie above the true ones, by the square of the relative residual.
    assert (s.eigenvalues >= exact - 1e-9 * exact.max()).all()
    assert s.eigenvalues == pytest.approx(exact, rel=min(max(1e-8, backend.residual**2), 0.1))


def test_rigid_motion_scale_and_permutation(
    backend: Backend, bumpy_laplacian: sk.Laplacian
) -> None:
    mesh = bumpy()
    rng = np.random.default_rng(3)
    q = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    q[:, 0] *= np.linalg.det(q)
    order = rng.permutation(mesh.n)
    place = np.argsort(order)
    other = sk.TriangleMesh(1e3 * (mesh.points @ q + [3, -1, 2])[order], place[mesh.faces])
    base = sk.eigensolve(bumpy_laplacian, K, backend.solver)
    s = sk.eigensolve(sk.robust_laplacian(other), K, backend.solver)
    assert 1e6 * s.eigenvalues[1:] == pytest.approx(base.eigenvalues[1:], rel=backend.rounding)
    cosines = 1e3 * np.einsum(
        "ij,i,ij->j", s.eigenvectors, base.mass[order], base.eigenvectors[order]
    )
    assert np.abs(cosines) == pytest.approx(np.ones(K), abs=max(backend.rounding, 1e-5))


def test_analytic() -> None:
    """The first 15 non-zero eigenvalues, of a cloud and a mesh; house figures times about 1.5."""
    ball, ring = sphere(subdivisions=3), torus(n=1800)
    for reference, geometry in ((ball, ball.geometry.as_cloud()), (ring, ring.geometry)):
        values = sk.eigensolve(sk.robust_laplacian(geometry), K).eigenvalues
        assert values[1:] == pytest.approx(reference.eigenvalues[1:K], rel=2.1e-2)


def test_analytic_modes_and_fixed_points() -> None:
    reference = rectangle(n=4000)
    L = sk.robust_laplacian(reference.geometry)
    s = sk.eigensolve(L, 10)
    assert s.eigenvalues[1:] == pytest.approx(reference.eigenvalues[1:10], rel=4e-3)
    cosines = np.einsum("ij,i,ij->j", s.eigenvectors, s.mass, reference.eigenfunctions[:, :10])
    assert np.abs(cosines) == pytest.approx(np.ones(10), abs=2e-3)
    held = sk.eigensolve(L.dirichlet(reference.geometry.boundary_vertices), K)
    assert held.eigenvalues == pytest.approx(reference.dirichlet[:K], rel=1.5e-2)
    assert held.certificate.n_zero_modes == 0


def test_second_order() -> None:
    """Eigenvalue errors fall as h^2."""
    errors = []
    for level in (2, 3, 4):
        reference = sphere(subdivisions=level)
        values = sk.eigensolve(sk.robust_laplacian(reference.geometry), K).eigenvalues
        errors.append(np.abs(values[1:] / reference.eigenvalues[1:K] - 1).max())
    assert errors[2] < 5.4e-3
    assert np.polyfit([0, -1, -2], np.log2(errors), 1)[0] == pytest.approx(2, abs=0.1)


WAVES = sk.eigen.subspaces.AmbientFourier(m=90, bandwidth=4.0)
OTHERWISE = [
    (sk.Arpack(), {"tol": 1e-3, "shift": 1.0, "seed": 1}),
    (sk.Refined(), {"rtol": 1e-3, "guard": 1.0, "seed": 1, "start": WAVES, "degree": 3}),
    (
        sk.Cascade(coarsest=200, target=0.1),
        {"coarsest": 150, "target": 1e-6, "subspace": WAVES, "guard": 1.0, "max_steps": 0},
    ),
    (sk.Cascade(coarsest=200, subspace=WAVES), {"rank_tol": 1e-2}),
    (sk.Cascade(coarsest=600), {"seed": 1}),  # so few points are refined
    (sk.RayleighRitz(subspace=WAVES), {"rank_tol": 1e-2}),
    (
        sk.Neo(coarsest=200),
        {"coarsest": 300, "max_steps": 0, "target": 1e-7, "dtype": "bfloat16", "poses": 2},
    ),
]


@pytest.mark.parametrize(("solver", "options"), OTHERWISE, ids=lambda o: type(o).__name__)
@pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulSpectrumWarning")
def test_every_option_is_heeded(bumpy_laplacian: sk.Laplacian, solver, options) -> None:
    """The same bits from the same options, others from others; if exact, of the same modes."""
    assert (sk.Arpack().promise, sk.Arpack(tol=1e-3).promise) == ("exact", "to tolerance")
    laplacian = bumpy_laplacian
    one, same = (sk.eigensolve(laplacian, K, solver) for _ in range(2))
    assert np.array_equal(one.eigenvectors, same.eigenvectors)
    for name, value in options.items():
        other = sk.eigensolve(laplacian, K, replace(solver, **{name: value}))
        assert not np.array_equal(one.eigenvectors, other.eigenvectors), name
        if solver.promise != "approximate":
            assert other.eigenvalues == pytest.approx(one.eigenvalues, rel=1e-4)


def test_a_small_component_that_owns_the_low_modes() -> None:
    """Weyl's guess by area is wrong on purpose: a long thin strip beside a large sphere."""
    strip = rectangle(n=400, width=30.0, height=0.3).geometry
    ball = sphere(subdivisions=2, radius=5.0).geometry
    L = sk.robust_laplacian(joined(ball, moved(strip, 0, 20, 0)))
    whole = whole_spectrum(L)[0][:30]  # not split into components
    assert sk.eigensolve(L, 30).eigenvalues == pytest.approx(whole, rel=1e-7, abs=1e-9)


@pytest.mark.parametrize("solver", [sk.Arpack(), sk.Neo()], ids=repr)
def test_a_speck_beside_a_large_part(bumpy_laplacian: sk.Laplacian, solver) -> None:
    """Dust does not blur the zero modes or the certificate, however small it is."""
    one, ratio = bumpy_laplacian, 1e-5
    L = sk.Laplacian(
        sparse.block_diag([one.stiffness, one.stiffness], format="csr"),
        np.r_[one.mass, ratio**2 * one.mass],
        np.vstack([one.points, ratio * one.points + 5]),
    )
    s, alone = sk.eigensolve(L, 6, solver), once(one, 5, solver)
    assert s.n_zero_modes == 2
    assert s.eigenvalues[:2].tolist() == [0.0, 0.0]
    assert s.eigenvalues[1:] == pytest.approx(
        alone.eigenvalues, rel=1e-3 if solver == sk.Neo() else 1e-7
    )
    assert s.certificate.orthonormality_error < 1e-10


def test_isolated_points_of_a_user_matrix(bumpy_laplacian: sk.Laplacian) -> None:
    L, lone = bumpy_laplacian, 700
    stiffness = sparse.block_diag([L.stiffness, sparse.csr_array((lone, lone))], format="csr")
    points = np.vstack([L.points, np.arange(3.0 * lone).reshape(-1, 3)])
    both = sk.Laplacian(stiffness, np.r_[L.mass, np.ones(lone)], points)
    assert (both.n_components, both.kernel_dimension) == (lone + 1, lone + 1)
    s = sk.eigensolve(both, lone + 4)
    assert s.n_zero_modes == lone + 1
    assert s.eigenvalues[lone + 1 :] == pytest.approx(sk.eigensolve(L, 4).eigenvalues[1:], rel=1e-8)
    nothing = sk.Laplacian(sparse.csr_array((1, 1)), [2.0], [[0, 0, 0]])
    assert sk.eigensolve(nothing, 1).eigenvectors[0, 0] == pytest.approx(np.sqrt(0.5))


@pytest.mark.parametrize("k", [41, 42])
def test_nearly_and_exactly_all_modes(backend: Backend, k: int) -> None:
    L = sk.robust_laplacian(sphere(subdivisions=1).geometry)
    s = sk.eigensolve(L, k, backend.solver)
    assert s.certificate.relative_residuals.max() < 1e-8
    assert s.eigenvalues == pytest.approx(whole_spectrum(L)[0][:k], rel=1e-8, abs=1e-9)


class Changed:
    """A backend that answers with what becomes of the right pairs."""

    def __init__(self, change) -> None:
        self.change = change

    def eigenpairs(self, laplacian, k):
        return self.change(*sk.Dense().eigenpairs(laplacian, k)[:2])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda values, vectors: (values, np.ones_like(vectors)), "not M-orthonormal"),
        (lambda values, vectors: (values[1:], vectors[:, 1:]), r"must return shapes \(4,\) and"),
        (lambda values, vectors: (values - 1, vectors), "returned a negative eigenvalue"),
        (lambda values, vectors: (values, np.nan * vectors), "`eigenvectors` must be finite"),
        (lambda values, vectors: (values, 1j * vectors), "must return real numbers"),
    ],
)
def test_liars_are_caught(change, message: str, bumpy_laplacian: sk.Laplacian) -> None:
    with pytest.raises(sk.errors.InvalidSpectrumError, match=message):
        sk.eigensolve(bumpy_laplacian, 4, Changed(change))


def test_a_plain_class_of_a_user_is_a_backend(bumpy_laplacian: sk.Laplacian) -> None:
    mine = Changed(lambda values, vectors: (values[::-1], vectors[:, ::-1]))  # any order will do
    s = sk.eigensolve(bumpy_laplacian, 5, mine)
    assert s.eigenvalues == pytest.approx(sk.eigensolve(bumpy_laplacian, 5).eigenvalues, abs=1e-9)


@pytest.mark.parametrize("solver", ["automatic", "arpack", "dense", "refined"])
def test_matrices_of_scipy_and_solvers_by_name(any_laplacian: sk.Laplacian, solver: str) -> None:
    L = any_laplacian.restricted(any_laplacian.free)
    exact = once(any_laplacian, K, sk.Dense()).eigenvalues
    for mass in (L.mass, sparse.diags(L.mass), sparse.csr_array(sparse.diags_array(L.mass))):
        found = sk.eigensolve(L.stiffness, K, solver, mass=mass)
        assert found.eigenvalues == pytest.approx(exact, rel=1e-8, abs=1e-9)
        assert found.certificate.level == "verified"


def test_what_matrices_lack(bumpy_laplacian: sk.Laplacian) -> None:
    L, M = bumpy_laplacian.stiffness, bumpy_laplacian.mass
    refused("laplacian", "be a Laplacian, or a matrix with its mass", sk.eigensolve, L, 4)
    refused("mass", "be left out", sk.eigensolve, bumpy_laplacian, 4, mass=M)
    refused("mass", "be positive definite", sk.eigensolve, L, 4, mass=L)
    refused("solver", "be an exact one", sk.eigensolve, L, 4, "cascade", mass=M)
    refused("solver", "be an Eigensolver, got 'apack'", sk.eigensolve, L, 4, "apack", mass=M)


@pytest.mark.parametrize("mesh", [bumpy(), two_parts()])
def test_no_convergence_keeps_what_converged(mesh: sk.TriangleMesh) -> None:
    with pytest.raises(sk.errors.ConvergenceError, match="raise max_") as caught:
        sk.eigensolve(sk.robust_laplacian(mesh), 60, sk.Arpack(max_restarts=1))
    partial = caught.value.partial
    assert partial.k > 0
    assert partial.n == mesh.n
    assert partial.certificate.relative_residuals.max() < 1e-6
    assert partial.certificate.orthonormality_error < 1e-8


def test_no_convergence_keeps_the_components_solved_before_and_what_they_cost() -> None:
    class Tired:
        """Solves small components; of large ones it trusts one pair, or none."""

        def __init__(self, trusted: int) -> None:
            self.trusted = slice(trusted)

        def eigenpairs(self, laplacian, k):
            values, vectors, *_ = sk.Dense().eigenpairs(laplacian, k)
            if laplacian.n > 200:
                few = Eigenpairs(values[self.trusted], vectors[:, self.trusted], {"sweep": 2.0}, 7)
                raise NotConvergedError("too tired", few if self.trusted.stop else None)
            return Eigenpairs(values, vectors, {"sweep": 1.0}, 4)

    def partial(mesh: sk.TriangleMesh, trusted: int) -> sk.Spectrum | None:
        with pytest.raises(sk.errors.ConvergenceError, match="too tired") as caught:
            sk.eigensolve(sk.robust_laplacian(mesh), 5, Tired(trusted))
        return caught.value.partial

    for mesh, seconds, iterations in ((bumpy(), 2.0, 7), (two_parts(), 3.0, 11)):
        provenance = partial(mesh, 1).provenance
        assert (provenance.iterations, provenance.seconds["sweep"]) == (iterations, seconds)
    assert partial(bumpy(), 0) is None
    small = partial(two_parts(), 0)  # the modes of the ball alone
    assert small.n_zero_modes == 1
    alone = sk.eigensolve(sk.robust_laplacian(sphere(subdivisions=2).geometry), small.k)
    assert small.eigenvalues == pytest.approx(alone.eigenvalues, abs=1e-9)


def test_user_matrices(bumpy_laplacian: sk.Laplacian) -> None:
    """A path graph with unit weights: eigenvalues 2 - 2 cos(pi j / n); and a potential, on top."""
    n = 60
    diagonal, off = np.r_[1.0, np.full(n - 2, 2.0), 1.0], -np.ones(n - 1)
    path = sparse.csr_array(sparse.diags_array([off, diagonal, off], offsets=[-1, 0, 1]))
    points = np.c_[np.arange(n), np.zeros((n, 2))]
    expected = 2 - 2 * np.cos(np.pi * np.arange(8) / n)
    for potential in (0.0, 3.0):
        stiffness = path + potential * sparse.eye_array(n)
        s = sk.eigensolve(sk.Laplacian(sparse.csr_array(stiffness), np.ones(n), points), 8)
        assert s.eigenvalues == pytest.approx(expected + potential, abs=1e-12)
        assert s.n_zero_modes == (potential == 0)


def test_tiny_inputs() -> None:
    triangle = sk.TriangleMesh(np.eye(3), [[0, 1, 2]])
    assert sk.eigensolve(sk.robust_laplacian(triangle), 3).n_zero_modes == 1
    assert sk.eigensolve(sk.robust_laplacian(triangle), 3, sk.RayleighRitz()).k == 3
    square = sk.PointCloud([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    assert sk.eigensolve(sk.robust_laplacian(square), 4).n_zero_modes == 1


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize("name", ["teapot", "trim_star", "hippo"])
def test_arpack_on_real_meshes(real_shapes, name: str) -> None:
    """Open, closed, of several components, with edges 4,000 times as long as others (hippo)."""
    with np.load(real_shapes / f"{name}.npz") as data:
        mesh = sk.TriangleMesh(data["V"], data["F"]).without_unreferenced()
    L = sk.robust_laplacian(mesh.without_degenerate_faces().without_unreferenced())
    certificate = sk.eigensolve(L, 48).certificate
    assert certificate.relative_residuals.max() <= 1e-8
    assert certificate.n_zero_modes == L.kernel_dimension


def test_neo_predicts_each_component_on_its_own() -> None:
    """Two bodies far apart: the same modes as each alone, and two exact zeros."""
    a, b = creature(1200, seed=0), creature(1000, seed=1)
    both = sk.robust_laplacian(joined(a, moved(b, 50.0, 3.0, 0.0)))
    alone = [sk.eigensolve(sk.robust_laplacian(mesh), 20, sk.Neo()).eigenvalues for mesh in (a, b)]
    s = sk.eigensolve(both, 20, sk.Neo())
    assert s.n_zero_modes == 2
    expected = np.sort(np.concatenate(alone))[:20]
    assert s.eigenvalues == pytest.approx(expected, rel=1e-3, abs=1e-9)
    absent = [(rows == 0).all(axis=0).sum() for rows in np.split(s.eigenvectors, [a.n])]
    assert sum(absent) == 20


@pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulSpectrumWarning")
def test_a_larger_prediction_lowers_every_ritz_value() -> None:
    """Of two poses, or joined with plane waves; up to rounding of float32 features."""
    laplacian = sk.robust_laplacian(creature(1500, seed=0))
    exact = sk.eigensolve(laplacian, 40).eigenvalues[1:]
    waves = sk.eigen.subspaces.AmbientFourier(m=160, bandwidth=6.0)
    one, two, alone, both = (
        sk.eigensolve(laplacian, 40, solver).eigenvalues[1:]
        for solver in (
            sk.Neo(max_steps=0),
            sk.Neo(max_steps=0, poses=2),
            sk.RayleighRitz(subspace=waves),
            sk.RayleighRitz(subspace=sk.eigen.subspaces.Union(sk.Neo().subspace, waves)),
        )
    )
    assert (two <= one * (1 + 1e-4)).all()
    assert (np.array([two, both]) >= exact * (1 - 1e-9)).all()
    errors = {"one": one, "two": two, "waves": alone, "both": both}
    errors = {name: np.mean(values / exact - 1) for name, values in errors.items()}
    assert errors["two"] < 0.8 * errors["one"], errors
    assert errors["both"] < 0.7 * min(errors["waves"], errors["one"]), errors


def test_a_used_neo_pickles_small(bumpy_laplacian: sk.Laplacian) -> None:
    """What travels to another process is the name of the weights, not the weights."""
    solver = sk.Neo()
    sk.eigensolve(bumpy_laplacian, 4, solver)
    sent = pickle.dumps(solver)
    assert len(sent) < 1000
    assert repr(pickle.loads(sent)) == repr(solver)


@pytest.mark.parametrize("solver", [sk.Arpack(), sk.Lanczos(), sk.Refined()], ids=repr)
def test_an_order_of_elimination_is_found_once_and_not_kept(animal, monkeypatch, solver) -> None:
    orders, find = [], _degree_kernels.eliminate

    def noted(*pattern):
        orders.append(find(*pattern))
        return orders[-1]

    monkeypatch.setattr(_degree_kernels, "eliminate", noted)
    found = sk.eigensolve(animal, 40, solver)
    assert found.certificate.level == "verified"
    assert len(orders) == 1
    assert "_elimination" not in vars(animal)
