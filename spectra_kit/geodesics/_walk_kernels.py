"""Straight lines over unfolded triangles, from face to face; compiled by numba on first use.

A line heads for a point that lies at (x, y) once the faces up to there are unfolded into the plane
of the face that it crosses, in the frame of the side by which it came in. Sides, frames, soups and
fronts are those of `_exact_kernels`. Segments lie in `faces` (m,), and `ends` (m, 2, 3) are the
barycentric coordinates in these of their ends.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba.extending import register_jitable

from spectra_kit._core.compiled import compiled
from spectra_kit._core.types import Floats, Ints

if TYPE_CHECKING:  # a compiled file stands on its own
    from spectra_kit.geodesics._exact_kernels import Front, Soup

# Of the longest side of a face: a line this near to a corner meets it. What that adds to a path is
# of second order.
_TOUCH = 1e-9
_ROOM = 64  # segments to begin with
MOST = 2**22  # segments that are a path, and not a length in another unit
#: How a line ends: where it heads for; at a corner; at an edge of one face, or of more than two;
#: after too many segments.
THERE, CORNER, EDGE, ENDLESS = 0, 1, 2, 3

Line = tuple[Ints, Floats, int, int, int, float, float]


@compiled()
def trace(soup: Soup, side: int, angle: float, length: float) -> Line:
    """Follow the line of some length that leaves the tail of a side at an angle to it.

    Return its segments, how many these are, how it ended, the side that begins at the corner met,
    at which angle to that it came, and how much of the length is missing.
    """
    no, (faces, ends) = np.empty(0, np.int64), _buffers()
    x, y = length * np.cos(angle), length * np.sin(angle)
    return _line(soup, no, no, side, 0, x, y, -1, faces, ends, 0)


@compiled()
def backtrace(soup: Soup, front: Front, v: int) -> tuple[Ints, Floats, int, int, float]:
    """Follow the shortest path from vertex v back to its source.

    Return its segments, how many these are, and how it leaves the source: the side that begins
    there, of its face, and the angle to that. A side of -1 where it cannot be followed.
    """
    faces, ends = _buffers()
    count, met, angle = 0, -1, 0.0
    while front.arrived[v, 0] >= 0:
        side, passage = front.arrived[v, 0], front.arrived[v, 2]
        if passage >= -1:
            x, y = front.seen[v, 0], -front.seen[v, 1]
            faces, ends, count, how, met, angle, _ = _line(
                soup, front.came, front.earlier, side, 2, x, y, passage, faces, ends, count
            )
            if how != CORNER or front.d[soup.tails[met]] >= front.d[v]:
                return faces, ends, count, -1, 0.0
        else:  # along a side
            faces, ends = _roomy(faces, ends, count)
            following = side - side % 3 + (side + 1) % 3
            back = soup.tails[side] != v  # from head to tail
            faces[count] = side // 3
            _put(ends, count, 0, (following if back else side) % 3, 0.0)
            _put(ends, count, 1, (side if back else following) % 3, 0.0)
            met = side if back else following
            angle = 0.0 if back else np.arctan2(soup.apex_y[met], soup.apex_x[met])
            count += 1
        v = soup.tails[met]
    return faces, ends, count, met, angle


@register_jitable
def _buffers() -> tuple[Ints, Floats]:
    return np.empty(_ROOM, np.int64), np.empty((_ROOM, 2, 3))


@register_jitable
def _roomy(faces: Ints, ends: Floats, count: int) -> tuple[Ints, Floats]:
    """Return the same, with room for one segment more."""
    if count < len(faces):
        return faces, ends
    more, further = np.empty(2 * count, np.int64), np.empty((2 * count, 2, 3))
    for i in range(count):
        more[i] = faces[i]
        for c in range(3):
            further[i, 0, c], further[i, 1, c] = ends[i, 0, c], ends[i, 1, c]
    return more, further


@register_jitable
def _put(ends: Floats, count: int, which: int, c: int, share: float) -> None:
    """Write an end of a segment: at a share of the side from corner c on."""
    for k in range(3):
        ends[count, which, k] = 0.0
    ends[count, which, c], ends[count, which, (c + 1) % 3] = 1 - share, share


@register_jitable
def _line(
    soup: Soup,
    came: Ints,
    earlier: Ints,
    side: int,
    corner: int,
    x: float,
    y: float,
    passage: int,
    faces: Ints,
    ends: Floats,
    count: int,
) -> Line:
    """Follow the line from a corner, by its number from the tail of a side, which sees (x, y).

    Return what `trace` does, after the segments that were there.
    """
    px, py = _corner(soup, side, corner)
    begin, share, entry = (side + corner) % 3, 0.0, -1  # it begins on a side, and which that is
    while count < MOST:
        faces, ends = _roomy(faces, ends, count)
        dx, dy = x - px, y - py
        r = np.hypot(dx, dy)
        faces[count] = side // 3
        _put(ends, count, 0, begin, share)
        touch = _TOUCH * max(soup.lengths[side], np.hypot(soup.apex_x[side], soup.apex_y[side]))
        met, nearest = -1, np.inf
        for k in range(3):
            cx, cy = _corner(soup, side, k)
            cx, cy = cx - px, cy - py
            along = (cx * dx + cy * dy) / r
            if (
                k != corner
                and touch < along <= r + touch
                and along < nearest
                and abs(cx * dy - cy * dx) <= touch * r
            ):
                met, nearest = k, along
        if met >= 0:
            _put(ends, count, 1, (side + met) % 3, 0.0)
            ax, ay = _in_side(soup, side, met, px, py)
            met = side - side % 3 + (side + met) % 3
            return faces, ends, count + 1, CORNER, met, np.arctan2(ay, ax), r - nearest
        # Of the sides that (x, y) is beyond, the line crosses the nearest.
        out, first = -1, np.inf
        for k in range(3):
            if k in (entry, corner) or (k + 1) % 3 == corner:
                continue
            _, above = _in_side(soup, side, k, px, py)
            _, beyond = _in_side(soup, side, k, x, y)
            if beyond < 0:
                way = max(above, 0.0) / (max(above, 0.0) - beyond)
                if way < first:
                    out, first = k, way
        if out < 0:
            two = y / soup.apex_y[side]
            one = (x - two * soup.apex_x[side]) / soup.lengths[side]
            for k, weight in enumerate((1 - one - two, one, two)):
                ends[count, 1, (side + k) % 3] = weight
            return faces, ends, count + 1, THERE, -1, 0.0, 0.0
        t = side - side % 3 + (side + out) % 3
        L = soup.lengths[t]
        at, _ = _in_side(soup, side, out, px + first * dx, py + first * dy)
        at = min(max(at, 0.0), L)
        _put(ends, count, 1, t % 3, at / L)
        count += 1
        u = soup.around[t]
        two_faces = u != t and soup.around[u] == t
        if not two_faces and passage < 0:
            return faces, ends, count, EDGE, t, 0.0, r * (1 - first)
        if not two_faces:
            u, passage = came[passage], earlier[passage]
        x, y = _in_side(soup, side, out, x, y)
        if soup.tails[u] != soup.tails[t]:
            at, x = L - at, L - x
        px, py, y = at, 0.0, -y
        side, corner, entry, begin, share = u, -1, 0, u % 3, at / L
    return faces, ends, count, ENDLESS, -1, 0.0, 0.0


@register_jitable
def _corner(soup: Soup, side: int, k: int) -> tuple[float, float]:
    """Return where a corner of its face, by its number from the tail on, lies in a side's frame."""
    if k == 0:
        return 0.0, 0.0
    return (soup.lengths[side], 0.0) if k == 1 else (soup.apex_x[side], soup.apex_y[side])


@register_jitable
def _in_side(soup: Soup, side: int, k: int, x: float, y: float) -> tuple[float, float]:
    """Return a point in the frame of the side that begins at corner k, from that of a side."""
    ox, oy = _corner(soup, side, k)
    hx, hy = _corner(soup, side, (k + 1) % 3)
    L = np.hypot(hx - ox, hy - oy)
    ex, ey = (hx - ox) / L, (hy - oy) / L
    return (x - ox) * ex + (y - oy) * ey, (y - oy) * ex - (x - ox) * ey
