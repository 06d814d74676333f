"""Gradients and divergences on triangles given by the lengths of their sides; numba.

The frame of a triangle has its origin at corner 0 and side 0 along x; corner 2 is at
``(x, y)``, y > 0. Nothing else of where it lies in space is known, or needed.
"""

from __future__ import annotations

import math

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from spectra_kit.linalg.compiled import compiled

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


@compiled(error_model="numpy")
def areas(lengths: Floats) -> Floats:
    """Area of each triangle, shape (f,)."""
    found = np.empty(len(lengths))
    for t in range(len(lengths)):
        found[t] = lengths[t, 0] * _apex(lengths, t)[1] / 2
    return found


@compiled(error_model="numpy")
def apexes(lengths: Floats) -> Floats:
    """Where corner 2 of each triangle is in its frame, shape (f, 2)."""
    found = np.empty((len(lengths), 2))
    for t in range(len(lengths)):
        found[t, 0], found[t, 1] = _apex(lengths, t)
    return found


@compiled(error_model="numpy")
def gradients(corners: Ints, lengths: Floats, values: Floats) -> Floats:
    """Gradient of the function with `values` at the points, in each triangle's frame."""
    found = np.empty((len(corners), 2))
    for t in range(len(corners)):
        x, y = _apex(lengths, t)
        origin = values[corners[t, 0]]
        found[t, 0] = (values[corners[t, 1]] - origin) / lengths[t, 0]
        found[t, 1] = (values[corners[t, 2]] - origin - x * found[t, 0]) / y
    return found


@compiled(error_model="numpy")
def divergences(corners: Ints, lengths: Floats, vectors: Floats, n: int) -> Floats:
    """Adjoint of `gradients` for the areas: ``sum_t area <grad hat_i, vector>`` at each point i.

    The gradient of the hat function of a corner times the area is half the opposite side, turned.
    """
    found = np.zeros(n)
    for t in range(len(corners)):
        x, y = _apex(lengths, t)
        one = (y * vectors[t, 0] - x * vectors[t, 1]) / 2
        two = lengths[t, 0] * vectors[t, 1] / 2
        found[corners[t, 0]] -= one + two
        found[corners[t, 1]] += one
        found[corners[t, 2]] += two
    return found


@register_jitable
def _apex(lengths: Floats, t: int) -> tuple[float, float]:
    """Return where corner 2 of triangle t is in its frame."""
    a = lengths[t, 0]
    b, c = lengths[t, 1] / a, lengths[t, 2] / a  # ratios: in any unit, nothing overflows
    square = (1 + b + c) * (b + c - 1) * (c + 1 - b) * (1 + b - c)
    return a * (1 + c * c - b * b) / 2, a * math.sqrt(max(square, 0.0)) / 2
