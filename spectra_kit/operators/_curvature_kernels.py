"""Neighbours, tangent planes and quadrics fitted at the points of a surface, or near; numba."""

from __future__ import annotations

import math

import numpy as np
from numba.extending import register_jitable

from spectra_kit._core.compiled import compiled
from spectra_kit._core.types import Bools, Bytes, Floats, Ints32

FEW, NO_PLANE, NO_SURFACE = 1, 2, 3  # why a point has no curvature
# Cosine of the angle between normals beyond which neighbours are on another side of the shape.
_TURNED = 0.2
_NEIGHBOURS = 5  # and the point itself: six coefficients
_GROWTHS, _GROWTH = 7, 1.5
_SINGULAR = 1e-7  # of a column's square, what the columns before it leave of it


@compiled()
def surroundings(
    points: Floats,
    faces: Ints32,
    starts: Ints32,
    around: Ints32,
    rings: Ints32,
    sizes: Ints32,
    vectors: Floats,
    areas: Floats,
    spacings: Floats,
    whole: Bools,
    rim: Bools,
    first: int,
    last: int,
) -> None:
    """Write what surrounds the points from `first` to `last`.

    The faces at point v stand in `around` from ``starts[v]`` on.
    To `rings` their neighbours, `sizes` of them from ``2 * starts[v]`` on, and to `spacings` the
    geometric mean of their distances. To `vectors` and `areas` the sums of the area vectors of the
    faces, twice as long as these are large, and of their lengths. And whether the points are
    `whole`, in one fan of faces that are wound alike, and whether that is open: at the `rim`.
    """
    n = len(points)
    leaves, enters = np.zeros(n, np.int32), np.zeros(n, np.int32)  # the last point asked, plus one
    after = np.empty(n, np.int32)
    a, b, c = np.empty(3), np.empty(3), np.empty(3)
    for v in range(first, last):
        size, begin, single = 0, -1, True
        areas[v] = logarithms = 0.0
        for r in range(3):
            vectors[v, r] = 0.0
        for place in range(starts[v], starts[v + 1]):
            f = around[place]
            corner = 0 if faces[f, 0] == v else 1 if faces[f, 1] == v else 2
            p, q = faces[f, (corner + 1) % 3], faces[f, (corner + 2) % 3]
            for w in (p, q):
                if leaves[w] != v + 1 and enters[w] != v + 1:
                    rings[2 * starts[v] + size] = w
                    size += 1
            single = single and leaves[p] != v + 1 and enters[q] != v + 1
            leaves[p], enters[q], after[p] = v + 1, v + 1, q
            for r in range(3):
                a[r], b[r] = points[p, r] - points[v, r], points[q, r] - points[v, r]
            _cross(a, b, c)
            areas[v] += math.sqrt(c[0] ** 2 + c[1] ** 2 + c[2] ** 2)
            for r in range(3):
                vectors[v, r] += c[r]
        apart, sizes[v] = 0, size
        for place in range(2 * starts[v], 2 * starts[v] + size):
            w = rings[place]
            if enters[w] != v + 1:  # an open fan begins at the neighbour that no face comes to
                begin = w
            square = 0.0
            for r in range(3):
                square += (points[w, r] - points[v, r]) ** 2
            if square > 0:
                logarithms += math.log(square)
                apart += 1
        spacings[v] = math.exp(logarithms / max(2 * apart, 1))
        rim[v] = begin >= 0
        start = begin if begin >= 0 or size == 0 else rings[2 * starts[v]]
        w, walked = start, 0
        while w >= 0 and single and leaves[w] == v + 1 and (w != start or walked == 0):
            w = after[w]
            walked += 1
        whole[v] = single and 0 < walked == starts[v + 1] - starts[v]


@compiled()
def fit_quadrics(
    points: Floats,
    normals: Floats,
    starts: Ints32,
    rings: Ints32,
    sizes: Ints32,
    passed: Bools,
    growing: bool,
    scales: Floats,
    principal: Floats,
    directions: Floats,
    fitted: Floats,
    failures: Bytes,
    first: int,
    last: int,
) -> None:
    """Write curvatures, directions and normals of quadrics at the points from `first` to `last`.

    The neighbours are those that a walk along the `rings` comes to, within ``scales[i]`` of point
    i, through points that may be `passed`, and on its side of the shape. If these scales may be
    `growing`, they do where neighbours are too few. Points that have failed before are left out.
    """
    n = len(points)
    seen, queue, mark = np.zeros(n, np.int32), np.empty(n, np.int32), 0
    u, v, A, b = np.empty(3), np.empty(3), np.empty((6, 6)), np.empty(6)
    for i in range(first, last):
        if failures[i]:
            continue
        normal = normals[i]
        _frame(normal, u, v)
        for growth in range(_GROWTHS if growing else 1):
            scale = scales[i] * _GROWTH**growth
            mark += 1
            size = _gather(
                points, normals, starts, rings, sizes, passed, i, points[i], u, v, normal,
                scale, seen, mark, queue, A, b,
            )  # fmt: skip
            failures[i] = 0 if size > _NEIGHBOURS and _solve(A, b) else FEW
            if failures[i] == 0:
                scales[i] = scale
                _bend(b, scale, u, v, normal, principal[i], directions[i], fitted[i])
                break


@compiled()
def land(
    points: Floats,
    normals: Floats,
    starts: Ints32,
    rings: Ints32,
    sizes: Ints32,
    passed: Bools,
    near: int,
    place: Floats,
    normal: Floats,
    towards: Floats,
    scale: float,
) -> tuple[int, float]:
    """Put a place on the quadric of the points around it, along a normal, and turn what it holds.

    `near` is a point beside it; the scale grows where neighbours are too few. In place: `place`
    lands, `normal` becomes the one there, and `towards`, a tangent vector, is carried along. Return
    the nearest point, or -1 if there are never enough; and how much the quadric bends to the side
    of the normal along `towards`, if that is a unit vector.
    """
    n = len(points)
    seen, queue = np.zeros(n, np.int32), np.empty(n, np.int32)
    u, v, A, b = np.empty(3), np.empty(3), np.empty((6, 6)), np.empty(6)
    _frame(normal, u, v)
    for growth in range(_GROWTHS):
        size = _gather(
            points, normals, starts, rings, sizes, passed, near, place, u, v, normal,
            scale, seen, growth + 1, queue, A, b,
        )  # fmt: skip
        if size > _NEIGHBOURS and _solve(A, b):
            break
        scale *= _GROWTH
    else:
        return -1, 0.0
    l = math.sqrt(1 + b[1] ** 2 + b[2] ** 2)
    after, leans, across, x, y = np.empty(3), 0.0, 0.0, 0.0, 0.0
    for r in range(3):
        place[r] += scale * b[0] * normal[r]
        after[r] = (normal[r] - b[1] * u[r] - b[2] * v[r]) / l
        leans, across = leans + after[r] * normal[r], across + after[r] * towards[r]
    for r in range(3):  # by the least rotation that takes one normal to the other
        towards[r] -= across / (1 + leans) * (normal[r] + after[r])
        normal[r] = after[r]
        x, y = x + towards[r] * u[r], y + towards[r] * v[r]
    nearest, least = near, np.inf
    for j in range(size):
        square = 0.0
        for r in range(3):
            square += (points[queue[j], r] - place[r]) ** 2
        if square < least:
            nearest, least = queue[j], square
    return nearest, (b[3] * x * x + 2 * b[4] * x * y + b[5] * y * y) / (l * scale)


@register_jitable
def _gather(
    points: Floats,
    normals: Floats,
    starts: Ints32,
    rings: Ints32,
    sizes: Ints32,
    passed: Bools,
    near: int,
    place: Floats,
    u: Floats,
    v: Floats,
    normal: Floats,
    scale: float,
    seen: Ints32,
    mark: int,
    queue: Ints32,
    A: Floats,
    b: Floats,
) -> int:
    """Sum up least squares ``A c = b``, its lower triangle, of a quadric around a place.

    The points are those that a walk from `near` comes to; they are put into `queue`, and their
    number is returned.
    """
    inverse, p = 1 / scale, np.ones(6)
    seen[near], queue[0], size, head = mark, near, 1, 0
    A[:], b[:] = 0.0, 0.0
    while head < size:
        w = queue[head]
        head += 1
        dx = (points[w, 0] - place[0]) * inverse
        dy = (points[w, 1] - place[1]) * inverse
        dz = (points[w, 2] - place[2]) * inverse
        x = dx * u[0] + dy * u[1] + dz * u[2]
        y = dx * v[0] + dy * v[1] + dz * v[2]
        z = dx * normal[0] + dy * normal[1] + dz * normal[2]
        # It fades: a fit changes with the scale without jumps.
        weight = max(1 - (dx * dx + dy * dy + dz * dz), 0.0) ** 2
        p[1], p[2], p[3], p[4], p[5] = x, y, x * x / 2, x * y, y * y / 2
        for j in range(6):
            share = weight * p[j]
            b[j] += share * z
            for k in range(j + 1):
                A[j, k] += share * p[k]
        if w != near and not passed[w]:
            continue
        for at in range(2 * starts[w], 2 * starts[w] + sizes[w]):
            other = rings[at]
            if seen[other] == mark:
                continue
            seen[other] = mark
            square, across = 0.0, 0.0
            for r in range(3):
                square += ((points[other, r] - place[r]) * inverse) ** 2
                across += normals[other, r] * normal[r]
            if square < 1 and (across > _TURNED or not passed[other]):
                queue[size] = other
                size += 1
    return size


@register_jitable
def _cross(a: Floats, b: Floats, out: Floats) -> None:
    for r in range(3):
        out[r] = a[(r + 1) % 3] * b[(r + 2) % 3] - a[(r + 2) % 3] * b[(r + 1) % 3]


@register_jitable
def _frame(normal: Floats, u: Floats, v: Floats) -> None:
    """Write two axes that are across a unit vector, right-handed: those of `frames_of`."""
    x, y, z = normal
    side = math.copysign(1.0, z)
    a = -1 / (side + z)
    u[0], u[1], u[2] = 1 + side * x * x * a, side * x * y * a, -side * x
    v[0], v[1], v[2] = x * y * a, side + y * y * a, -y


@register_jitable
def _solve(A: Floats, b: Floats) -> bool:
    """Solve ``A x = b`` in place by Cholesky's factor; tell whether that is well determined.

    Written out here: LAPACK takes longer to call than six unknowns to eliminate.
    """
    for j in range(len(b)):
        whole = A[j, j]
        for k in range(j):
            A[j, j] -= A[j, k] ** 2
        if not A[j, j] > _SINGULAR * whole:
            return False
        A[j, j] = math.sqrt(A[j, j])
        for i in range(j + 1, len(b)):
            for k in range(j):
                A[i, j] -= A[i, k] * A[j, k]
            A[i, j] /= A[j, j]
    for j in range(len(b)):
        for k in range(j):
            b[j] -= A[j, k] * b[k]
        b[j] /= A[j, j]
    for j in range(len(b) - 1, -1, -1):
        for k in range(j + 1, len(b)):
            b[j] -= A[k, j] * b[k]
        b[j] /= A[j, j]
    return True


@register_jitable
def _bend(
    b: Floats,
    scale: float,
    u: Floats,
    v: Floats,
    normal: Floats,
    principal: Floats,
    directions: Floats,
    fitted: Floats,
) -> None:
    """Write what bends the graph of ``b0 + b1 x + b2 y + b3 x^2 / 2 + b4 x y + b5 y^2 / 2`` at 0.

    In its tangent plane the axes are up the slope and along the contour: in these, the second
    fundamental form is symmetric, and its eigenvalues are the principal curvatures.
    """
    slope = math.hypot(b[1], b[2])
    p, q = (b[1] / slope, b[2] / slope) if slope > 0 else (1.0, 0.0)
    l = math.hypot(1.0, slope)
    up = -(b[3] * p * p + 2 * b[4] * p * q + b[5] * q * q) / (l**3 * scale)
    mixed = -(b[4] * (p * p - q * q) + (b[5] - b[3]) * p * q) / (l**2 * scale)
    along = -(b[3] * q * q - 2 * b[4] * p * q + b[5] * p * p) / (l * scale)
    middle, half = (up + along) / 2, math.hypot((up - along) / 2, mixed)
    principal[0], principal[1] = middle + half, middle - half
    angle = math.atan2(mixed, (up - along) / 2) / 2
    cos, sin = math.cos(angle), math.sin(angle)
    for r in range(3):
        rise = (p * u[r] + q * v[r] + slope * normal[r]) / l
        contour = p * v[r] - q * u[r]
        fitted[r] = (normal[r] - b[1] * u[r] - b[2] * v[r]) / l
        directions[0, r] = cos * rise + sin * contour
    _cross(fitted, directions[0], directions[1])
