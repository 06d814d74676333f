"""Inner loops, compiled by numba on first use and kept on disk after it.

They release the interpreter lock, so that ordinary threads run them side by side; no thread pool
of numba's own, which would not survive a fork. No sum is reassociated: an entry of a result has
the same bits however the work was cut.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Reals = NDArray[np.float64] | NDArray[np.float32]
Ints = NDArray[np.int64] | NDArray[np.int32]


@njit(nogil=True, cache=True)
def solve_column(
    indptr: Ints, rows: Ints, lower: Reals, inverse: Reals, order: Ints, rhs: Reals, out: Reals
) -> None:
    """Write to `out` the solution of ``P (I + L) D (I + L)^T P^T x = rhs``, both (n,).

    `inverse` holds ``1 / D``.
    """
    n = len(inverse)
    y = np.empty(n, lower.dtype)
    for j in range(n):
        y[j] = rhs[order[j]]
    for j in range(n):
        yj = y[j]
        for p in range(indptr[j], indptr[j + 1]):
            y[rows[p]] -= lower[p] * yj
    for j in range(n - 1, -1, -1):
        yj = y[j] * inverse[j]
        for p in range(indptr[j], indptr[j + 1]):
            yj -= lower[p] * y[rows[p]]
        y[j] = yj
        out[order[j]] = yj


@njit(nogil=True, cache=True)
def solve_columns(
    indptr: Ints,
    rows: Ints,
    lower: Reals,
    inverse: Reals,
    order: Ints,
    rhs: Reals,
    out: Reals,
    start: int,
    stop: int,
) -> None:
    """Write the solutions of columns `start` to `stop` of `rhs` (n, s) to those of `out`.

    Each entry of the factor is read once for all of these columns, which is where the time goes.
    """
    n = len(inverse)
    width = stop - start
    y = np.empty((n, width), lower.dtype)
    for j in range(n):
        for c in range(width):
            y[j, c] = rhs[order[j], start + c]
    for j in range(n):
        for p in range(indptr[j], indptr[j + 1]):
            i = rows[p]
            value = lower[p]
            for c in range(width):
                y[i, c] -= value * y[j, c]
    for j in range(n - 1, -1, -1):
        scale = inverse[j]
        for c in range(width):
            y[j, c] *= scale
        for p in range(indptr[j], indptr[j + 1]):
            i = rows[p]
            value = lower[p]
            for c in range(width):
                y[j, c] -= value * y[i, c]
        for c in range(width):
            out[order[j], start + c] = y[j, c]


@njit(nogil=True, cache=True)
def multiply_rows(
    indptr: Ints, columns: Ints, values: Reals, dense: Reals, out: Reals, start: int, stop: int
) -> None:
    """Write rows `start` to `stop` of (sparse rows) @ `dense` to those of `out`, in its dtype."""
    width = dense.shape[1]
    for i in range(start, stop):
        for c in range(width):
            out[i, c] = 0
        for p in range(indptr[i], indptr[i + 1]):
            j = columns[p]
            value = values[p]
            for c in range(width):
                out[i, c] += value * dense[j, c]
