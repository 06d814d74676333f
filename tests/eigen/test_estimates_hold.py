"""Estimated errors, held against LAPACK on operators that coarse levels do not see through."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from conftest import whole_spectrum
from scipy import sparse

import spectra_kit as sk
from spectra_kit.eigen import automatic
from spectra_kit.eigen.accuracy import counted_errors
from spectra_kit.errors import DoubtfulSpectrumWarning
from spectra_kit.geometry import TriangleMesh, sphere

pytestmark = pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulSpectrumWarning")
_EPS = float(np.finfo(np.float64).eps)


def of_graph(weights, points, *, mass=None, potential=0.0) -> sk.Laplacian:
    """The Laplacian of a graph, plus a potential."""
    W = sparse.csr_array(weights)
    L = sparse.diags_array(np.asarray(W.sum(axis=1)).ravel() + potential) - W
    n = W.shape[0]
    return sk.Laplacian(sparse.csr_array(L), np.ones(n) if mass is None else mass, points)


def chain(n: int) -> sparse.dia_array:
    """Neighbours in a row."""
    return sparse.diags_array([np.ones(n - 1)] * 2, offsets=[1, -1], shape=(n, n))


def lattice(a: int, across: float = 1.0) -> tuple[sparse.csr_array, np.ndarray]:
    """Neighbours in a square grid, and where they are."""
    one = sparse.eye_array(a)
    i = np.arange(a * a)
    points = np.column_stack([i // a, i % a, 0 * i]).astype(float)
    return sparse.csr_array(
        sparse.kron(chain(a), one) + across * sparse.kron(one, chain(a))
    ), points


def wells(rng) -> sk.Laplacian:
    W, points = lattice(28)
    along = points[:, :2].sum(axis=1) % rng.integers(4, 8) == 0
    return of_graph(W, points, potential=np.where(along, 0.0, 100.0))


def high_potential(rng) -> sk.Laplacian:
    W, points = lattice(28)
    return of_graph(W, points, potential=np.where(rng.random(784) < 0.55, 1e6, 0.0))


def random_potential(rng) -> sk.Laplacian:
    W, points = lattice(28)
    return of_graph(W, points, potential=10 ** rng.uniform(-2, 5, 784))


def weak_links(rng) -> sk.Laplacian:
    W, points = lattice(15)
    W = sparse.lil_array(sparse.block_diag([W] * 3))
    for i in (225, 450):
        W[i, i - 225] = W[i - 225, i] = 10 ** -rng.uniform(4, 12)
    return of_graph(W, np.vstack([points + [16 * i, 0, 0] for i in range(3)]))


def anisotropic(rng) -> sk.Laplacian:
    return of_graph(*lattice(26, across=10 ** -rng.uniform(2, 7)))


def masses(rng) -> sk.Laplacian:
    return of_graph(*lattice(26), mass=10 ** rng.uniform(-3, 3, 676))


def weights(rng) -> sk.Laplacian:
    W, points = lattice(26)
    upper = sparse.csr_array(sparse.triu(W))
    upper.data = 10 ** rng.uniform(-4, 4, upper.nnz)
    return of_graph(upper + upper.T, points)


def graded(rng) -> sk.Laplacian:
    grade = 10 ** rng.uniform(3, 6)
    x, y = np.geomspace(1 / grade, 1, 45), np.linspace(0, 1, 18)
    X, Y = np.meshgrid(x, y, indexing="ij")
    i = np.arange(X.size).reshape(X.shape)
    a, b, c, d = (j.ravel() for j in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    faces = np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    points = np.column_stack([X.ravel(), Y.ravel(), np.zeros(X.size)])
    return sk.robust_laplacian(TriangleMesh(points, faces))


def expander(rng) -> sk.Laplacian:
    pairs = np.vstack([np.column_stack([np.arange(600), rng.permutation(600)]) for _ in range(3)])
    a, b = pairs[pairs[:, 0] != pairs[:, 1]].T
    W = sparse.csr_array((np.ones(len(a)), (a, b)), shape=(600, 600))
    return of_graph(W + W.T, rng.standard_normal((600, 3)))


def held_at_random(rng) -> sk.Laplacian:
    ball = sk.robust_laplacian(sphere(subdivisions=3).geometry)
    return ball.dirichlet(rng.choice(ball.n, 60, replace=False))


HARD: dict[str, Callable[[np.random.Generator], sk.Laplacian]] = {
    f.__name__: f
    for f in (
        wells, high_potential, random_potential, weak_links, anisotropic,
        masses, weights, graded, expander, held_at_random,
    )
}  # fmt: skip
SOLVERS = [
    (sk.Automatic(), 20),
    (sk.Refined(rtol=1e-4), 24),
    (sk.Cascade(coarsest=150), 40),
    (sk.Cascade(subspace=sk.eigen.subspaces.AmbientFourier(m=80), coarsest=300), 30),
]


@pytest.fixture(scope="module", params=HARD)
def hard(request) -> tuple[sk.Laplacian, np.ndarray]:
    """An operator, and its eigenvalues by LAPACK."""
    laplacian = HARD[request.param](np.random.default_rng(len(request.param)))
    return laplacian, whole_spectrum(laplacian)[0]


@pytest.mark.parametrize(("solver", "k"), SOLVERS, ids=repr)
def test_no_error_is_ten_times_its_estimate(hard, solver, k) -> None:
    """And what is bounded or verified is so, up to the rounding of the largest entries."""
    laplacian, truth = hard
    try:
        spectrum = sk.eigensolve(laplacian, k, solver)
    except sk.errors.ConvergenceError:
        return
    certificate = spectrum.certificate
    unit = np.maximum(spectrum.eigenvalues, laplacian.component_spacings.max())
    largest = (abs(laplacian.stiffness).sum(axis=1) / laplacian.mass)[laplacian.free].max()
    rounding = 50 * _EPS * largest / unit
    off = np.abs(spectrum.eigenvalues - truth[:k]) / unit
    if certificate.errors is not None:
        factor = np.where(certificate.bounded, 1 + 1e-6, 10)
        assert (off <= factor * certificate.errors + 10 * rounding).all()
    if certificate.level == "verified":
        assert (off * unit <= certificate.count.radius + rounding * unit).all()


@pytest.mark.parametrize("too_low", [1, 5, 50])
def test_counts_raise_estimates_by_little_more_than_they_lack(too_low) -> None:
    """Values that are too high, estimates that are as much or less: never beyond 100 times it."""
    mesh = sphere(subdivisions=3).geometry
    ball = sk.robust_laplacian(mesh.with_points(mesh.points * [1.0, 1.3, 1.7]))
    truth, k = whole_spectrum(ball)[0], 20
    off = 1e-4 * np.diff(truth[: k + 1]).min() * np.linspace(0.5, 1, k)
    off[0] = 0.0
    errors = counted_errors(ball, truth[:k] + off, off / too_low)
    assert (errors >= off).all()
    assert (errors <= 100 * off)[1:].all()
    if too_low == 1:
        np.testing.assert_array_equal(errors, off)


def test_a_missing_mode_is_told_where_smoothing_cannot_find_it() -> None:
    """Of parts that hang by 1e-12: the mode of each against the others is none of any level."""
    parts, t = weak_links(np.random.default_rng(1)), np.arange(675)
    along = np.column_stack([np.cos(0.1 * t) * t, np.sin(0.1 * t) * t, 0.01 * t])  # a spiral
    laplacian = sk.Laplacian(parts.stiffness, parts.mass, along)
    with pytest.warns(DoubtfulSpectrumWarning):
        sk.eigensolve(laplacian, 40, sk.Cascade(coarsest=150))


def test_a_potential_that_hides_modes_is_passed_on_to_an_exact_solver(monkeypatch) -> None:
    """Wells along lines, as if of many points: what smoothing makes of them is refuted."""
    monkeypatch.setattr(automatic, "_FEW", 0)
    monkeypatch.setattr(automatic, "_FEW_FOR_EACH", 0)
    W, points = lattice(42)
    along = points[:, :2].sum(axis=1) % 7 == 0
    laplacian = of_graph(W, points, potential=np.where(along, 0.0, 100.0))
    found = sk.eigensolve(laplacian, 40, sk.Automatic(accuracy=1e-2))
    assert found.provenance.accuracy == "exact"
    assert "of smoothing left errors of" in found.provenance.reason
    truth = whole_spectrum(laplacian)[0][:40]
    assert np.abs(found.eigenvalues / truth - 1).max() < 1e-9


@pytest.mark.parametrize("height", [1.0, 1e3, 1e9])
def test_a_potential_is_no_unit(height) -> None:
    """A constant one lifts all eigenvalues and parts none: the spacing stays as it was."""
    ball = sk.robust_laplacian(sphere(subdivisions=3).geometry)
    n = ball.n
    lifted = ball.stiffness + sparse.diags_array(height * ball.mass)
    other = sk.Laplacian(sparse.csr_array(lifted), ball.mass, ball.points)
    assert 1 / 2 < other.eigenvalue_spacing / ball.eigenvalue_spacing < 2
    np.testing.assert_allclose(
        other.component_spacings, other.eigenvalue_spacing, rtol=1e-12, atol=0
    )
    rng = np.random.default_rng(0)
    some = ball.stiffness + sparse.diags_array(height * ball.mass * (rng.random(n) < 0.6))
    most = sk.Laplacian(sparse.csr_array(some), ball.mass, ball.points)
    assert 1 / 2 < most.eigenvalue_spacing / ball.eigenvalue_spacing < 2.5


def test_signs_turned_are_no_potential_beyond_the_diagonal() -> None:
    """D + W of a bipartite graph has the spectrum of D - W, and its spacing."""
    W, points = lattice(20)
    degree = sparse.diags_array(np.asarray(W.sum(axis=1)).ravel())
    one, other = (
        sk.Laplacian(sparse.csr_array(degree + s * W), np.ones(400), points) for s in (-1, 1)
    )
    assert other.eigenvalue_spacing == one.eigenvalue_spacing
    a, b = (sk.eigensolve(x, 12).eigenvalues for x in (one, other))
    np.testing.assert_allclose(a, b, atol=1e-9)


@pytest.mark.parametrize(("d", "k"), [(8, 30), (11, 60)])
def test_a_hypercube_has_binomial_clusters(d, k) -> None:
    """Eigenvalue 2 j is there d choose j times: more than a vector, or a block, has room for."""
    i = np.repeat(np.arange(2**d), d)
    j = i ^ np.tile(1 << np.arange(d), 2**d)
    W = sparse.csr_array((np.ones(len(i)), (i, j)), shape=(2**d, 2**d))
    spectrum = sk.eigensolve(of_graph(W, np.random.default_rng(0).random((2**d, 3))), k)
    exact = np.repeat(2.0 * np.arange(d + 1), [math.comb(d, m) for m in range(d + 1)])
    np.testing.assert_allclose(spectrum.eigenvalues, exact[:k], atol=1e-9)
    assert spectrum.certificate.level == "verified"


@pytest.mark.parametrize("solver", [sk.Automatic(), sk.Arpack()], ids=repr)
@pytest.mark.parametrize("n", [100, 300])
def test_a_complete_graph_has_one_eigenvalue_beside_zero(n, solver) -> None:
    W, points = np.ones((n, n)) - np.eye(n), np.random.default_rng(0).random((n, 3))
    spectrum = sk.eigensolve(of_graph(W, points), n // 5, solver)
    np.testing.assert_allclose(spectrum.eigenvalues[1:], n, rtol=1e-12)
    assert spectrum.certificate.level == "verified"


def test_what_stalls_lanczos_on_few_points_is_solved_densely() -> None:
    """A chain whose weights span twelve decades; who solved it is told."""
    w = 10 ** np.random.default_rng(1).uniform(-6, 6, 699)
    W = sparse.diags_array([w, w], offsets=[1, -1], shape=(700, 700))
    laplacian = of_graph(W, np.random.default_rng(0).random((700, 3)))
    spectrum = sk.eigensolve(laplacian, 10)
    truth = whole_spectrum(laplacian)[0][:10]
    assert (np.abs(spectrum.eigenvalues - truth) <= 50 * _EPS * 4 * w.max()).all()
    assert spectrum.provenance.name == "dense"
    assert "Lanczos gave up" in spectrum.provenance.reason
