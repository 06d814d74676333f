"""Sparse products that take out of approximate modes what lies above them in the spectrum."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from spectra_kit._core.types import Floats
from spectra_kit._sparse.blocks import operations
from spectra_kit.eigen.multigrid.coarse import Coarse
from spectra_kit.operators.laplacian import Laplacian

_FLOOR = 1e-3  # of the median diagonal entry: smaller ones would take steps of any length

# Share of the masses, in units of their median: with the diagonal alone, modes of large triangles
# beside small ones are far below zero in its units, where the polynomials grow without bound.
_MASS = 0.3
_MOST = 60  # products: where the columns are few, what lies just above them is left to more steps
_LONGER = 3  # times more products than damping takes: columns lean to the lowest mode by cosh(8)
_NEAREST = 0.95  # of the way up to what is damped: guards may lie inside it
_REACH = 0.6  # degree d damps well from 1 / (1 + 0.6 d^2) of the top


@dataclass(frozen=True, eq=False)
class Smoothing:
    """What smoothing on the points of one operator needs, prepared once.

    That is L, and M or its diagonal, as arrays or tensors, wherever the columns live. The diagonal
    of L, with a floor and a share of the masses, is the preconditioner; `highest` bounds the
    eigenvalues of ``diagonal^-1 L``, by Gershgorin; `singles` is the same in float32.
    """

    stiffness: Any
    mass: Any
    diagonal: Any
    highest: float
    singles: Any

    @classmethod
    def of(cls, operator: Laplacian | Coarse, device: str = "cpu") -> Smoothing:
        """Prepare an operator for columns on a device; "cpu" means arrays."""
        L = operator.stiffness
        if isinstance(operator, Laplacian):
            M, lumped = operator._weights, operator.mass
        else:
            M, lumped = operator.mass, operator.lumped
        diagonal, highest = preconditioner(L, lumped)
        L, M, diagonal = (on_device(part, device) for part in (L, M, diagonal))
        singles = operations(diagonal).smoother(L, M, diagonal)
        return cls(L, M, diagonal, highest, singles)

    def residual(self, values: Floats, vectors: Any) -> Any:
        """Return ``L U - M U diag(values)``."""
        return operations(vectors).residual(self.stiffness, self.mass, values, vectors)

    def sizes(self, residual: Any) -> Floats:
        """Return ``r^T diagonal^-1 r`` of each column, which falls with the error of its value."""
        return np.asarray(operations(residual).energies(1 / self.diagonal, residual))

    def smoothed(
        self,
        values: Floats,
        vectors: Any,
        residual: Any,
        *,
        degree: int | None = None,
        guards: int = 1,
        errors: Floats | None = None,
        goal: float = 1.0,
        sparing: bool = False,
    ) -> Any:
        """Return columns whose errors above the last `guards` of them are damped.

        By as many products as that takes, `degree` or 60 at most; by up to three times as many if
        the relative `errors` of the first eigenvalues are to fall to `goal` in the mean, and by
        fewer, `sparing`, if that is enough. See `eigen.multigrid.smoothed`.
        """
        ops = operations(vectors)
        last = slice(max(len(values) - guards - 1, 0), None)
        energies = ops.energies(self.diagonal, vectors[:, last])
        top = int(np.argmax(values[last] / energies))
        most = _MOST if degree is None else degree
        lowest = lowest_damped(float(values[last][top] / energies[top]), self.highest, most)
        if lowest >= 0.9 * self.highest:
            return vectors  # the columns fill the space of the points
        bottoms = np.full(len(values), lowest)
        enough = enough_steps(lowest, self.highest)
        if errors is not None:
            # What is left after a first step lies just above the modes: as near as seen from each.
            bottoms -= np.clip(values / energies[top], 0.0, _NEAREST * lowest)
            least, longest = 1 if sparing else enough, _LONGER * enough
            enough = _degree(bottoms[: len(errors)], self.highest, errors, goal, least, longest)
        steps = chebyshev_steps(bottoms, self.highest, enough)
        return vectors + ops.correction(self.singles, residual, values, steps)


def preconditioner(stiffness: sparse.csr_array, mass: Floats) -> tuple[Floats, float]:
    """Return a diagonal, and a bound on the eigenvalues of ``diagonal^-1 L``, by Gershgorin.

    That of L, shape (n,), with a floor and a share of the masses.
    """
    diagonal = stiffness.diagonal()
    diagonal = np.maximum(diagonal, _FLOOR * np.median(diagonal))
    diagonal += _MASS * np.median(diagonal / mass) * mass
    return diagonal, float((np.asarray(abs(stiffness).sum(axis=1)) / diagonal).max())


def lowest_damped(wanted: float, highest: float, degree: int) -> float:
    """Return from where on a polynomial of this degree damps: `wanted`, or what it can reach."""
    return max(wanted, highest / (1 + _REACH * degree**2))


def enough_steps(lowest: float, highest: float) -> int:
    """Return how many steps damp what lies between: many more, and what lies below grows."""
    return math.ceil(math.sqrt((highest / lowest - 1) / _REACH) - 1e-9)


def on_device(array: Any, device: str) -> Any:
    """Return a sparse or dense array as it is for "cpu", else as a tensor on the device."""
    if device == "cpu":
        return array
    import torch

    from spectra_kit._sparse.torch_device import csr_tensor

    if isinstance(array, np.ndarray):
        return torch.tensor(array, device=device)
    return array.to(device) if isinstance(array, torch.Tensor) else csr_tensor(array, device=device)


def smoothed(laplacian: Laplacian, values: Floats, vectors: Floats, *, degree: int = 6) -> Floats:
    """Return approximate modes without the high frequencies of their residuals.

    Parameters
    ----------
    laplacian : Laplacian
        On n points.
    values : ndarray of shape (k,)
        Their approximate eigenvalues, ascending.
    vectors : ndarray of shape (n, k)
        Modes carried up from a coarse level, or predicted.
    degree : int, default 6
        Products with L at most; fewer where these reach down to the modes themselves. The
        frequencies damped reach down with its square.

    Returns
    -------
    ndarray of shape (n, k)
        Not orthonormal: Rayleigh-Ritz comes next. Exact modes stay as they are.

    Notes
    -----
    Chebyshev steps, preconditioned by the diagonal of L, for ``(L - lambda M) c = -r``
    with the residual r of each column, aimed at the spectrum above the last of them (Saad,
    *Iterative Methods for Sparse Linear Systems*, 2003, Algorithm 12.1). Only the correction c is
    float32.

    Examples
    --------
    >>> from spectra_kit import eigensolve, robust_laplacian
    >>> from spectra_kit.geometry import sphere
    >>> from spectra_kit.eigen.multigrid import smoothed
    >>> laplacian = robust_laplacian(sphere(subdivisions=3).geometry)
    >>> exact = eigensolve(laplacian, 4)
    >>> u = smoothed(laplacian, exact.eigenvalues, exact.eigenvectors)
    >>> bool(abs(u - exact.eigenvectors).max() < 1e-6)
    True
    """
    level = Smoothing.of(laplacian)
    residual = level.residual(values, vectors)
    return np.asarray(level.smoothed(values, vectors, residual, degree=degree))


def _degree(
    lowest: Floats, highest: float, errors: Floats, goal: float, least: int, most: int
) -> int:
    """Return how many steps bring errors of eigenvalues to `goal` in the mean, between the two.

    The polynomial of degree d is ``cosh(d acosh(x))`` times smaller inside an interval than at a
    mode, x below it, and an error of an eigenvalue is the square of one of modes.
    """
    degrees = np.arange(least, most + 1)
    apart = np.arccosh((highest + lowest) / (highest - lowest))
    left = (errors / np.cosh(degrees[:, None] * apart) ** 2).mean(axis=1)
    return min(least + int(np.count_nonzero(left > goal)), most)


def chebyshev_steps(lowest: Floats, highest: float, degree: int) -> list[tuple[Floats, Floats]]:
    """Return what Chebyshev steps keep of the last one, and how far they go, column by column.

    They damp what lies between `lowest`, of each column, and `highest` (Saad, *Iterative Methods
    for Sparse Linear Systems*, 2003, Algorithm 12.1).
    """
    centre, radius = (highest + lowest) / 2, (highest - lowest) / 2
    ratio, steps = radius / centre, [(np.zeros(len(lowest)), 1 / centre)]
    for _ in range(degree - 1):
        before, ratio = ratio, 1 / (2 * centre / radius - ratio)
        steps.append((ratio * before, 2 * ratio / radius))
    return steps
