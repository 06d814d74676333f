"""Inner loops, compiled by numba on first use and kept on disk after it.

They release the interpreter lock, so that ordinary threads run them side by side; no thread pool
of numba's own, which would not survive a fork. No sum is reassociated: an entry of a result has
the same bits however the work was cut.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from spectra_kit._core.compiled import compiled

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Reals = Floats | Singles
Ints = NDArray[np.int64] | NDArray[np.int32]


@register_jitable
def _four(columns: Ints, values: Reals, p: int, end: int) -> tuple[Any, ...]:
    """Return four entries of a sparse row from `p` on, and their columns; zeros from `end` on.

    Four rows of a dense block then go into one pass over its sums, the last ones, too. Callers make
    `p` an integer of 64 bits: nothing is compiled for two kinds.
    """
    last, zero = end - 1, values.dtype.type(0)
    q1 = p + 1 if p < last else last  # `min` would be compiled
    q2 = p + 2 if p + 1 < last else last
    q3 = p + 3 if p + 2 < last else last
    v1 = values[q1] if p < last else zero
    v2 = values[q2] if p + 1 < last else zero
    v3 = values[q3] if p + 2 < last else zero
    return values[p], v1, v2, v3, columns[p], columns[q1], columns[q2], columns[q3]


@compiled(_nrt=False)
def multiply_rows(
    indptr: Ints, columns: Ints, values: Reals, dense: Reals, out: Reals, start: int, stop: int
) -> None:
    """Write rows `start` to `stop` of (sparse rows) @ `dense` to those of `out`, in its dtype."""
    width = dense.shape[1]
    for i in range(start, stop):
        for c in range(width):
            out[i, c] = 0
        p, end = indptr[i] + 0, indptr[i + 1]
        while p < end:
            v0, v1, v2, v3, j0, j1, j2, j3 = _four(columns, values, p, end)
            for c in range(width):
                out[i, c] += (v0 * dense[j0, c] + v1 * dense[j1, c]) + (
                    v2 * dense[j2, c] + v3 * dense[j3, c]
                )
            p += 4


@compiled(_nrt=False)
def multiply_long(
    indptr: Ints, columns: Ints, values: Reals, X: Reals, out: Reals, start: int, stop: int
) -> None:
    """Write columns `start` to `stop` of X A^T, of long rows X, to those of `out`.

    Four rows in one pass over the entries.
    """
    zero, together = values.dtype.type(0), len(X) // 4 * 4
    for r in range(0, together, 4):
        x0, x1, x2, x3 = X[r], X[r + 1], X[r + 2], X[r + 3]
        for i in range(start, stop):
            t0, t1, t2, t3 = zero, zero, zero, zero
            for p in range(indptr[i], indptr[i + 1]):
                v, j = values[p], columns[p]
                t0 += v * x0[j]
                t1 += v * x1[j]
                t2 += v * x2[j]
                t3 += v * x3[j]
            out[r, i], out[r + 1, i], out[r + 2, i], out[r + 3, i] = t0, t1, t2, t3
    for r in range(together, len(X)):
        for i in range(start, stop):
            total = zero
            for p in range(indptr[i], indptr[i + 1]):
                total += values[p] * X[r, columns[p]]
            out[r, i] = total


@compiled(_nrt=False)
def chebyshev_step(
    solved: Singles,
    correction: Singles,
    previous: Singles,
    first: Singles,
    mass: Singles,
    gain: float,
    a: Singles,
    b: Singles,
    c: Singles,
    start: int,
    stop: int,
) -> None:
    """Advance the correction by one degree, and weigh it with the mass for the next solve.

    For rows `start` to `stop`, with one coefficient for each column:
    ``next = a * (gain * solved - correction) - b * previous + c * first``. It takes the place of
    `correction`, which takes that of `previous`; `solved` becomes ``mass * next``.
    """
    width = solved.shape[1]
    for i in range(start, stop):
        for j in range(width):
            new = (
                a[j] * (gain * solved[i, j] - correction[i, j])
                - b[j] * previous[i, j]
                + c[j] * first[i, j]
            )
            previous[i, j] = correction[i, j]
            correction[i, j] = new
            solved[i, j] = mass[i] * new


@compiled()
def residual_rows(
    indptr: Ints,
    columns: Ints,
    entries: Floats,
    mass: Floats,
    X: Floats,
    values: Floats,
    out: Singles,
    squares: Floats,
    start: int,
    stop: int,
) -> None:
    """Write rows `start` to `stop` of ``L X - M X diag(values)`` to `out`, summed in float64.

    `squares` receives the squared M^-1 norm of these rows, column by column.
    """
    width = X.shape[1]
    row = np.empty(width)
    for c in range(width):
        squares[c] = 0.0
    for i in range(start, stop):
        for c in range(width):
            row[c] = -mass[i] * values[c] * X[i, c]
        p, end = indptr[i] + 0, indptr[i + 1]
        while p < end:
            v0, v1, v2, v3, j0, j1, j2, j3 = _four(columns, entries, p, end)
            for c in range(width):
                row[c] += (v0 * X[j0, c] + v1 * X[j1, c]) + (v2 * X[j2, c] + v3 * X[j3, c])
            p += 4
        for c in range(width):
            squares[c] += row[c] * row[c] / mass[i]
            out[i, c] = row[c]


@compiled()
def smoothing_step(
    starts: Ints,
    neighbours: Ints,
    stiffness: Singles,
    mass_starts: Ints,
    mass_neighbours: Ints,
    mass: Singles,
    inverse: Singles,
    values: Singles,
    residual: Singles,
    old: Singles,
    new: Singles,
    keep: Singles,
    step: Singles,
    first: int,
    last: int,
) -> None:
    """Write one Chebyshev step of ``(L - lambda M) c = -residual`` to rows of `new`.

    From the correction `old` and, in `new`, the one before it: ``old + keep (old - new)
    - step (residual + (L - lambda M) old) / diag(L)``. L and M are given by rows; `values`, `keep`
    and `step` are those of each column, and `inverse` is one over the diagonal of L.
    """
    s = old.shape[1]
    row = np.empty(s, np.float32)
    for i in range(first, last):
        p, end = mass_starts[i] + 0, mass_starts[i + 1]
        if end == p + 1:  # a diagonal mass
            weight, j = mass[p], mass_neighbours[p]
            for c in range(s):
                row[c] = residual[i, c] - values[c] * weight * old[j, c]
        else:
            for c in range(s):
                row[c] = residual[i, c]
            while p < end:
                v0, v1, v2, v3, j0, j1, j2, j3 = _four(mass_neighbours, mass, p, end)
                for c in range(s):
                    row[c] -= values[c] * (
                        (v0 * old[j0, c] + v1 * old[j1, c]) + (v2 * old[j2, c] + v3 * old[j3, c])
                    )
                p += 4
        p, end = starts[i] + 0, starts[i + 1]
        while p < end:
            v0, v1, v2, v3, j0, j1, j2, j3 = _four(neighbours, stiffness, p, end)
            for c in range(s):
                row[c] += (v0 * old[j0, c] + v1 * old[j1, c]) + (v2 * old[j2, c] + v3 * old[j3, c])
            p += 4
        scale = inverse[i]
        for c in range(s):
            ahead = keep[c] * (old[i, c] - new[i, c])
            new[i, c] = old[i, c] + ahead - step[c] * scale * row[c]
