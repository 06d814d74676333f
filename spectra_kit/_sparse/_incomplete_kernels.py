"""Inner loops of `IncompleteCholesky`, compiled by numba on first use and kept on disk after it.

All factors are ``A ~ (I + L) D (I + L)^T`` with L strictly lower triangular, computed by columns
of L, which are rows of its transpose. A pivot that is zero to rounding and has nothing below it
ends a component of a singular matrix: its inverse is stored as zero, which holds that unknown at
zero.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from spectra_kit._core.compiled import compiled

Reals = NDArray[np.float64] | NDArray[np.float32]
Floats = NDArray[np.float64]
Ints = NDArray[np.int32] | NDArray[np.int64] | NDArray[np.uint32]

ROUNDING = 1e-11  # share of the diagonal entry below which a pivot is zero


@register_jitable
def _inverted(pivot: float, scale: float, ends: bool) -> float:
    """Return the inverse of a pivot, zero for one that ends a component, NaN for a breakdown."""
    if pivot > ROUNDING * scale:
        return 1.0 / pivot
    if ends and pivot >= -ROUNDING * scale:
        return 0.0
    return np.nan


@compiled()
def factor_level_zero(
    starts: Ints, columns: Ints, upper: Floats, diagonal: Floats, relaxation: float, inverse: Floats
) -> int:
    """Overwrite the strictly upper rows of A with those of L^T; `inverse` receives 1 / D.

    Row i of A right of its diagonal is ``upper[starts[i]:starts[i + 1]]``, `columns` ascending.
    `relaxation` times every entry that falls outside of the pattern moves to the diagonals of its
    row and column. Overwrites `diagonal`. Returns the row where it broke down, or -1.
    """
    scale = diagonal.copy()
    for k in range(len(diagonal)):
        begin, end = starts[k], starts[k + 1]
        inverse[k] = _inverted(diagonal[k], scale[k], begin == end)
        if np.isnan(inverse[k]):
            return k
        for p in range(begin, end):
            i = columns[p]
            factor = upper[p] * inverse[k]
            diagonal[i] -= factor * upper[p]
            s, stop = starts[i], starts[i + 1]
            for q in range(p + 1, end):
                j = columns[q]
                while s < stop and columns[s] < j:
                    s += 1
                if s < stop and columns[s] == j:
                    upper[s] -= factor * upper[q]
                else:
                    lost = relaxation * factor * upper[q]
                    diagonal[i] -= lost
                    diagonal[j] -= lost
        for p in range(begin, end):
            upper[p] *= inverse[k]
    return -1


@compiled()
def factor_threshold(
    starts: Ints,
    columns: Ints,
    upper: Floats,
    diagonal: Floats,
    smallest: Floats,
    relaxation: float,
    inverse: Floats,
) -> tuple[int, NDArray[np.int64], NDArray[np.int32], Floats]:
    """Factorise by columns, left-looking; keep what exceeds ``smallest[k]`` in column k of L D.

    What is dropped is treated as in `factor_level_zero`. Returns the column where it broke down
    (or -1), and L^T by rows.
    """
    n = len(diagonal)
    scale = diagonal.copy()
    out_starts = np.zeros(n + 1, np.int64)
    capacity = 4 * len(upper) + n
    out_columns, out_values = np.empty(capacity, np.int32), np.empty(capacity, np.float64)
    work, touched, rows = np.zeros(n), np.zeros(n, np.bool_), np.empty(n, np.int32)
    position = np.empty(n, np.int64)  # in each finished column: its first entry at k or below
    head, following = np.full(n, -1, np.int32), np.full(n, -1, np.int32)  # columns, by that entry
    for k in range(n):
        count = 0
        for p in range(starts[k], starts[k + 1]):
            i = columns[p]
            work[i], touched[i], rows[count] = upper[p], True, i
            count += 1
        column = head[k]
        while column >= 0:
            after, p, end = following[column], position[column], out_starts[column + 1]
            weight = out_values[p] / inverse[column]
            for q in range(p + 1, end):
                i = out_columns[q]
                if not touched[i]:
                    touched[i], rows[count] = True, i
                    count += 1
                work[i] -= weight * out_values[q]
            if p + 1 < end:
                position[column] = p + 1
                following[column], head[out_columns[p + 1]] = head[out_columns[p + 1]], column
            column = after
        kept = _kept(work, rows[:count], smallest[k])
        for t in range(kept, count):
            lost = relaxation * work[rows[t]]
            diagonal[k] += lost
            diagonal[rows[t]] += lost
        inverse[k] = _inverted(diagonal[k], scale[k], kept == 0)
        if np.isnan(inverse[k]):
            return k, out_starts, out_columns, out_values
        begin, end = out_starts[k], out_starts[k] + kept
        out_starts[k + 1] = end
        if end > len(out_values):
            out_columns, out_values = _wider(out_columns, end), _wider(out_values, end)
        for t in range(kept):
            i = rows[t]
            out_columns[begin + t], out_values[begin + t] = i, work[i] * inverse[k]
            diagonal[i] -= work[i] * work[i] * inverse[k]
        if kept:
            position[k] = begin
            following[k], head[rows[0]] = head[rows[0]], k
        for t in range(count):
            work[rows[t]], touched[rows[t]] = 0.0, False
    return -1, out_starts, out_columns, out_values


@register_jitable
def _kept(work: Floats, rows: NDArray[np.int32], smallest: float) -> int:
    """Move those of `rows` where `work` is largest to the front of it, ascending; count them."""
    kept = 0
    for t in range(len(rows)):
        i = rows[t]
        if abs(work[i]) > smallest:
            rows[kept], rows[t] = i, rows[kept]
            kept += 1
    _sort(rows, kept)
    return kept


@register_jitable
def _sort(rows: NDArray[np.int32], size: int) -> None:
    """Sort the first `size` of `rows` upwards.

    Shell's sort, which numba compiles in a tenth of the time of numpy's.
    """
    gap = 1
    while gap < size // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for t in range(gap, size):
            row, at = rows[t], t
            while at >= gap and rows[at - gap] > row:
                rows[at] = rows[at - gap]
                at -= gap
            rows[at] = row
        gap //= 3


@register_jitable
def _wider(values: NDArray[Any], size: int) -> NDArray[Any]:
    """Return a copy with room for twice `size` entries."""
    wider = np.empty(2 * size, values.dtype)
    for t in range(len(values)):  # a slice would have its error message compiled
        wider[t] = values[t]
    return wider


@compiled()
def solve_factor(
    lower_quads: Ints,
    lower_columns: Ints,
    lower: Reals,
    upper_quads: Ints,
    upper_columns: Ints,
    upper: Reals,
    inverse: Floats,
    rhs: Floats,
    work: Floats,
    out: Floats,
) -> None:
    """Write to `out` the solution of ``(I + L) D (I + L)^T out = rhs``; all (n,).

    L by rows in `lower`, its transpose in `upper`, both in groups of four: most rows of a level
    zero factor have one, so that the processor predicts the inner loop.
    """
    n = len(inverse)
    for i in range(n):
        total = rhs[i]
        for g in range(lower_quads[i], lower_quads[i + 1]):
            total -= (
                lower[g, 0] * work[lower_columns[g, 0]] + lower[g, 1] * work[lower_columns[g, 1]]
            ) + (lower[g, 2] * work[lower_columns[g, 2]] + lower[g, 3] * work[lower_columns[g, 3]])
        work[i] = total
    for i in range(n - 1, -1, -1):
        total = work[i] * inverse[i]
        for g in range(upper_quads[i], upper_quads[i + 1]):
            total -= (
                upper[g, 0] * work[upper_columns[g, 0]] + upper[g, 1] * work[upper_columns[g, 1]]
            ) + (upper[g, 2] * work[upper_columns[g, 2]] + upper[g, 3] * work[upper_columns[g, 3]])
        work[i] = total
        out[i] = total
