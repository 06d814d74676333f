import numpy as np
import pytest
from conftest import refused
from scipy import sparse

from spectra_kit import InvalidInputError
from spectra_kit.linalg import SparseCholesky, orthonormalize

N, M = 3000, 60


def graded(condition: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Columns whose M-singular values fall from 1 to 1 / condition, and a mass."""
    rng = np.random.default_rng(seed)
    mass = rng.uniform(0.1, 2.0, N)
    left = np.linalg.qr(rng.standard_normal((N, M)))[0]
    right = np.linalg.qr(rng.standard_normal((M, M)))[0]
    singular = np.geomspace(1, 1 / condition, M)
    return (left * singular) @ right / np.sqrt(mass)[:, None], mass


@pytest.mark.parametrize("condition", [1, 1e4, 1e8])
def test_orthonormalize_keeps_the_whole_span(condition: float) -> None:
    basis, mass = graded(condition)
    Y = orthonormalize(basis, mass)
    assert Y.shape == (N, M)
    assert np.abs(Y.T @ (mass[:, None] * Y) - np.eye(M)).max() < 1e-12
    outside = basis - Y @ (Y.T @ (mass[:, None] * basis))
    assert np.linalg.norm(outside) < 1e-13 * np.linalg.norm(basis)


@pytest.mark.parametrize("rank_tol", [1e-4, 1e-8, 1e-12])
def test_rank_cut_means_what_it_says(rank_tol: float) -> None:
    basis, mass = graded(1e15)
    singular = np.linalg.svd(
        np.sqrt(mass)[:, None] * basis / np.linalg.norm(np.sqrt(mass)[:, None] * basis, axis=0),
        compute_uv=False,
    )
    # LAPACK's SVD of the same scaled columns is the independent count; its own rounding blurs
    # values within a factor of two of the cut.
    low, high = ((singular > f * rank_tol * singular[0]).sum() for f in (2, 0.5))
    assert low <= orthonormalize(basis, mass, rank_tol=rank_tol).shape[1] <= high


def test_dependent_and_zero_columns_are_dropped() -> None:
    rng = np.random.default_rng(1)
    basis = rng.standard_normal((N, 7)) @ rng.standard_normal((7, 20))
    basis[:, 3] = 0
    assert orthonormalize(basis, np.ones(N)).shape == (N, 7)


def test_orthonormalize_is_scale_free() -> None:
    basis, mass = graded(1e6)
    small = orthonormalize(1e-20 * basis, 1e-12 * mass)
    assert small.shape == (N, M)
    gram = small.T @ (1e-12 * mass[:, None] * small)
    assert np.abs(gram - np.eye(M)).max() < 1e-12


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_orthonormalize_refuses_nan(bad: float) -> None:
    basis = np.ones((10, 2))
    basis[4, 1] = bad
    refused("basis", "have finite columns", orthonormalize, basis, np.ones(10))


def test_cholesky_solves_like_lu() -> None:
    rng = np.random.default_rng(2)
    A = sparse.random_array((400, 400), density=0.02, rng=rng)
    A = sparse.csr_array(A @ A.T + sparse.eye_array(400))
    b = rng.standard_normal((400, 5))
    x = SparseCholesky(A).solve(b)
    assert x == pytest.approx(np.linalg.solve(A.toarray(), b), rel=1e-9, abs=1e-12)
    assert SparseCholesky(A).solve(b[:, 0]) == pytest.approx(x[:, 0], rel=1e-12)


def test_cholesky_refuses_indefinite_and_rectangular() -> None:
    with pytest.raises(InvalidInputError, match="must be symmetric positive definite"):
        SparseCholesky(sparse.csr_array([[1.0, 2.0], [2.0, 1.0]]))
    refused("matrix", "be a square", SparseCholesky, sparse.csr_array(np.ones((2, 3))))
