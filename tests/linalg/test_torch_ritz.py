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

DEVICES = ["cpu"] + ["cuda"] * torch.cuda.is_available()


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


def ill_conditioned(n, m, smallest):
    """Columns of unit norm (n, m) with singular values from 1 down to `smallest`, exactly known."""
    generator = torch.Generator().manual_seed(0)
    left = torch.linalg.qr(torch.randn(n, m, generator=generator, dtype=torch.float64))[0]
    singular = torch.logspace(0, np.log10(smallest), m, dtype=torch.float64)
    # An orthogonal Hadamard-like mixing gives all columns equal norms.
    return left * singular @ torch.from_numpy(linalg.hadamard(m) / np.sqrt(m))


def test_bases_with_small_directions_keep_them_and_become_orthonormal():
    basis, mass = ill_conditioned(300, 16, 1e-9), torch.linspace(0.5, 2, 300).double()
    Y, twin = orthonormalize(basis, mass), orthonormalize_numpy(basis.numpy(), mass.numpy())
    assert Y.shape == twin.shape == (300, 16)
    assert gram_error(Y, mass) < 1e-12
    cosines = torch.linalg.svdvals(Y.mT @ (mass.unsqueeze(1) * torch.from_numpy(twin)))
    assert cosines.min() > 1 - 1e-9


@pytest.mark.parametrize(("rank_tol", "rank"), [(1e-10, 11), (3e-6, 6), (1e-13, 14)])
def test_the_cut_is_on_relative_singular_values(rank_tol, rank):
    basis = ill_conditioned(300, 16, 1e-15)  # one per decade
    Y = orthonormalize(basis, torch.ones(300).double(), rank_tol=0.5 * rank_tol)
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


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize(
    ("dtype", "error"), [(torch.float64, 1e-12), (torch.float32, 1e-6), (torch.bfloat16, 0.05)]
)
def test_an_invariant_subspace_gives_the_exact_spectrum(problem, dtype, error, device):
    """In double, whatever the precision of its columns, and from above."""
    L, mass, values, vectors = problem
    basis = vectors[:, :12] @ torch.from_numpy(linalg.qr(np.ones((12, 12)) + np.eye(12))[0])
    pairs = rayleigh_ritz(sparse_tensor(L, device), mass.to(device), basis.to(device, dtype), 10)
    assert pairs.eigenvectors.dtype == torch.float64
    assert gram_error(pairs.eigenvectors.cpu(), mass) < 1e-12
    found = pairs.eigenvalues.cpu().numpy()
    assert (found >= values[:10] - 1e-12).all()
    np.testing.assert_allclose(found, values[:10], atol=error)
    assert set(pairs.seconds) == {"orthonormalize", "project", "eigh", "settle"}


@pytest.mark.parametrize("smallest", [1e-2, 1e-6])
def test_single_precision_columns_cost_no_mode(smallest):
    """However small the directions a mode hides in: rounding must not put others in its place."""
    laplacian = cotan_laplacian(sphere(subdivisions=3).geometry)
    L, mass = sparse_tensor(laplacian.stiffness), torch.tensor(laplacian.mass)
    low = linalg.eigh(laplacian.stiffness.toarray(), np.diag(laplacian.mass))[1][:, :64]
    mixing = torch.from_numpy(linalg.hadamard(64) / 8.0)
    singular = torch.logspace(0, np.log10(smallest), 64, dtype=torch.float64)
    basis = (torch.from_numpy(low) @ (mixing * singular) @ mixing).float()
    single, double = (rayleigh_ritz(L, mass, b, 32).eigenvalues for b in (basis, basis.double()))
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


def test_columns_far_from_dependent_need_the_small_problem_alone(problem):
    L, mass, values, vectors = problem
    mixing = torch.eye(12) + 0.1 * torch.randn(12, 12, generator=torch.Generator().manual_seed(0))
    pairs = ritz_rotation(sparse_tensor(L), mass, vectors[:, :12] @ mixing.double())
    np.testing.assert_allclose(pairs.eigenvalues, values[:12], atol=1e-12)
    assert gram_error(pairs.eigenvectors, mass) < 1e-12


def test_no_more_pairs_than_dimensions(problem):
    L, mass, values, vectors = problem
    L, twice, bad = sparse_tensor(L), vectors[:, [0, 1, 2, 2]], vectors[:, :4] * torch.nan
    pairs = leading_ritz_pairs(L, mass, twice, 8)
    np.testing.assert_allclose(pairs.eigenvalues, values[:3], atol=1e-12)
    for call, message in (
        (lambda: rayleigh_ritz(L, mass, twice, 4), "at least k = 4 dimensions, got .* rank 3"),
        (lambda: orthonormalize(bad, mass), "4 columns with NaN or infinite values of 4"),
        (lambda: orthonormalize(0 * vectors, mass), "finite columns that are not all zero"),
        (lambda: ritz_rotation(L, mass, twice), "far from dependent, got 4 whose Gram"),
        (lambda: ritz_rotation(L, mass, bad), "far from dependent, got 4 whose Gram"),
    ):
        with pytest.raises(InvalidInputError, match=message):
            call()
