"""Chebyshev filters of sparse matrices in torch: what eigenpairs are made with.

A step costs one product of a sparse matrix with a block of columns, which an accelerator does at
the speed of its memory; within a filter nothing waits for the host.
"""

from __future__ import annotations

import torch
from torch import Tensor

from spectra_kit.errors import InvalidInputError
from spectra_kit.linalg.torch_device import csr_like, csr_rows

_BOUND_STEPS = 20


def spectral_bound(operator: Tensor) -> float:
    """Return a proven upper bound on the eigenvalues of a symmetric sparse CSR matrix S.

    For any positive x the spectral radius of ``|S|``, and so every eigenvalue of S, is at most
    ``max_i (|S| x)_i / x_i`` (Collatz and Wielandt); a few power steps on x bring that close to
    the radius. For an L with non-negative weights it is below twice the largest eigenvalue.
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
            "stiffness",
            f"store all {operator.shape[0]} entries of its diagonal",
            int(on_diagonal.sum()),
            advice="a zero one is a point that nothing holds: drop it",
        )
    values = operator.values().double() - (high + low) / 2 * on_diagonal.double()
    return csr_like(operator, values / ((high - low) / 2))
