"""Chebyshev filters of sparse matrices in torch: smoothing, and what eigenpairs are made with.

A step costs one product of a sparse matrix with a block of columns, which an accelerator does at
the speed of its memory; within a filter nothing waits for the host.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from spectra_kit.errors import InvalidInputError
from spectra_kit.linalg.torch_ritz import csr_like

_BOUND_STEPS = 20


def chebyshev_smooth(
    stiffness: Tensor, basis: Tensor, *, degree: int = 8, damping: float = 10.0
) -> Tensor:
    """Damp the high frequencies of the columns of a basis.

    Parameters
    ----------
    stiffness : sparse CSR Tensor of shape (n, n)
        L, symmetric and positive semi-definite, its diagonal stored and positive.
    basis : Tensor of shape (n, m)
        Functions, float32 or float64; computed in that precision.
    degree : int, default 8
        Products with L. The band that is kept shrinks with its square.
    damping : float, default 10.0
        By what at least the damped band is divided; larger takes more of the low end with it.

    Returns
    -------
    Tensor of shape (n, m)
        ``p(D^-1 L) basis`` with D the diagonal of L: p is the Chebyshev polynomial with p(0) = 1
        and ``|p| <= 1 / damping`` from ``top * (acosh(damping) / (2 degree))^2``, about, to the top
        of the spectrum of D^-1 L, which is about 2 whatever the mesh. Constants stay as they are.

    Examples
    --------
    >>> from scipy import sparse
    >>> from spectra_kit.linalg.torch_ritz import sparse_tensor
    >>> path = sparse.csr_array([[1.0, -1, 0], [-1, 2, -1], [0, -1, 1]])
    >>> functions = torch.tensor([[1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
    >>> chebyshev_smooth(sparse_tensor(path), functions)[:, 0]
    tensor([1., 1., 1.])
    """
    root = csr_diagonal(stiffness).double().sqrt()
    symmetric = standard_form(stiffness, root)
    top = spectral_bound(symmetric)
    # x0 = -cosh(acosh(damping) / degree) is where the polynomial on [-1, 1] has size `damping`.
    x0 = -math.cosh(math.acosh(damping) / degree)
    cut = top * (x0 + 1) / (x0 - 1)
    rows = csr_rows(stiffness)
    scaled = csr_like(stiffness, stiffness.values() / root.square()[rows])
    operator = shifted(scaled, (cut, top)).to(basis.dtype)
    before, current = basis.clone(), (operator @ basis).div_(x0)
    rho = 1 / x0
    for _ in range(degree - 1):
        following = 1 / (2 * x0 - rho)
        before.addmm_(operator, current, beta=-rho * following, alpha=2 * following)
        before, current, rho = current, before, following
    return current


def spectral_bound(operator: Tensor) -> float:
    """Return a proven upper bound on the eigenvalues of a symmetric sparse CSR matrix S.

    For any positive x the spectral radius of ``|S|``, and so every eigenvalue of S, is at most
    ``max_i (|S| x)_i / x_i`` (Collatz and Wielandt); a few power steps on x bring that close to
    the radius. For an L with non-negative weights it is below twice the largest eigenvalue.

    Examples
    --------
    >>> from scipy import sparse
    >>> from spectra_kit.linalg.torch_ritz import sparse_tensor
    >>> path = sparse_tensor(sparse.csr_array([[1.0, -1, 0], [-1, 2, -1], [0, -1, 1]]))
    >>> round(spectral_bound(path), 4)  # 3 is attained
    3.0000
    """
    magnitude = csr_like(operator, operator.values().double().abs())
    x = torch.ones(operator.shape[0], 1, dtype=torch.float64, device=operator.device)
    bound = (magnitude @ x).max()
    for _ in range(_BOUND_STEPS):
        y = magnitude @ x
        ratio = (y / x).max()
        bound = torch.minimum(bound, ratio)
        x = (y / ratio).add_(x)  # x stays positive where a row is zero
    return float(bound) * (1 + 1e-12)


def standard_form(stiffness: Tensor, root: Tensor) -> Tensor:
    """Return ``M^-1/2 L M^-1/2`` as CSR, `root` being the diagonal of M^1/2."""
    rows = csr_rows(stiffness)
    values = stiffness.values().double() / (root[rows] * root[stiffness.col_indices()])
    return csr_like(stiffness, values)


def shifted(operator: Tensor, interval: tuple[float, float]) -> Tensor:
    """Return the operator moved and scaled so that `interval` becomes [-1, 1]."""
    low, high = interval
    on_diagonal = csr_rows(operator) == operator.col_indices()
    if int(on_diagonal.sum()) != operator.shape[0]:
        raise InvalidInputError(
            f"`stiffness` must store all {operator.shape[0]} entries of its diagonal, got"
            f" {int(on_diagonal.sum())}; a zero one is a point that nothing holds: drop it"
        )
    values = operator.values().double() - (high + low) / 2 * on_diagonal.double()
    return csr_like(operator, values / ((high - low) / 2))


def csr_rows(operator: Tensor) -> Tensor:
    """Return the row of each stored entry."""
    counts = operator.crow_indices().diff()
    rows = torch.arange(operator.shape[0], device=operator.device)
    return torch.repeat_interleave(rows, counts, output_size=operator.values().numel())


def csr_diagonal(operator: Tensor) -> Tensor:
    """Return the diagonal of a CSR matrix, zero where none is stored."""
    rows = csr_rows(operator)
    values = operator.values() * (rows == operator.col_indices())
    return values.new_zeros(operator.shape[0]).index_add_(0, rows, values)
