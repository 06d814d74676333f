"""Inner loops of `IncompleteCholesky`, compiled by numba on first use and kept on disk after it.

All factors are ``A = (I + L) D (I + L)^T`` with L strictly lower triangular. A pivot that is zero
to rounding and has nothing below it ends a component of a singular matrix: its inverse is stored
as zero, which holds that unknown at zero.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Reals = NDArray[np.float64] | NDArray[np.float32]
Floats = NDArray[np.float64]
Ints = NDArray[np.int32] | NDArray[np.int64]

ROUNDING = 1e-11  # share of the diagonal entry below which a pivot is zero


@njit(nogil=True, cache=True)
def factor_level_zero(
    starts: Ints, columns: Ints, values: Floats, diagonal: Floats, last: Ints, inverse: Floats
) -> int:
    """Overwrite the strictly lower rows of A with those of L; `inverse` receives 1 / D.

    Row i of A left of its diagonal is ``values[starts[i]:starts[i + 1]]``, `columns` ascending.
    ``last[i]`` says whether no later row refers to i. Returns the row where the factorisation
    broke down, or -1.
    """
    n = len(diagonal)
    for i in range(n):
        begin, end = starts[i], starts[i + 1]
        pivot = diagonal[i]
        for p in range(begin, end):
            j = columns[p]
            # values[p] becomes L[i, j] D[j]; the row is divided by D at its end
            total = values[p]
            a, b, stop = begin, starts[j], starts[j + 1]
            while a < p and b < stop:
                if columns[a] == columns[b]:
                    total -= values[a] * values[b]
                    a += 1
                    b += 1
                elif columns[a] < columns[b]:
                    a += 1
                else:
                    b += 1
            values[p] = total
        for p in range(begin, end):
            scaled = values[p] * inverse[columns[p]]
            pivot -= values[p] * scaled
            values[p] = scaled
        if abs(pivot) <= ROUNDING * diagonal[i] and last[i]:
            inverse[i] = 0.0
        elif pivot > ROUNDING * diagonal[i]:
            inverse[i] = 1.0 / pivot
        else:
            return i
    return -1


@njit(nogil=True, cache=True)
def solve_rows(
    starts: Ints, columns: Ints, lower: Reals, inverse: Reals, rhs: Reals, out: Reals
) -> None:
    """Write to `out` the solution of ``(I + L) D (I + L)^T out = rhs``, L stored by rows."""
    n = len(inverse)
    for i in range(n):
        total = rhs[i]
        for p in range(starts[i], starts[i + 1]):
            total -= lower[p] * out[columns[p]]
        out[i] = total
    for i in range(n):
        out[i] *= inverse[i]
    for i in range(n - 1, -1, -1):
        value = out[i]
        for p in range(starts[i], starts[i + 1]):
            out[columns[p]] -= lower[p] * value
