"""Inner loops, compiled by numba on first use and kept on disk after it.

They release the interpreter lock, so that ordinary threads run them side by side; no thread pool
of numba's own, which would not survive a fork. No sum is reassociated: an entry of a result has
the same bits however the work was cut.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spectra_kit.linalg.compiled import compiled

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Reals = Floats | Singles
Ints = NDArray[np.int64] | NDArray[np.int32]


@compiled()
def multiply_rows(
    indptr: Ints, columns: Ints, values: Reals, dense: Reals, out: Reals, start: int, stop: int
) -> None:
    """Write rows `start` to `stop` of (sparse rows) @ `dense` to those of `out`, in its dtype."""
    width = dense.shape[1]
    for i in range(start, stop):
        for c in range(width):
            out[i, c] = 0
        p, end = indptr[i], indptr[i + 1]
        while p + 4 <= end:  # four rows of `dense` to one pass over the sums
            v0, v1, v2, v3 = values[p], values[p + 1], values[p + 2], values[p + 3]
            j0, j1, j2, j3 = columns[p], columns[p + 1], columns[p + 2], columns[p + 3]
            for c in range(width):
                out[i, c] += (v0 * dense[j0, c] + v1 * dense[j1, c]) + (
                    v2 * dense[j2, c] + v3 * dense[j3, c]
                )
            p += 4
        while p < end:
            value, j = values[p], columns[p]
            for c in range(width):
                out[i, c] += value * dense[j, c]
            p += 1


@compiled()
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
        for p in range(indptr[i], indptr[i + 1]):
            j = columns[p]
            entry = entries[p]
            for c in range(width):
                row[c] += entry * X[j, c]
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
    direction: Singles,
    new: Singles,
    keep: float,
    step: float,
    first: int,
    last: int,
) -> None:
    """Write one Chebyshev step of ``(L - lambda M) c = -residual`` to rows of `new`.

    From the correction `old`; `direction` is overwritten by
    ``keep direction - step (residual + (L - lambda M) old) / diag(L)``. L and M are given by rows,
    `values` are the lambda of each column, and `inverse` is one over the diagonal of L.
    """
    s = old.shape[1]
    row = np.empty(s, np.float32)
    for i in range(first, last):
        for c in range(s):
            row[c] = 0.0
        for p in range(mass_starts[i], mass_starts[i + 1]):
            j, weight = mass_neighbours[p], mass[p]
            for c in range(s):
                row[c] += weight * old[j, c]
        for c in range(s):
            row[c] = residual[i, c] - values[c] * row[c]
        p, end = starts[i], starts[i + 1]
        while p + 4 <= end:  # four rows of `old` to one pass over the sums
            v0, v1, v2, v3 = stiffness[p], stiffness[p + 1], stiffness[p + 2], stiffness[p + 3]
            j0, j1, j2, j3 = neighbours[p], neighbours[p + 1], neighbours[p + 2], neighbours[p + 3]
            for c in range(s):
                row[c] += (v0 * old[j0, c] + v1 * old[j1, c]) + (v2 * old[j2, c] + v3 * old[j3, c])
            p += 4
        while p < end:
            weight, j = stiffness[p], neighbours[p]
            for c in range(s):
                row[c] += weight * old[j, c]
            p += 1
        a, b = np.float32(keep), np.float32(step) * inverse[i]
        for c in range(s):
            direction[i, c] = a * direction[i, c] - b * row[c]
            new[i, c] = old[i, c] + direction[i, c]
