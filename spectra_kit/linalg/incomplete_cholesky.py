"""Incomplete Cholesky factors, as preconditioners."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import DTypeLike, NDArray
from scipy import sparse

from spectra_kit.errors import InvalidInputError
from spectra_kit.linalg._checks import check_matrix
from spectra_kit.linalg.products import real_dtype

Floats = NDArray[np.float64]

_FIRST_SHIFT = 1e-3
_GROWTH = 4.0
_LARGEST_SHIFT = 10.0


class IncompleteCholesky:
    """``A ~ (I + L) D (I + L)^T`` with L as sparse as A."""

    def __init__(
        self,
        matrix: sparse.csr_array,
        *,
        drop: float | None = None,
        max_fill: int | None = None,
        dtype: DTypeLike = np.float64,
    ) -> None:
        from spectra_kit.linalg._incomplete_kernels import factor_level_zero

        start = time.perf_counter()
        rows = check_matrix(matrix)
        self.n: int = rows.shape[0]
        self._dtype = real_dtype("dtype", dtype)
        diagonal = rows.diagonal()
        lower = sparse.tril(rows, -1, format="csr")
        last = np.bincount(lower.indices, minlength=self.n) == 0
        shift = 0.0
        while True:
            values, inverse = lower.data.copy(), np.empty(self.n)
            broken = factor_level_zero(
                lower.indptr, lower.indices, values, diagonal * (1 + shift), last, inverse
            )
            if broken < 0:
                break
            shift = _FIRST_SHIFT if shift == 0 else shift * _GROWTH
            if shift > _LARGEST_SHIFT or diagonal[broken] < 0:
                raise InvalidInputError(
                    "`matrix` must be positive semi-definite: its incomplete Cholesky factor"
                    f" breaks down in row {broken}, even with the diagonal raised by"
                    f" {shift / _GROWTH:.3g} of itself"
                )
        self.shift = shift
        self._starts, self._columns = lower.indptr, lower.indices
        self._lower = values.astype(self._dtype)
        self._inverse = inverse.astype(self._dtype)
        self.seconds = time.perf_counter() - start

    @property
    def fill(self) -> int:
        """Entries of L below its diagonal."""
        return len(self._lower)

    def solve(self, rhs: Floats) -> Floats:
        """Return ``M^-1 rhs`` for `rhs` (n,)."""
        from spectra_kit.linalg._incomplete_kernels import solve_rows

        out = np.empty(self.n)
        solve_rows(self._starts, self._columns, self._lower, self._inverse, rhs, out)
        return out
