"""Chebyshev filters of sparse matrices in torch: smoothing, and what eigenpairs are made with.

A step costs one product of a sparse matrix with a block of columns, which an accelerator does at
the speed of its memory; within a filter nothing waits for the host.
"""

from __future__ import annotations

import torch
from torch import Tensor

from spectra_kit.errors import InvalidInputError
from spectra_kit.linalg.torch_device import csr_diagonal, csr_like, csr_product, csr_rows

_BOUND_STEPS = 20
_FLOOR = 1e-3  # of the median diagonal entry: smaller ones would take steps of any length


def smoothed(
    stiffness: Tensor, mass: Tensor, values: Tensor, vectors: Tensor, *, degree: int = 6
) -> Tensor:
    """Return approximate modes without the high frequencies of their residuals.

    The twin of `levels.smoothed`, where the method is described. float64 in and out; of `degree`
    products with L all but the first are of float32.
    """
    diagonal = csr_diagonal(stiffness)
    diagonal = diagonal.clamp_min(_FLOOR * float(diagonal.quantile(0.5)))
    ones = torch.ones(len(mass), 1, dtype=torch.float64, device=mass.device)
    sums = csr_like(stiffness, stiffness.values().abs()) @ ones
    highest = float((sums.squeeze(1) / diagonal).max())  # by Gershgorin
    lowest = highest / (1 + 0.6 * degree**2)
    centre, radius = (highest + lowest) / 2, (highest - lowest) / 2
    residual = csr_product(stiffness, vectors, torch.float64)
    residual = residual.addcmul_(mass.unsqueeze(1) * vectors, values, value=-1).float()
    matrix = csr_like(stiffness, stiffness.values().float())
    inverse, weights = (t.float().unsqueeze(1) for t in (1 / diagonal, mass))
    values = values.float()
    direction = inverse * residual / -centre
    correction, ratio = direction.clone(), radius / centre
    for _ in range(degree - 1):
        before, ratio = ratio, 1 / (2 * centre / radius - ratio)
        image = csr_product(matrix, correction, torch.float32).add_(residual)
        image.addcmul_(weights * correction, values, value=-1)
        direction.mul_(ratio * before).addcmul_(inverse, image, value=-2 * ratio / radius)
        correction.add_(direction)
    return vectors + torch.where(correction.isfinite().all(dim=0), correction, 0.0)


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
