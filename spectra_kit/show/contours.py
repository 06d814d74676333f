"""Where a function takes a value: the lines of its zeros, or of several levels, as segments."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_positive
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import Geometry, TriangleMesh
from spectra_kit.show.colours import largest

Ints = NDArray[np.integer]

_PLATEAU = 1e-6  # of the range of values: what is nearer to a level lies on it
_ROUNDING = 100 * np.finfo(np.float64).eps  # likewise, of the largest value
_NEIGHBOURS = 30  # of a point of a cloud, among which its triangles are sought
_LINES, _MOST = 28, 200  # of a distance: about so many where no spacing is given, and never more
_CLOSEST = 0.12  # inches between two lines on the page, about, where no spacing is given
_BESIDE, _REACH = 12, 2.0  # none reaches so much farther than most do to that neighbour


def triangles_of(geometry: Geometry) -> Ints:
    """Return triangles (f, 3) on which functions are taken to be linear.

    Those of a mesh; of a cloud the Delaunay stars of all points in their tangent planes, which
    leave no gaps and agree on most triangles; not those that reach across to another part.
    """
    if isinstance(geometry, TriangleMesh):
        return geometry.faces
    from spectra_kit.operators.local_delaunay import local_triangles

    points, first = np.unique(geometry.points, axis=0, return_index=True)
    if len(points) < 4:
        return np.empty((0, 3), dtype=np.int64)
    stars, _, _ = local_triangles(points, min(_NEIGHBOURS, len(points) - 1))
    triangles = np.unique(np.sort(stars, axis=1), axis=0)
    sides = points[triangles] - points[np.roll(triangles, 1, axis=1)]
    near = cKDTree(points).query(points, k=min(_BESIDE, len(points) - 1) + 1)[0][:, -1]
    reach = np.maximum(near[triangles].min(axis=1, keepdims=True), _REACH * np.median(near))
    short = np.linalg.norm(sides, axis=2) <= reach
    return np.asarray(first[triangles[short.all(axis=1)]])


def level_lines(
    points: Floats, triangles: Ints, values: Floats, levels: Iterable[float] = (0.0,)
) -> Floats:
    """Return the segments (s, 2, 3) along which a function (n,) takes one of the levels.

    A line separates what is clearly above from what is clearly below: the rounding errors of a
    function that vanishes somewhere, or of a constant one, make none. Nor does NaN.
    """
    flat = 0.0
    if (unknown := np.isnan(values)).any():
        triangles = triangles[~unknown[triangles].any(axis=1)]
        values = np.where(unknown, np.nanmedian(values), values)
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


def distance_levels(distance: Floats, spacing: float | None, *, inch: float) -> Floats:
    """Return the distances (l,) of the lines: multiples of a spacing, by default a round one.

    An `inch` of the page is so long on the surface.
    """
    limit = largest(distance)
    if spacing is None:
        spacing = round_number(max(limit / _LINES, _CLOSEST * inch))
    elif limit / check_positive("spacing", spacing) > _MOST:
        raise InvalidInputError(
            "spacing",
            f"be at least {limit / _MOST:.3g}, to make no more than {_MOST} lines",
            f"{spacing:.3g}",
        )
    return np.asarray(spacing * np.arange(1, int(limit / spacing) + 1))


def round_number(value: float) -> float:
    """Return the nearest of 1, 2, 2.5 and 5 times a power of ten, by ratio."""
    steps = np.array([1.0, 2.0, 2.5, 5.0, 10.0]) * 10.0 ** np.floor(np.log10(value))
    return float(steps[np.argmin(np.abs(np.log(steps / value)))])
