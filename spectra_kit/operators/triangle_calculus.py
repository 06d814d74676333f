"""Gradients and divergences on triangles given by the lengths of their sides.

The frame of a triangle has its origin at corner 0 and side 0 along x; corner 2 is at
``(x, y)``, y > 0. Nothing else of where it lies in space is known, or needed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spectra_kit._types import Floats

Ints = NDArray[np.int32]


def areas(lengths: Floats) -> Floats:
    """Area of each triangle, shape (f,)."""
    return np.asarray(lengths[:, 0] * apexes(lengths)[:, 1] / 2)


def apexes(lengths: Floats) -> Floats:
    """Where corner 2 of each triangle is in its frame, shape (f, 2)."""
    a = lengths[:, 0]
    b, c = lengths[:, 1] / a, lengths[:, 2] / a  # ratios: in any unit, nothing overflows
    square = (1 + b + c) * (b + c - 1) * (c + 1 - b) * (1 + b - c)
    return np.stack([a * (1 + c * c - b * b) / 2, a * np.sqrt(np.maximum(square, 0)) / 2], axis=1)


def gradients(corners: Ints, lengths: Floats, values: Floats) -> Floats:
    """Gradient of the function with `values` at the points, in each triangle's frame."""
    x, y = apexes(lengths).T
    origin, one, two = values[corners].T
    along = (one - origin) / lengths[:, 0]
    return np.stack([along, (two - origin - x * along) / y], axis=1)


def divergences(corners: Ints, lengths: Floats, vectors: Floats, n: int) -> Floats:
    """Adjoint of `gradients` for the areas: ``sum_t area <grad hat_i, vector>`` at each point i.

    The gradient of the hat function of a corner times the area is half the opposite side, turned.
    """
    x, y = apexes(lengths).T
    along, across = vectors.T
    one, two = (y * along - x * across) / 2, lengths[:, 0] * across / 2
    shares = np.stack([-(one + two), one, two], axis=1)
    return np.bincount(corners.ravel(), shares.ravel(), minlength=n).astype(np.float64)
