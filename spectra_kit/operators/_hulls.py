"""Convex hulls around the origin, which decide the stars of a point cloud; numba."""

from __future__ import annotations

import math

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from spectra_kit._core.compiled import compiled
from spectra_kit._core.types import Bools, Floats, Ints32

_STRAIGHT = 1e-5  # radians: a gap that close to pi is a boundary, as in robust_laplacian
_PARALLEL = 1e-12  # radians: directions that differ by less are the same, but for rounding


@compiled()
def hulls(x: Floats, y: Floats, names: Ints32, links: Ints32, sizes: Ints32, closed: Bools) -> None:
    """Write the names (p, k) of the corners of each hull of k points, counter-clockwise.

    To `links` (p, k), their number to `sizes` (p,), 0 where it is below two, and to `closed` (p,)
    whether the origin is inside. Else it is the corner before the first.
    """
    k = x.shape[1]
    angle, order = np.empty(k), np.empty(k, np.int64)
    hull = np.empty(k + 1, np.int64)
    for row in range(len(x)):
        for j in range(k):
            # Rises with the angle from -1 by 4 a turn; opposite directions differ by 2.
            width = abs(x[row, j]) + abs(y[row, j])
            steep = y[row, j] / width if width > 0 else 0.0
            angle[j] = steep if x[row, j] >= 0 else 2 - steep
            place = j  # by insertion, as there are few; equal ones stay in order
            while place > 0 and angle[order[place - 1]] > angle[j]:
                order[place] = order[place - 1]
                place -= 1
            order[place] = j
        size, closed[row] = _hull(x[row], y[row], angle, order, hull)
        sizes[row] = size if size > 1 else 0
        for c in range(sizes[row]):
            links[row, c] = names[row, hull[c]]


@compiled()
def star_triangles(
    rows: NDArray[np.int64], links: Ints32, sizes: Ints32, closed: Bools, of: Bools
) -> Ints32:
    """Return the triangles (t, 3) of the stars of some points, which are their first corners."""
    count = 0
    for row in range(len(rows)):
        if of[row]:
            count += sizes[row] if closed[row] else max(sizes[row] - 1, 0)
    triangles, t = np.empty((count, 3), np.int32), 0
    for row in range(len(rows)):
        if of[row]:
            for c in range(sizes[row] if closed[row] else sizes[row] - 1):
                triangles[t, 0], triangles[t, 1] = rows[row], links[row, c]
                triangles[t, 2] = links[row, (c + 1) % sizes[row]]
                t += 1
    return triangles


@register_jitable
def _hull(
    x: Floats, y: Floats, angle: Floats, order: NDArray[np.int64], hull: NDArray[np.int64]
) -> tuple[int, bool]:
    """Write the hull of the points and the origin, counter-clockwise from the origin if on it."""
    k = len(x)
    widest, after = -1.0, 0
    for j in range(k):
        gap = angle[order[(j + 1) % k]] - angle[order[j]]
        if j == k - 1:
            gap += 4
        if gap > widest:
            widest, after = gap, (j + 1) % k
    is_closed = widest < 2 - _STRAIGHT
    first = after
    if is_closed:  # start at the farthest one: it is on the hull
        farthest = -1.0
        for j in range(k):
            square = x[order[j]] ** 2 + y[order[j]] ** 2
            if square > farthest:
                farthest, first = square, j
    size = 0
    for step in range(k + 1):
        to = order[(first + step) % k]
        ends_at_origin = step == k and not is_closed
        to_x = 0.0 if ends_at_origin else x[to]
        to_y = 0.0 if ends_at_origin else y[to]
        if size > 0 and not ends_at_origin:  # of one direction keep the farthest
            tip_x, tip_y = x[hull[size - 1]], y[hull[size - 1]]
            across = abs(tip_x * to_y - tip_y * to_x)
            if across <= _PARALLEL * (tip_x * to_x + tip_y * to_y):
                if step < k and math.hypot(to_x, to_y) <= math.hypot(tip_x, tip_y):
                    continue
                size -= 1
        while size > 1:
            tip_x, tip_y = x[hull[size - 1]], y[hull[size - 1]]
            from_x, from_y = x[hull[size - 2]], y[hull[size - 2]]
            turn = (tip_x - from_x) * (to_y - tip_y) - (tip_y - from_y) * (to_x - tip_x)
            if turn > 0:
                break
            size -= 1
        if step < k:
            hull[size] = to
            size += 1
    return size, is_closed
