"""Incomplete factors: exact where nothing is dropped, positive definite where something is."""

import numpy as np
import pytest
from conftest import refused
from one_system import path
from scipy import sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.sparse.linalg import spsolve

from spectra_kit import InvalidInputError, TriangleMesh, cotan_laplacian, delaunay_laplacian
from spectra_kit._sparse import ConstantKernel, IncompleteCholesky, pcg
from spectra_kit._sparse.incomplete_cholesky import untidy
from spectra_kit.geometry import sphere

RNG = np.random.default_rng(0)


def dense(factor):
    """The matrix that `solve` applies."""
    return np.array([factor.solve(unit) for unit in np.eye(factor.n)]).T


def obtuse():
    """Cotangents of needles: entries of either sign above the diagonal, but semi-definite."""
    ball = sphere(subdivisions=2).geometry
    return cotan_laplacian(TriangleMesh(ball.points * [1, 1, 6], ball.faces)).stiffness


@pytest.fixture(scope="module")
def stiffness():
    return delaunay_laplacian(sphere(subdivisions=2).geometry.as_cloud()).stiffness


def test_where_nothing_is_dropped_the_factor_is_exact(stiffness):
    line, held = path(200, ends=2.0), stiffness + 1e-3 * sparse.eye_array(stiffness.shape[0])
    for matrix, options in (
        (line, {}),
        (line, {"relaxation": 0.9}),
        (sparse.csr_array(held), {"drop": 0.0}),
    ):
        factor = IncompleteCholesky(matrix, **options)
        rhs = RNG.standard_normal(matrix.shape[0])
        np.testing.assert_allclose(factor.solve(rhs), spsolve(matrix.tocsc(), rhs), rtol=1e-9)
    assert IncompleteCholesky(line).fill == 199


def test_level_zero_matches_its_definition(stiffness):
    # The product of the factors equals A wherever A has an entry (Meijerink & van der Vorst).
    matrix = stiffness + sparse.eye_array(stiffness.shape[0])
    product = np.linalg.inv(dense(IncompleteCholesky(matrix)))
    pattern = matrix.toarray() != 0
    np.testing.assert_allclose(product[pattern], matrix.toarray()[pattern], atol=1e-10)
    assert np.abs(product[~pattern]).max() > 1e-3


@pytest.mark.parametrize("drop", [None, 0.02])
def test_full_relaxation_is_exact_on_constants(stiffness, drop):
    matrix = sparse.csr_array(stiffness + 0.1 * sparse.eye_array(stiffness.shape[0]))
    ones = np.ones(matrix.shape[0])
    factor = IncompleteCholesky(matrix, relaxation=1.0, drop=drop)
    np.testing.assert_allclose(factor.solve(matrix @ ones), ones, rtol=1e-10)


def test_a_singular_matrix_is_inverted_on_its_range(stiffness):
    n = stiffness.shape[0]
    both = sparse.csr_array(sparse.block_diag([stiffness, path(50), sparse.csr_array((1, 1))]))
    x = RNG.standard_normal(n + 51)
    factor = IncompleteCholesky(both, drop=0.0)
    assert factor.shift == 0
    kernel = ConstantKernel([0] * n + [1] * 50 + [2])
    found = kernel.remove(factor.solve(both @ x))
    np.testing.assert_allclose(found, kernel.remove(x), atol=1e-9)


@pytest.mark.parametrize(
    "options",
    [{}, {"relaxation": 0.97}, {"drop": 0.01, "relaxation": 0.9}],
    ids=str,
)
@pytest.mark.parametrize("matrix", ["delaunay", "obtuse"])
def test_the_preconditioner_is_symmetric_and_definite(stiffness, matrix, options):
    factor = IncompleteCholesky(stiffness if matrix == "delaunay" else obtuse(), **options)
    applied = dense(factor)
    np.testing.assert_allclose(applied, applied.T, atol=1e-10 * np.abs(applied).max())
    assert np.linalg.eigvalsh(applied).min() > 0


def test_more_fill_is_a_better_factor(stiffness):
    rhs = RNG.standard_normal(stiffness.shape[0])
    rhs -= rhs.mean()
    factors = [IncompleteCholesky(stiffness, drop=drop) for drop in (None, 0.02, 0.0)]
    its = [pcg(stiffness, rhs, preconditioner=factor).iterations for factor in factors]
    assert [f.fill for f in factors] == sorted(f.fill for f in factors)
    assert its == sorted(its, reverse=True)
    assert its[-1] == 1
    single = IncompleteCholesky(stiffness, dtype=np.float32)  # what it is stored in changes little
    assert abs(pcg(stiffness, rhs, preconditioner=single).iterations - its[0]) <= 1
    assert (single.solve(rhs) != factors[0].solve(rhs)).any()


def factorised(matrix, drop, relaxation):
    """The product of the factors that keep entries above a share of the norm of their column of
    the matrix, by elimination in a dense matrix."""
    rest, n = matrix.toarray(), matrix.shape[0]
    smallest = drop * np.linalg.norm(rest, axis=0)
    lower, pivots = np.eye(n), np.empty(n)
    for k in range(n):
        large = np.abs(rest[k + 1 :, k]) > smallest[k]
        kept, lost = (k + 1 + np.flatnonzero(chosen) for chosen in (large, ~large))
        rest[lost, lost] += relaxation * rest[lost, k]
        pivots[k] = rest[k, k] + relaxation * rest[lost, k].sum()
        lower[kept, k] = rest[kept, k] / pivots[k]
        rest[np.ix_(kept, kept)] -= np.outer(rest[kept, k], lower[kept, k])
    return lower * pivots @ lower.T


@pytest.mark.parametrize("relaxation", [0.0, 0.5])
def test_the_threshold_matches_its_definition(relaxation):
    n = 40
    weights = np.random.default_rng(0).uniform(0.1, 1, (n, n))
    weights += weights.T
    matrix = sparse.csr_array(np.diag(weights.sum(axis=1)) - weights + np.eye(n))
    factor = IncompleteCholesky(matrix, drop=0.03, relaxation=relaxation)
    assert 0.2 * n * (n - 1) / 2 < factor.fill < 0.8 * n * (n - 1) / 2
    product = factorised(matrix, 0.03, relaxation)
    np.testing.assert_allclose(dense(factor) @ product, np.eye(n), atol=1e-12)


def test_a_shuffled_mesh_is_untidy_and_takes_more_iterations():
    matrix = cotan_laplacian(sphere(subdivisions=4).geometry).stiffness
    n = matrix.shape[0]
    shuffled, tidy = RNG.permutation(n), reverse_cuthill_mckee(matrix, symmetric_mode=True)
    rhs = RNG.standard_normal(n)
    rhs -= rhs.mean()
    found = {}
    for name, order in (("shuffled", shuffled), ("tidy", tidy)):
        A = sparse.csr_array(matrix[order][:, order])
        assert untidy(A) == (name == "shuffled")
        found[name] = pcg(A, rhs[order], preconditioner=IncompleteCholesky(A)).iterations
    assert found["tidy"] < found["shuffled"]
    assert not untidy(path(50))
    assert not untidy(sparse.csr_array((3, 3)))


def test_breakdown_raises_the_diagonal_and_says_so():
    # Positive definite, but its level-zero factor meets a negative pivot (Kershaw, 1978).
    kershaw = sparse.csr_array(
        np.array([[3.0, -2, 0, 2], [-2, 3, -2, 0], [0, -2, 3, -2], [2, 0, -2, 3]])
    )
    factor = IncompleteCholesky(kershaw)
    assert factor.shift == pytest.approx(1e-3 * 4**4)
    assert "shift" in repr(factor)
    assert np.linalg.eigvalsh(dense(factor)).min() > 0
    x = RNG.standard_normal(4)
    found = pcg(kershaw, kershaw @ x, preconditioner=factor, rtol=1e-12)
    np.testing.assert_allclose(found.x, x, rtol=1e-10)


def test_what_is_refused():
    eye = sparse.eye_array(3, format="csr")
    for argument, expected, matrix, options in (
        ("dtype", "be float32 or", eye, {"dtype": np.int32}),
        ("matrix", "be finite", sparse.csr_array(np.diag([1.0, np.nan, 1.0])), {}),
        ("matrix", "be positive semi-definite: its diagonal goes down to -1", -1 * eye, {}),
    ):
        refused(argument, expected, IncompleteCholesky, matrix, **options)
    with pytest.raises(InvalidInputError, match="breaks down in row 1, even with the diagonal"):
        IncompleteCholesky(sparse.csr_array(np.array([[1.0, 9.0], [9.0, 1.0]])))
    refused("rhs", "have shape (3,)", IncompleteCholesky(eye).solve, np.ones(2))
