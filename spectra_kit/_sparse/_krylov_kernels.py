"""Inner loops of `pcg` and `CoarseSpace`, compiled by numba on first use and kept on disk after it.

Each works on a range of rows and returns its share of a sum, so that threads may take ranges of
fixed size side by side: added in their order, the bits do not depend on the number of threads.
Within a range sums may be reassociated, for SIMD.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.compiled import compiled

Reals = NDArray[np.float64] | NDArray[np.float32]
Floats = NDArray[np.float64]
Ints = NDArray[np.uint32] | NDArray[np.uint64]

FAST = {"reassoc", "contract", "nsz"}


@compiled(fastmath={"contract"})  # rows are too short for SIMD
def multiply(
    starts: Ints, columns: Ints, values: Floats, p: Floats, q: Floats, start: int, stop: int
) -> float:
    """Write ``q = A p``, and return ``p . q``."""
    energy = 0.0
    for i in range(start, stop):
        total = 0.0
        for e in range(starts[i], starts[i + 1]):
            total += values[e] * p[columns[e]]
        q[i] = total
        energy += total * p[i]
    return energy


@compiled(fastmath=FAST)
def advance(
    x: Floats, r: Floats, p: Floats, q: Floats, step: float, mean: float, start: int, stop: int
) -> tuple[float, float]:
    """Add ``step * p`` to x, take ``step * q + mean`` from r; return ``r . r`` and the sum of r."""
    square, total = 0.0, 0.0
    for i in range(start, stop):
        x[i] += step * p[i]
        r[i] -= step * q[i] + mean
        square += r[i] * r[i]
        total += r[i]
    return square, total


@compiled(fastmath=FAST)
def weigh(r: Floats, z: Floats, start: int, stop: int) -> tuple[float, float]:
    """Return ``r . z`` and the sum of z."""
    product, total = 0.0, 0.0
    for i in range(start, stop):
        product += r[i] * z[i]
        total += z[i]
    return product, total


@compiled(fastmath=FAST)
def turn(p: Floats, z: Floats, mean: float, ratio: float, start: int, stop: int) -> None:
    """Write ``p = z - mean + ratio * p``."""
    for i in range(start, stop):
        p[i] = (z[i] - mean) + ratio * p[i]


@compiled(fastmath=FAST)
def restrict(basis: Reals, r: Floats, out: Reals, start: int, stop: int) -> None:
    """Write ``Y[start:stop].T @ r[start:stop]`` to `out` (k,), in its dtype."""
    k = basis.shape[1]
    for c in range(k):
        out[c] = 0
    i = start
    while i + 4 <= stop:  # four rows of Y to one pass over the sums
        r0, r1 = out.dtype.type(r[i]), out.dtype.type(r[i + 1])
        r2, r3 = out.dtype.type(r[i + 2]), out.dtype.type(r[i + 3])
        for c in range(k):
            out[c] += (basis[i, c] * r0 + basis[i + 1, c] * r1) + (
                basis[i + 2, c] * r2 + basis[i + 3, c] * r3
            )
        i += 4
    while i < stop:
        r0 = out.dtype.type(r[i])
        for c in range(k):
            out[c] += basis[i, c] * r0
        i += 1


@compiled(fastmath=FAST)
def prolong(basis: Reals, coefficients: Reals, out: Floats, start: int, stop: int) -> None:
    """Add ``Y[start:stop] @ coefficients`` to ``out[start:stop]``."""
    k = basis.shape[1]
    for i in range(start, stop):
        total = coefficients.dtype.type(0)
        for c in range(k):
            total += basis[i, c] * coefficients[c]
        out[i] += total
