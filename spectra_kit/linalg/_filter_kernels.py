"""Inner loops of `shift_invert` and `residuals`, compiled by numba on first use."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spectra_kit.linalg.compiled import compiled

Singles = NDArray[np.float32]
Floats = NDArray[np.float64]
Ints = NDArray[np.int32] | NDArray[np.int64]


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
