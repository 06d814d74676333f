"""Rayleigh-Ritz in torch: equal to the exact spectrum, to the NumPy twin, and rank-aware."""

import numpy as np
import pytest
import torch
from scipy import linalg, sparse

from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import sphere
from spectra_kit.linalg import torch_ritz as module
from spectra_kit.linalg.orthonormal import orthonormalize as orthonormalize_numpy
from spectra_kit.linalg.torch_device import sparse_tensor
from spectra_kit.linalg.torch_ritz import (
    leading_ritz_pairs,
    orthonormalize,
    rayleigh_ritz,
    ritz_rotation,
)
from spectra_kit.operators import cotan_laplacian


@pytest.fixture(scope="module")
def problem():
    """A weighted path of 120 points: L (CSR), mass, and its exact spectrum by LAPACK."""
    rng = np.random.default_rng(0)
    n = 120
    steps = sparse.diags_array([-np.ones(n - 1), np.ones(n - 1)], offsets=[0, 1], shape=(n - 1, n))
    L = sparse.csr_array(steps.T @ sparse.diags_array(rng.uniform(0.5, 2, n - 1)) @ steps)
    mass = rng.uniform(0.5, 2, n)
    values, vectors = linalg.eigh(L.toarray(), np.diag(mass))
    return L, torch.from_numpy(mass), values, torch.from_numpy(vectors)


def gram_error(Y, mass):
    return (Y.mT @ (mass.unsqueeze(1) * Y) - torch.eye(Y.shape[1])).abs().max()


def ill_conditioned(n, m, smallest, seed=0):
    """Columns of unit norm (n, m) with singular values from 1 down to `smallest`, exactly known."""
    generator = torch.Generator().manual_seed(seed)
    left = torch.linalg.qr(torch.randn(n, m, generator=generator, dtype=torch.float64))[0]
    singular = torch.logspace(0, np.log10(smallest), m, dtype=torch.float64)
    # An orthogonal Hadamard-like mixing gives all columns equal norms.
    right = torch.from_numpy(linalg.hadamard(m) / np.sqrt(m))
    return left * singular @ right


@pytest.mark.parametrize("smallest", [1e-3, 1e-9])
def test_bases_with_small_directions_keep_them_and_become_orthonormal(smallest):
    basis, mass = ill_conditioned(300, 16, smallest), torch.ones(300, dtype=torch.float64)
    Y = orthonormalize(basis, mass)
    assert Y.shape == (300, 16)
    assert gram_error(Y, mass) < 1e-12
    expected = torch.linalg.qr(basis)[0]
    # The same span: principal angles vanish up to rounding / smallest singular value.
    sine = (expected - Y @ (Y.mT @ expected)).norm(dim=0).max()
    assert sine < 1e-14 / smallest


@pytest.mark.parametrize(("rank_tol", "rank"), [(1e-10, 11), (3e-6, 6), (1e-13, 14)])
def test_the_cut_is_on_relative_singular_values(rank_tol, rank):
    basis = ill_conditioned(300, 16, 1e-15)  # one per decade
    Y = orthonormalize(basis, torch.ones(300, dtype=torch.float64), rank_tol=0.5 * rank_tol)
    assert Y.shape[1] == rank


def test_scales_zeros_and_repetitions(problem, monkeypatch):
    _, mass, _, vectors = problem
    scales = torch.logspace(-12, 12, 20, dtype=torch.float64)
    Y = orthonormalize(vectors[:, :20] * scales, 1e-6 * mass)
    assert Y.shape[1] == 20
    assert gram_error(Y, 1e-6 * mass) < 1e-12
    basis = torch.tensor([[1.0, 2, 0, 0], [1, 2, 0, 1], [1, 2, 0, 0]])
    assert orthonormalize(basis, torch.ones(3)).shape == (3, 2)
    whole = orthonormalize(vectors[:, :9], mass)
    monkeypatch.setattr(module, "_ROWS", 17)
    blocked = orthonormalize(vectors[:, :9], mass)
    torch.testing.assert_close(blocked @ blocked.mT, whole @ whole.mT)


def test_equals_the_numpy_twin():
    basis = ill_conditioned(300, 16, 1e-12)
    mass = torch.linspace(0.5, 2, 300, dtype=torch.float64)
    Y, twin = orthonormalize(basis, mass), orthonormalize_numpy(basis.numpy(), mass.numpy())
    assert Y.shape == twin.shape
    overlap = Y.mT @ (mass.unsqueeze(1) * torch.from_numpy(twin))
    cosines = torch.linalg.svdvals(overlap)
    assert cosines.min() > 1 - 1e-6  # the direction at the cut is known to rounding / 1e-10


def test_an_invariant_subspace_gives_the_exact_spectrum(problem):
    L, mass, values, vectors = problem
    mixing = torch.randn(12, 12, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    pairs = rayleigh_ritz(sparse_tensor(L), mass, vectors[:, :12] @ mixing, 10)
    np.testing.assert_allclose(pairs.eigenvalues, values[:10], atol=1e-12)
    cosines = (vectors[:, :10].mT @ (mass.unsqueeze(1) * pairs.eigenvectors)).abs()
    torch.testing.assert_close(cosines, torch.eye(10, dtype=torch.float64), atol=1e-9, rtol=0)
    assert set(pairs.seconds) == {"orthonormalize", "project", "eigh", "settle"}


def test_too_small_a_subspace_and_bad_columns_are_refused(problem):
    L, mass, _, vectors = problem
    with pytest.raises(InvalidInputError, match=r"at least k = 4 dimensions, got numerical rank 3"):
        rayleigh_ritz(sparse_tensor(L), mass, vectors[:, [0, 1, 2, 2]], 4)
    bad = vectors[:, :4].clone()
    bad[3, 1] = torch.nan
    with pytest.raises(InvalidInputError, match="1 column with NaN or infinite values of 4"):
        orthonormalize(bad, mass)
    with pytest.raises(InvalidInputError, match="finite columns that are not all zero"):
        orthonormalize(torch.zeros(120, 2), mass)


@pytest.mark.parametrize("smallest", [1e-2, 1e-6])
def test_single_precision_columns_cost_no_mode(smallest):
    """However small the directions a mode hides in: rounding must not put others in its place."""
    laplacian = cotan_laplacian(sphere(subdivisions=3).geometry)
    L, mass = sparse_tensor(laplacian.stiffness), torch.tensor(laplacian.mass)
    _, low = sparse.linalg.eigsh(
        laplacian.stiffness, 64, sparse.diags_array(laplacian.mass), -0.1, v0=np.ones(laplacian.n)
    )
    mixing = torch.from_numpy(linalg.hadamard(64) / 8.0)
    singular = torch.logspace(0, np.log10(smallest), 64, dtype=torch.float64)
    basis = (torch.from_numpy(low) @ (mixing * singular) @ mixing).float()
    single = rayleigh_ritz(L, mass, basis, 32).eigenvalues
    double = rayleigh_ritz(L, mass, basis.double(), 32).eigenvalues
    torch.testing.assert_close(single, double, rtol=1e-3, atol=1e-4)  # beside gaps of 2 and more


def test_a_mass_matrix_need_not_be_diagonal(problem):
    L, mass, _, vectors = problem
    M = sparse.csr_array(sparse.diags_array(mass.numpy()) + 0.1 * L)
    values = linalg.eigh(L.toarray(), M.toarray(), eigvals_only=True)
    for basis in (vectors[:, :12], vectors[:, [*range(12), 3]]):  # of full rank, and not
        pairs = rayleigh_ritz(sparse_tensor(L), sparse_tensor(M), basis, 10)
        np.testing.assert_allclose(pairs.eigenvalues, values[:10], atol=1e-12)
        gram = pairs.eigenvectors.mT @ (sparse_tensor(M) @ pairs.eigenvectors)
        torch.testing.assert_close(gram, torch.eye(10, dtype=torch.float64))


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_columns_of_any_precision_give_pairs_in_double(problem, dtype):
    L, mass, values, vectors = problem
    pairs = rayleigh_ritz(sparse_tensor(L), mass, vectors[:, :12].to(dtype), 10)
    assert pairs.eigenvectors.dtype == torch.float64
    assert gram_error(pairs.eigenvectors, mass) < 1e-12
    assert (pairs.eigenvalues.numpy() >= values[:10] - 1e-12).all()
    np.testing.assert_allclose(pairs.eigenvalues, values[:10], atol=0.05)


def test_columns_far_from_dependent_need_the_small_problem_alone(problem):
    L, mass, values, vectors = problem
    mixing = torch.eye(12) + 0.1 * torch.randn(12, 12, generator=torch.Generator().manual_seed(0))
    pairs = ritz_rotation(sparse_tensor(L), mass, vectors[:, :12] @ mixing.double())
    np.testing.assert_allclose(pairs.eigenvalues, values[:12], atol=1e-12)
    assert gram_error(pairs.eigenvectors, mass) < 1e-12
    for bad in (vectors[:, [0, 1, 1]], vectors[:, :3] * torch.nan):
        with pytest.raises(InvalidInputError, match="far from dependent, got 3 whose Gram"):
            ritz_rotation(sparse_tensor(L), mass, bad)


def test_no_more_pairs_than_dimensions(problem):
    L, mass, values, vectors = problem
    pairs = leading_ritz_pairs(sparse_tensor(L), mass, vectors[:, [0, 1, 2, 2]], 8)
    np.testing.assert_allclose(pairs.eigenvalues, values[:3], atol=1e-12)
    assert pairs.eigenvectors.shape == (120, 3)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_cuda_equals_cpu(problem):
    L, mass, _, vectors = problem
    basis = vectors[:, :12].float()
    pairs = rayleigh_ritz(sparse_tensor(L), mass, basis, 10)
    there = rayleigh_ritz(sparse_tensor(L, "cuda"), mass.cuda(), basis.cuda(), 10)
    torch.testing.assert_close(there.eigenvalues.cpu(), pairs.eigenvalues)
