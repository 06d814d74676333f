"""Where a function takes a value: the lines of its zeros, or of several levels, as segments."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from spectra_kit.geometry.shapes import Geometry, TriangleMesh

Floats = NDArray[np.float64]
Ints = NDArray[np.integer]

_PLATEAU = 1e-6  # of the range of values: what is nearer to a level lies on it
_ROUNDING = 100 * np.finfo(np.float64).eps  # likewise, of the largest value
_NEIGHBOURS = 7  # whose triangles with a point of a cloud stand for the surface around it


def triangles_of(geometry: Geometry) -> Ints:
    """Return triangles (f, 3) on which functions are taken to be linear.

    Those of a mesh; of a cloud all that a point makes with two of its nearest neighbours. They
    overlap, but where a function is smooth its zeros on all of them are one line.
    """
    if isinstance(geometry, TriangleMesh):
        return geometry.faces
    k = min(_NEIGHBOURS, geometry.n - 1)
    first, second = np.triu_indices(k, 1)
    if not len(first):
        return np.empty((0, 3), dtype=np.int32)
    _, near = cKDTree(geometry.points).query(geometry.points, k=k + 1)
    near = near[:, 1:].astype(np.int32)
    own = np.repeat(np.arange(geometry.n, dtype=np.int32), len(first))
    return np.column_stack([own, near[:, first].ravel(), near[:, second].ravel()])


def level_lines(
    points: Floats, triangles: Ints, values: Floats, levels: Iterable[float] = (0.0,)
) -> Floats:
    """Return the segments (s, 2, 3) along which a function (n,) takes one of the levels.

    A line separates what is clearly above from what is clearly below: the rounding errors of a
    function that vanishes somewhere, or of a constant one, make none.
    """
    flat = 0.0
    if values.size:
        spread = np.ptp(np.percentile(values, [1, 99])) or np.ptp(values)  # spikes count less
        flat = float(_PLATEAU * spread + _ROUNDING * np.abs(values).max())
    found = [_zeros(points, triangles, values - level, flat) for level in levels]
    return np.concatenate([np.empty((0, 2, 3)), *found])


def _zeros(points: Floats, triangles: Ints, values: Floats, flat: float) -> Floats:
    """The zeros of a function; a vertex where it vanishes counts as above if one beside it is."""
    values = np.where(np.abs(values) <= flat, 0.0, values)
    above, below = values > 0, values < 0
    beside = np.zeros(len(values), dtype=bool)
    beside[triangles[above[triangles].any(axis=1)]] = True
    upper = above | (beside & ~below)
    sides = upper[triangles]
    count = sides.sum(axis=1)
    crossed = (count % 3 != 0) & below[triangles].any(axis=1)
    corners, sides, count = triangles[crossed], sides[crossed], count[crossed]
    apex = np.where(count == 1, sides.argmax(axis=1), sides.argmin(axis=1))  # alone on its side
    row = np.arange(len(corners))
    ends = [
        _between(points, values, upper, corners[row, apex], corners[row, (apex + turn) % 3])
        for turn in (1, 2)
    ]
    return np.stack(ends, axis=1)


def _between(
    points: Floats, values: Floats, upper: NDArray[np.bool_], start: Ints, stop: Ints
) -> Floats:
    """The zero (s, 3) on each edge; at its upper end where the function vanishes along it."""
    rise = values[start] - values[stop]
    part = np.where(upper[start], 0.0, 1.0)
    np.divide(values[start], rise, out=part, where=rise != 0)
    return np.asarray(points[start] + part[:, None] * (points[stop] - points[start]))
