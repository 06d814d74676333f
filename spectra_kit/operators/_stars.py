"""Stars of points in the tangential Delaunay complex, compiled by numba on first use."""

from __future__ import annotations

import math

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from spectra_kit.linalg.compiled import compiled

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Bools = NDArray[np.bool_]

_STRAIGHT = 1e-5  # radians: a gap that close to pi is a boundary, as in robust_laplacian
_PARALLEL = 1e-12  # radians: directions that differ by less are the same, but for rounding


@compiled()
def stars(
    points: Floats,
    owners: Ints,
    neighbors: Ints,
    weights: Floats,
    links: Ints,
    sizes: Ints,
    closed: Bools,
) -> None:
    """Find the Delaunay neighbours of each owner among its candidates, in angular order.

    Parameters
    ----------
    points : ndarray of shape (n, 3)
        All points.
    owners : ndarray of shape (r,)
        Whose stars to find.
    neighbors : ndarray of shape (r, k)
        The k points nearest to each owner, nearest first.
    weights : ndarray of shape (n,)
        Of the points, in length^2; tiny, they only decide between points on one circle.
    links, sizes : ndarray of shape (r, k) and (r,), written
        Corners of the star and their number, 0 if there is no triangle.
    closed : ndarray of shape (r,), written
        Whether the last corner and the first one span a triangle, too.

    Notes
    -----
    The triangle (0, p, q) belongs to the star if a sphere through its corners, centred in the
    tangent plane of 0, has no point inside. With (x, y) the projection of a point and z its
    squared distance in space, that is the convex hull of all (x, y) / z and the origin: one
    angular sort. The origin is itself a corner of that hull where the star is open.
    """
    k = neighbors.shape[1]
    x, y, angle = np.empty(k), np.empty(k), np.empty(k)
    hull, order = np.empty(k + 1, np.int64), np.empty(k, np.int64)
    for row in range(len(owners)):
        owner, near = owners[row], neighbors[row]
        u0, u1, u2, v0, v1, v2 = _tangents(points, owner, near)
        for j in range(k):
            d0 = points[near[j], 0] - points[owner, 0]
            d1 = points[near[j], 1] - points[owner, 1]
            d2 = points[near[j], 2] - points[owner, 2]
            z = d0 * d0 + d1 * d1 + d2 * d2
            z += weights[owner] - weights[near[j]]
            x[j] = (d0 * u0 + d1 * u1 + d2 * u2) / z
            y[j] = (d0 * v0 + d1 * v1 + d2 * v2) / z
            # Rises with the angle from -1 by 4 a turn; opposite directions differ by 2.
            steep = y[j] / (abs(x[j]) + abs(y[j])) if x[j] != 0 or y[j] != 0 else 0.0
            angle[j] = steep if x[j] >= 0 else 2 - steep
        size, is_closed = _hull(x, y, angle, order, hull)
        closed[row] = is_closed
        if size < 2:
            size = 0
        sizes[row] = size
        for c in range(size):
            links[row, c] = near[hull[c]]


@compiled()
def triangles(owners: Ints, links: Ints, sizes: Ints, closed: Bools) -> Ints:
    """List the triangles (owner, corner, next corner) of all stars."""
    total = 0
    for row in range(len(owners)):
        if sizes[row]:
            total += sizes[row] if closed[row] else sizes[row] - 1
    found = np.empty((total, 3), np.int32)
    t = 0
    for row in range(len(owners)):
        size = sizes[row]
        for c in range(size if closed[row] else size - 1):
            found[t, 0] = owners[row]
            found[t, 1] = links[row, c]
            found[t, 2] = links[row, (c + 1) % size]
            t += 1
    return found


@register_jitable
def _hull(
    x: Floats, y: Floats, angle: Floats, order: NDArray[np.int64], hull: NDArray[np.int64]
) -> tuple[int, bool]:
    """Write the hull of the points and the origin, counter-clockwise from the origin if on it."""
    k = len(x)
    _sort(angle, order)
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


@register_jitable
def _sort(angle: Floats, order: NDArray[np.int64]) -> None:
    """Write to `order` the indices of the few angles upwards, of equal ones the lower first."""
    for j in range(len(angle)):
        at = j
        while at > 0 and angle[order[at - 1]] > angle[j]:
            order[at] = order[at - 1]
            at -= 1
        order[at] = j


@register_jitable
def _tangents(
    points: Floats, owner: int, near: Ints
) -> tuple[float, float, float, float, float, float]:
    """Return an orthonormal frame of the plane fitted to the owner and the points near it.

    Weights ``(1 - (d / d_max)^2)^2`` fade the farthest out: more of the curvature stays local.
    """
    k = len(near)
    farthest = 0.0
    for r in range(3):
        farthest += (points[near[k - 1], r] - points[owner, r]) ** 2
    total, mean, moment = 1.0, np.zeros(3), np.zeros((3, 3))
    d = np.empty(3)
    for j in range(k):
        square = 0.0
        for r in range(3):
            d[r] = points[near[j], r] - points[owner, r]
            square += d[r] * d[r]
        weight = (1 - square / (1.001 * farthest)) ** 2
        total += weight
        for r in range(3):
            mean[r] += weight * d[r]
            for s in range(3):
                moment[r, s] += weight * d[r] * d[s]
    for r in range(3):
        for s in range(3):
            moment[r, s] -= mean[r] * mean[s] / total
    axes = _eigenvectors(moment)
    flat = 0
    for r in range(1, 3):
        if moment[r, r] < moment[flat, flat]:
            flat = r
    i, j = (flat + 1) % 3, (flat + 2) % 3
    return axes[0, i], axes[1, i], axes[2, i], axes[0, j], axes[1, j], axes[2, j]


@register_jitable
def _eigenvectors(a: Floats) -> Floats:
    """Diagonalise the symmetric 3 x 3 matrix `a` in place by Jacobi rotations."""
    axes = np.zeros((3, 3))
    for r in range(3):
        axes[r, r] = 1.0
    for _ in range(20):
        off = a[0, 1] ** 2 + a[0, 2] ** 2 + a[1, 2] ** 2
        if off <= 1e-30 * (a[0, 0] ** 2 + a[1, 1] ** 2 + a[2, 2] ** 2):
            break
        for p in range(2):
            for q in range(p + 1, 3):
                if a[p, q] == 0.0:
                    continue
                ratio = (a[q, q] - a[p, p]) / (2 * a[p, q])
                t = math.copysign(1.0, ratio) / (abs(ratio) + math.hypot(ratio, 1.0))
                c = 1 / math.hypot(t, 1.0)
                s = t * c
                for r in range(3):
                    a[r, p], a[r, q] = c * a[r, p] - s * a[r, q], s * a[r, p] + c * a[r, q]
                for r in range(3):
                    a[p, r], a[q, r] = c * a[p, r] - s * a[q, r], s * a[p, r] + c * a[q, r]
                for r in range(3):
                    axes[r, p], axes[r, q] = (
                        c * axes[r, p] - s * axes[r, q],
                        s * axes[r, p] + c * axes[r, q],
                    )
    return axes
