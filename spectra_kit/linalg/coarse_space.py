"""Coarse spaces from known low modes, and two-level preconditioners with them."""

from __future__ import annotations

import time
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray
from scipy import sparse

from spectra_kit.errors import InvalidInputError
from spectra_kit.linalg.products import real_dtype

Floats = NDArray[np.float64]


class Preconditioner(Protocol):
    """Anything with a symmetric positive semi-definite ``solve``."""

    def solve(self, rhs: Floats) -> Floats:
        """Return an approximation of ``A^-1 rhs`` for `rhs` (n,)."""


class CoarseSpace:
    """``Y E^-1 Y^T``."""

    def __init__(
        self,
        basis: ArrayLike,
        *,
        energies: ArrayLike | None = None,
        matrix: sparse.csr_array | None = None,
        dtype: DTypeLike = np.float32,
    ) -> None:
        start = time.perf_counter()
        kind = real_dtype("dtype", dtype)
        Y = np.asarray(basis)
        if (energies is None) == (matrix is None):
            raise InvalidInputError("pass either `energies` or `matrix`")
        if energies is not None:
            values = np.asarray(energies, dtype=np.float64)
            self._inverse: Floats = np.diag(1 / values)
        else:
            energy = Y.T @ (matrix @ Y)
            values, vectors = np.linalg.eigh((energy + energy.T) / 2)
            keep = values > 1e-12 * values[-1]
            self._inverse = (vectors[:, keep] / values[keep]) @ vectors[:, keep].T
        self._basis: NDArray[Any] = np.ascontiguousarray(Y, dtype=kind)
        self.seconds = time.perf_counter() - start

    @property
    def dimension(self) -> int:
        """Number of basis vectors."""
        return self._basis.shape[1]

    def solve(self, rhs: Floats) -> Floats:
        """Return ``Y E^-1 Y^T rhs``."""
        Y = self._basis
        c = self._inverse @ (Y.T @ rhs.astype(Y.dtype))
        return (Y @ c.astype(Y.dtype)).astype(np.float64)


class AdditiveTwoLevel:
    """Base and coarse preconditioner added."""

    def __init__(self, base: Preconditioner, coarse: CoarseSpace) -> None:
        self.base, self.coarse = base, coarse
        self.seconds = getattr(base, "seconds", 0.0) + coarse.seconds

    def solve(self, rhs: Floats) -> Floats:
        """Return ``base.solve(rhs) + coarse.solve(rhs)``."""
        return self.base.solve(rhs) + self.coarse.solve(rhs)


class ProjectedTwoLevel:
    """A-DEF2: ``P^T M^-1 + Q`` with ``Q = Y E^-1 Y^T`` and ``P = I - A Q``."""

    def __init__(self, base: Preconditioner, coarse: CoarseSpace, matrix: sparse.csr_array) -> None:
        self.base, self.coarse, self.matrix = base, coarse, matrix
        self.seconds = getattr(base, "seconds", 0.0) + coarse.seconds

    def solve(self, rhs: Floats) -> Floats:
        """Return ``(I - Q A) M^-1 rhs + Q rhs``."""
        z = self.base.solve(rhs)
        return z + self.coarse.solve(rhs - self.matrix @ z)
