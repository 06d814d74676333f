"""Rayleigh-Ritz and orthonormal bases: exact, rank-aware, the same on the host and in torch."""

import numpy as np
import pytest
import torch
from scipy import linalg, sparse

from spectra_kit._sparse import device, host, orthonormalize
from spectra_kit._sparse.ritz import ritz_pairs, ritz_rotation
from spectra_kit.eigen.multigrid.smoothing import on_device
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import sphere
from spectra_kit.operators import cotan_laplacian

# "cpu" means arrays; with a number, tensors of the same memory.
DEVICES = ["cpu", "cpu:0"] + ["cuda"] * torch.cuda.is_available()


def arrays(block) -> np.ndarray:
    return block if isinstance(block, np.ndarray) else block.cpu().numpy()


@pytest.fixture(scope="module")
def problem():
    """A weighted path of 120 points: L (CSR), mass, and its exact spectrum by LAPACK."""
    rng = np.random.default_rng(0)
    n = 120
    steps = sparse.diags_array([-np.ones(n - 1), np.ones(n - 1)], offsets=[0, 1], shape=(n - 1, n))
    L = sparse.csr_array(steps.T @ sparse.diags_array(rng.uniform(0.5, 2, n - 1)) @ steps)
    mass = rng.uniform(0.5, 2, n)
    return L, mass, *linalg.eigh(L.toarray(), np.diag(mass))


def gram_error(Y, mass) -> float:
    U = arrays(Y)
    return float(np.abs(U.T @ (mass[:, None] * U) - np.eye(U.shape[1])).max())


def ill_conditioned(n, m, smallest):
    """Columns of unit norm (n, m) with singular values from 1 down to `smallest`, exactly known."""
    left = np.linalg.qr(np.random.default_rng(0).standard_normal((n, m)))[0]
    # An orthogonal Hadamard mixing gives all columns equal norms.
    return left * np.logspace(0, np.log10(smallest), m) @ (linalg.hadamard(m) / np.sqrt(m))


@pytest.mark.parametrize("where", DEVICES)
def test_bases_with_small_directions_keep_them_and_become_orthonormal(where):
    basis, mass = ill_conditioned(300, 16, 1e-9), np.linspace(0.5, 2, 300)
    Y = orthonormalize(on_device(basis, where), on_device(mass, where))
    assert gram_error(Y, mass) < 1e-12
    left, root = np.linalg.qr(basis)[0], np.sqrt(mass)[:, None]
    cosines = np.linalg.svd((root * arrays(Y)).T @ np.linalg.qr(root * left)[0])[1]
    assert len(cosines) == 16
    assert cosines.min() > 1 - 1e-9


@pytest.mark.parametrize(("rank_tol", "rank"), [(1e-10, 11), (3e-6, 6), (1e-13, 14)])
def test_the_cut_is_on_relative_singular_values(rank_tol, rank):
    basis = ill_conditioned(300, 16, 1e-15)  # one per decade
    assert orthonormalize(basis, np.ones(300), rank_tol=0.5 * rank_tol).shape[1] == rank


def test_scales_zeros_and_repetitions(problem):
    _, mass, _, vectors = problem
    Y = orthonormalize(vectors[:, :20] * np.logspace(-12, 12, 20), 1e-6 * mass)
    assert Y.shape[1] == 20
    assert gram_error(Y, 1e-6 * mass) < 1e-12
    basis = np.array([[1.0, 2, 0, 0], [1, 2, 0, 1], [1, 2, 0, 0]])
    assert orthonormalize(basis, np.ones(3)).shape == (3, 2)


@pytest.mark.parametrize("where", DEVICES)
@pytest.mark.parametrize(("dtype", "error"), [("float64", 1e-12), ("float32", 1e-6)])
def test_an_invariant_subspace_gives_the_exact_spectrum(problem, dtype, error, where):
    """In double, whatever the precision of its columns, and from above."""
    L, mass, values, vectors = problem
    basis = (vectors[:, :12] @ np.linalg.qr(np.ones((12, 12)) + np.eye(12))[0]).astype(dtype)
    found, U, rank = ritz_pairs(*(on_device(part, where) for part in (L, mass, basis)), 10)
    assert rank == 12
    assert arrays(U).dtype == np.float64
    assert gram_error(U, mass) < 1e-12
    assert (found >= values[:10] - 1e-12).all()
    np.testing.assert_allclose(found, values[:10], atol=error)


@pytest.mark.parametrize("smallest", [1e-2, 1e-6])
def test_single_precision_columns_cost_no_mode(smallest):
    """However small the directions a mode hides in: rounding must not put others in its place."""
    laplacian = cotan_laplacian(sphere(subdivisions=3).geometry)
    L, mass = laplacian.stiffness, laplacian.mass
    low = linalg.eigh(L.toarray(), np.diag(mass))[1][:, :64]
    mixing = linalg.hadamard(64) / 8.0
    basis = (low @ (mixing * np.logspace(0, np.log10(smallest), 64)) @ mixing).astype(np.float32)
    single, double = (ritz_pairs(L, mass, b, 32)[0] for b in (basis, basis.astype(float)))
    np.testing.assert_allclose(single, double, rtol=1e-3, atol=1e-4)  # beside gaps of 2 and more


@pytest.mark.parametrize("where", DEVICES)
def test_a_mass_matrix_need_not_be_diagonal(problem, where):
    L, mass, _, vectors = problem
    M = sparse.csr_array(sparse.diags_array(mass) + 0.1 * L)
    values = linalg.eigh(L.toarray(), M.toarray(), eigvals_only=True)
    for columns in (range(12), [*range(12), 3]):  # of full rank, and not
        basis = np.ascontiguousarray(vectors[:, columns])
        found, U, _ = ritz_pairs(*(on_device(part, where) for part in (L, M, basis)), 10)
        np.testing.assert_allclose(found, values[:10], atol=1e-12)
        np.testing.assert_allclose(arrays(U).T @ (M @ arrays(U)), np.eye(10), atol=1e-12)


@pytest.mark.parametrize("where", DEVICES)
def test_columns_far_from_dependent_need_the_small_problem_alone(problem, where):
    L, mass, values, vectors = problem
    mixing = np.eye(12) + 0.1 * np.random.default_rng(0).standard_normal((12, 12))
    parts = (on_device(part, where) for part in (L, mass, vectors[:, :12] @ mixing))
    found, U = ritz_rotation(*parts)
    np.testing.assert_allclose(found, values[:12], atol=1e-12)
    assert gram_error(U, mass) < 1e-12


def test_no_more_pairs_than_dimensions(problem):
    L, mass, values, vectors = problem
    twice, bad = vectors[:, [0, 1, 2, 2]], vectors[:, :4] * np.nan
    np.testing.assert_allclose(ritz_pairs(L, mass, twice, 8)[0], values[:3], atol=1e-12)
    for call, message in (
        (
            lambda: ritz_pairs(L, mass, twice, 4, least=4),
            "at least k = 4 dimensions, got .* rank 3",
        ),
        (lambda: orthonormalize(bad, mass), "4 columns with NaN or infinite values of 4"),
        (lambda: orthonormalize(0 * vectors, mass), "finite columns that are not all zero"),
        (lambda: ritz_rotation(L, mass, twice), "far from dependent, got 4 with a Gram"),
    ):
        with pytest.raises(InvalidInputError, match=message):
            call()


@pytest.mark.parametrize("where", DEVICES[1:])
@pytest.mark.parametrize("full", [False, True], ids=["diagonal", "full"])
def test_the_same_on_the_host_and_on_a_device(where, full):
    """All that is done to blocks of columns, of either kind of mass."""
    laplacian = cotan_laplacian(sphere(subdivisions=3).geometry)
    L, mass, diagonal = laplacian.stiffness, laplacian.mass, laplacian.stiffness.diagonal()
    M = sparse.csr_array(sparse.diags_array(mass) + 1e-3 * L) if full else mass
    rng = np.random.default_rng(0)
    Y, values = rng.standard_normal((laplacian.n, 9)), np.linspace(0, 20, 9)
    columns = np.linspace(0.5, 1, 9)
    steps = [(keep * columns, step * columns) for keep, step in ((0, 0.7), (0.2, 0.9), (0.3, 1.1))]

    def results(ops, place):
        energy, weight, d, block = (on_device(part, place) for part in (L, M, diagonal, Y))
        yield ops.product(energy, block)
        yield ops.gram(weight, block)
        yield ops.projected(energy, block)
        yield ops.lifted(block, np.eye(9)[:, ::2] - 0.1)
        yield ops.energies(d, block)
        yield ops.dots(block, block + 1)
        yield ops.joined(block, 2 * block)
        yield ops.scaled(block, values > 3, values)
        residual = ops.residual(energy, weight, values, block)
        yield residual
        yield ops.correction(ops.smoother(energy, weight, d), residual, values, steps)

    for mine, other in zip(results(host, "cpu"), results(device, where), strict=True):
        found = arrays(other)
        assert found.shape == mine.shape
        np.testing.assert_allclose(found, mine, rtol=1e-5, atol=1e-5 * np.abs(mine).max())
