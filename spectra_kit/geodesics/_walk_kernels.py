"""Straight lines over unfolded triangles, from face to face; compiled by numba on first use.

The frame of a *face* is that of its side 0: corner 0 is the origin, corner 1 lies on the x axis,
corner 2 above it. A line heads for a point that lies at (x, y) once the faces up to there are
unfolded into the plane. Sides, soups and fronts are those of `_exact_kernels`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba.extending import register_jitable

from spectra_kit._core.compiled import compiled
from spectra_kit._core.types import Floats, Ints

# Of the longest side of a face: a line this near to a corner meets it. What that adds to a path is
# of second order.
_TOUCH = 1e-9
#: How a line ends: where it heads for; at a corner; at an edge of one face, or of more than two.
THERE, CORNER, BOUNDARY, BRANCH = 0, 1, 2, 3
#: In place of a count of segments: they do not fit; a path cannot be followed.
NO_ROOM, LOST = -1, -2


class Surface(NamedTuple):
    """What a walk needs of a `Soup`."""

    tails: Ints
    lengths: Floats
    apex_x: Floats
    apex_y: Floats
    around: Ints


class Ways(NamedTuple):
    """What a walk back needs of a `Front`."""

    d: Floats
    arrived: Ints
    seen: Floats
    came: Ints
    earlier: Ints


@compiled()
def trace(
    surface: Surface, face: int, corner: int, x: float, y: float, faces: Ints, ends: Floats
) -> tuple[int, int, int, float, float]:
    """Follow the line from a corner of a face towards (x, y), which its angle sees, in its frame.

    Return how many segments were written to `faces` and `ends`, how it ended, the corner met as a
    side that begins there, and how far on (x, y) still is, in the frame of the last face.
    """
    no = np.empty(0, np.int64)
    return _line(surface, no, no, face, corner, x, y, -1, faces, ends, 0)


@compiled()
def backtrace(surface: Surface, ways: Ways, v: int, faces: Ints, ends: Floats) -> int:
    """Write the segments of the shortest path from vertex v back to its source; return how many.

    Each lies in a face of `faces` (m,); `ends` (m, 2, 3) are the barycentric coordinates in it of
    its ends. `NO_ROOM` or `LOST` where it cannot.
    """
    return _back(surface, ways, v, faces, ends)


@compiled()
def last_segments(
    surface: Surface, ways: Ways, faces: Ints, ends: Floats, last: Ints, at: Floats
) -> int:
    """Write of each vertex the last face (n,) on its way back, and where it comes in, (n, 3).

    A face of -1 where there is no way; the room for one path is in `faces` and `ends`.
    """
    for v in range(len(last)):
        last[v] = -1
        if ways.arrived[v, 0] < 0:
            continue
        count = _back(surface, ways, v, faces, ends)
        if count == NO_ROOM:
            return NO_ROOM
        if count > 0:
            last[v] = faces[count - 1]
            at[v] = ends[count - 1, 0]
    return 0


@register_jitable
def _back(surface: Surface, ways: Ways, v: int, faces: Ints, ends: Floats) -> int:
    count = 0
    while ways.arrived[v, 0] >= 0:
        if count + 1 >= len(faces):
            return NO_ROOM
        side, passage = ways.arrived[v, 0], ways.arrived[v, 2]
        if passage < -1:  # along a side
            c = side % 3
            start, end = (c, (c + 1) % 3) if surface.tails[side] == v else ((c + 1) % 3, c)
            faces[count] = side // 3
            ends[count] = 0.0
            ends[count, 0, start] = ends[count, 1, end] = 1.0
            count += 1
            v = ways.arrived[v, 1]
            continue
        x, y = _in_face(surface, side, ways.seen[v, 0], -ways.seen[v, 1])
        corner = (side % 3 + 2) % 3
        count, how, met, _, _ = _line(
            surface, ways.came, ways.earlier, side // 3, corner, x, y, passage, faces, ends, count
        )
        if how != CORNER or ways.d[surface.tails[met]] >= ways.d[v]:
            return NO_ROOM if how == NO_ROOM else LOST
        v = surface.tails[met]
    return count


@register_jitable
def _line(
    surface: Surface,
    came: Ints,
    earlier: Ints,
    face: int,
    corner: int,
    x: float,
    y: float,
    passage: int,
    faces: Ints,
    ends: Floats,
    count: int,
) -> tuple[int, int, int, float, float]:
    """Follow a line from a corner of a face towards (x, y), in its frame; see `trace`."""
    px, py = _corner(surface, face, corner)
    entry = -1  # the side of the face by which it came in
    start = np.zeros(3)
    start[corner] = 1.0
    while count + 1 < len(faces):
        dx, dy = x - px, y - py
        r = np.hypot(dx, dy)
        faces[count] = face
        ends[count, 0] = start
        touch = _TOUCH * max(surface.lengths[3 * face], surface.lengths[3 * face + 1])
        met, nearest = -1, np.inf
        for c in range(3):
            if c == corner:
                continue
            cx, cy = _corner(surface, face, c)
            cx, cy = cx - px, cy - py
            along = (cx * dx + cy * dy) / r
            if (
                touch < along <= r + touch
                and along < nearest
                and abs(cx * dy - cy * dx) <= touch * r
            ):
                met, nearest = c, along
        if met >= 0:
            ends[count, 1] = 0.0
            ends[count, 1, met] = 1.0
            return count + 1, CORNER, 3 * face + met, dx * (1 - nearest / r), dy * (1 - nearest / r)
        # Of the sides that (x, y) is beyond, the line crosses the nearest.
        out, first = -1, np.inf
        for c in range(3):
            if c in (entry, corner) or (c + 1) % 3 == corner:
                continue
            _, above = _in_side(surface, 3 * face + c, px, py)
            _, beyond = _in_side(surface, 3 * face + c, x, y)
            if beyond < 0:
                share = max(above, 0.0) / (max(above, 0.0) - beyond)
                if share < first:
                    out, first = c, share
        if out < 0:
            L, (ax, ay) = surface.lengths[3 * face], _corner(surface, face, 2)
            two = y / ay
            one = (x - two * ax) / L
            ends[count, 1, 0], ends[count, 1, 1], ends[count, 1, 2] = 1 - one - two, one, two
            return count + 1, THERE, -1, 0.0, 0.0
        t = 3 * face + out
        L = surface.lengths[t]
        at, _ = _in_side(surface, t, px + first * dx, py + first * dy)
        at = min(max(at, 0.0), L)
        ends[count, 1] = 0.0
        ends[count, 1, out], ends[count, 1, (out + 1) % 3] = 1 - at / L, at / L
        count += 1
        u = surface.around[t]
        if u == t:
            return count, BOUNDARY, t, dx * (1 - first), dy * (1 - first)
        if surface.around[u] != t:
            if passage < 0:
                return count, BRANCH, t, dx * (1 - first), dy * (1 - first)
            u, passage = came[passage], earlier[passage]
        tx, ty = _in_side(surface, t, x, y)
        if surface.tails[u] != surface.tails[t]:
            at, tx = L - at, L - tx
        face, entry, corner = u // 3, u % 3, -1
        x, y = _in_face(surface, u, tx, -ty)
        px, py = _in_face(surface, u, at, 0.0)
        start[:] = 0.0
        start[entry], start[(entry + 1) % 3] = 1 - at / L, at / L
    return count, NO_ROOM, -1, 0.0, 0.0


@register_jitable
def _corner(surface: Surface, face: int, c: int) -> tuple[float, float]:
    """Return where a corner lies in the frame of its face."""
    if c == 0:
        return 0.0, 0.0
    if c == 1:
        return surface.lengths[3 * face], 0.0
    return surface.apex_x[3 * face], surface.apex_y[3 * face]


@register_jitable
def _axis(surface: Surface, side: int) -> tuple[float, float, float, float]:
    """Return origin and x axis of a side's frame in that of its face."""
    face, c = side // 3, side % 3
    ox, oy = _corner(surface, face, c)
    hx, hy = _corner(surface, face, (c + 1) % 3)
    L = np.hypot(hx - ox, hy - oy)
    return ox, oy, (hx - ox) / L, (hy - oy) / L


@register_jitable
def _in_face(surface: Surface, side: int, x: float, y: float) -> tuple[float, float]:
    ox, oy, ex, ey = _axis(surface, side)
    return ox + x * ex - y * ey, oy + x * ey + y * ex


@register_jitable
def _in_side(surface: Surface, side: int, x: float, y: float) -> tuple[float, float]:
    ox, oy, ex, ey = _axis(surface, side)
    return (x - ox) * ex + (y - oy) * ey, (y - oy) * ex - (x - ox) * ey
