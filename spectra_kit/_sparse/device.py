"""What is done to tall blocks of columns in torch, on any device: the functions of `host`.

Small matrices are NumPy's on either side: problems of a few hundred are solved no faster elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from spectra_kit._core.types import Floats
from spectra_kit._sparse.torch_device import csr_like, csr_product

_ROWS = 65_536  # rows of a block handled at once: bounds the temporaries, not the result
_COLUMNS = 64  # of L @ Y at once, for the same reason


def product(matrix: Tensor, Y: Tensor) -> Tensor:
    """Return ``matrix @ Y`` in float64."""
    return csr_product(matrix, Y, torch.float64)


def gram(mass: Tensor, Y: Tensor) -> Floats:
    """Return ``Y^T M Y``, symmetric, in float64."""
    if mass.ndim == 2:
        return projected(mass, Y)
    total = torch.zeros(Y.shape[1], Y.shape[1], dtype=torch.float64, device=Y.device)
    root = mass.double().sqrt().unsqueeze(1)
    for part, weight in zip(torch.split(Y, _ROWS), torch.split(root, _ROWS), strict=True):
        weighted = part.double() * weight
        total += weighted.mT @ weighted
    return _small(total)


def projected(matrix: Tensor, Y: Tensor) -> Floats:
    """Return ``Y^T L Y``, symmetric, in float64."""
    m = Y.shape[1]
    total = torch.zeros(m, m, dtype=torch.float64, device=Y.device)
    for first in range(0, m, _COLUMNS):
        columns = slice(first, first + _COLUMNS)
        image = product(matrix, Y[:, columns])
        for part, block in zip(torch.split(Y, _ROWS), torch.split(image, _ROWS), strict=True):
            total[:, columns] += part.double().mT @ block
    return _small((total + total.mT) / 2)


def lifted(Y: Tensor, rotation: Floats) -> Tensor:
    """Return ``Y @ rotation`` in float64."""
    R = torch.from_numpy(rotation).to(Y.device)
    U = torch.empty(len(Y), R.shape[1], dtype=torch.float64, device=Y.device)
    for part, target in zip(torch.split(Y, _ROWS), torch.split(U, _ROWS), strict=True):
        torch.mm(part.double(), R, out=target)
    return U


def energies(diagonal: Tensor, Y: Tensor) -> Floats:
    """Return the diagonal of ``Y^T D Y``."""
    return _small((diagonal.unsqueeze(1) * Y.double().square()).sum(dim=0))


def dots(Y: Tensor, Z: Tensor) -> Floats:
    """Return the diagonal of ``Y^T Z``, in float64."""
    return _small((Y.double() * Z.double()).sum(dim=0))


def joined(Y: Tensor, Z: Tensor) -> Tensor:
    """Return the columns of both."""
    return torch.cat([Y, Z], dim=1)


def scaled(Y: Tensor, columns: NDArray[np.bool_], scale: Floats) -> Tensor:
    """Return some of the columns, divided by their scale, in float64."""
    chosen = torch.from_numpy(columns).to(Y.device)
    return Y[:, chosen].double() / torch.from_numpy(scale[columns]).to(Y.device)


def residual(stiffness: Tensor, mass: Tensor, values: Floats, Y: Tensor) -> Tensor:
    """Return ``L Y - M Y diag(values)``, summed in float64."""
    weighted = product(mass, Y) if mass.ndim == 2 else mass.unsqueeze(1) * Y
    there = torch.from_numpy(values).to(Y.device)
    return product(stiffness, Y).addcmul_(weighted, there, value=-1)


class Smoother(NamedTuple):
    """L and M of a level in float32, as `correction` wants them."""

    stiffness: Tensor
    mass: Tensor
    inverse: Tensor  # of the diagonal of L, as a column


def smoother(stiffness: Tensor, mass: Tensor, diagonal: Tensor) -> Smoother:
    """Return what smoothing needs of a level, prepared once."""
    weights = csr_like(mass, mass.values().float()) if mass.ndim == 2 else mass.float()
    singles = csr_like(stiffness, stiffness.values().float())
    return Smoother(singles, weights, (1 / diagonal).float().unsqueeze(1))


def correction(
    level: Smoother, residual: Tensor, values: Floats, steps: Sequence[tuple[Floats, Floats]]
) -> Tensor:
    """Return c after Chebyshev steps of ``(L - lambda M) c = -residual``, from c = 0, in float32.

    Of each column, a step is (keep, step):
    ``d = keep d - step (residual + (L - lambda M) c) / diag(L); c += d``.
    """
    residual = residual.float()

    def there(row: Floats) -> Tensor:
        return torch.from_numpy(row).to(residual.device).float()

    shifts = there(values)
    direction = torch.zeros_like(residual)
    found = torch.zeros_like(residual)
    for i, (keep, step) in enumerate(steps):
        image = residual.clone()
        if i:
            image += csr_product(level.stiffness, found, torch.float32)
            if level.mass.ndim == 2:
                weighted = csr_product(level.mass, found, torch.float32)
            else:
                weighted = level.mass.unsqueeze(1) * found
            image.addcmul_(weighted, shifts, value=-1)
        direction.mul_(there(keep)).addcmul_(level.inverse * there(step), image, value=-1)
        found += direction
    return torch.where(found.isfinite().all(dim=0), found, 0.0)


def _small(matrix: Tensor) -> Floats:
    return np.asarray(matrix.cpu().numpy())
