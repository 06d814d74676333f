"""Straight lines over unfolded triangles, from face to face; compiled by numba on first use.

The frame of a *face* is that of its side 0: corner 0 is the origin, corner 1 lies on the x axis,
corner 2 above it. A line heads for a point that lies at (x, y) once the faces up to there are
unfolded into the plane. Sides, soups and fronts are those of `_exact_kernels`. Segments lie in
`faces` (m,), and `ends` (m, 2, 3) are the barycentric coordinates in these of their ends.
"""

from __future__ import annotations

import numpy as np
from numba.extending import register_jitable

from spectra_kit._core.compiled import compiled
from spectra_kit._core.types import Floats, Ints
from spectra_kit.geodesics._exact_kernels import Front, Soup

# Of the longest side of a face: a line this near to a corner meets it. What that adds to a path is
# of second order.
_TOUCH = 1e-9
_ROOM = 64  # segments to begin with
MOST = 2**22  # segments that are a path, and not a length in another unit
#: How a line ends: where it heads for; at a corner; at an edge of one face, or of more than two;
#: after too many segments.
THERE, CORNER, EDGE, ENDLESS = 0, 1, 2, 3


@compiled()
def trace(
    soup: Soup, side: int, angle: float, length: float
) -> tuple[Ints, Floats, int, int, int, float, float]:
    """Follow the line of some length that leaves the tail of a side at an angle to it.

    Return its segments, how many these are, how it ended, the side that begins at the corner met,
    at which angle to that it came, and how much of the length is missing.
    """
    no, face = np.empty(0, np.int64), side // 3
    x, y = _in_face(soup, side, length * np.cos(angle), length * np.sin(angle))
    faces, ends = _buffers()
    faces, ends, count, how, met, x, y = _line(
        soup, no, no, face, side % 3, x, y, -1, faces, ends, 0
    )
    back = 0.0
    if how == CORNER:
        _, _, ex, ey = _axis(soup, met)
        back = np.arctan2(x * ey - y * ex, -x * ex - y * ey)
    return faces, ends, count, how, met, back, np.hypot(x, y)


@compiled()
def backtrace(soup: Soup, front: Front, v: int) -> tuple[Ints, Floats, int, int, float]:
    """Follow the shortest path from vertex v back to its source.

    Return its segments, how many these are, -1 where they cannot be followed, and how it leaves the
    source: the side that begins there, of its face, and the angle to that.
    """
    faces, ends = _buffers()
    faces, ends, count = _back(soup, front, v, faces, ends)
    side, angle = -1, 0.0
    if count > 0:
        face, x, y = faces[count - 1], 0.0, 0.0
        for c in range(3):
            if ends[count - 1, 1, c] == 1:
                side = 3 * face + c
            cx, cy = _corner(soup, face, c)
            x, y = x + ends[count - 1, 0, c] * cx, y + ends[count - 1, 0, c] * cy
        x, y = _in_side(soup, side, x, y)
        angle = np.arctan2(y, x)
    return faces, ends, count, side, angle


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
def _back(soup: Soup, front: Front, v: int, faces: Ints, ends: Floats) -> tuple[Ints, Floats, int]:
    """Write the segments of `backtrace`, and count them; -1 where the path cannot be followed."""
    count = 0
    while front.arrived[v, 0] >= 0:
        side, passage = front.arrived[v, 0], front.arrived[v, 2]
        if passage < -1:  # along a side
            c = side % 3
            start, end = (c, (c + 1) % 3) if soup.tails[side] == v else ((c + 1) % 3, c)
            faces, ends = _roomy(faces, ends, count)
            faces[count] = side // 3
            _put(ends, count, 0, start, 0.0)
            _put(ends, count, 1, end, 0.0)
            count += 1
            v = front.arrived[v, 1]
            continue
        x, y = _in_face(soup, side, front.seen[v, 0], -front.seen[v, 1])
        corner = (side % 3 + 2) % 3
        faces, ends, count, how, met, _, _ = _line(
            soup, front.came, front.earlier, side // 3, corner, x, y, passage, faces, ends, count
        )
        if how != CORNER or front.d[soup.tails[met]] >= front.d[v]:
            return faces, ends, -1
        v = soup.tails[met]
    return faces, ends, count


@register_jitable
def _line(
    soup: Soup,
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
) -> tuple[Ints, Floats, int, int, int, float, float]:
    """Follow a line from a corner of a face towards (x, y), in its frame, which its angle sees.

    Return the segments with those before, how it ended, the corner met as a side that begins there,
    and how far on (x, y) still is, in the frame of the last face.
    """
    px, py = _corner(soup, face, corner)
    entry, begin, share = -1, corner, 0.0  # by which side of the face it came in, and where there
    while count < MOST:
        faces, ends = _roomy(faces, ends, count)
        dx, dy = x - px, y - py
        r = np.hypot(dx, dy)
        faces[count] = face
        _put(ends, count, 0, begin, share)
        touch = _TOUCH * max(soup.lengths[3 * face], soup.lengths[3 * face + 1])
        met, nearest = -1, np.inf
        for c in range(3):
            if c == corner:
                continue
            cx, cy = _corner(soup, face, c)
            cx, cy = cx - px, cy - py
            along = (cx * dx + cy * dy) / r
            if (
                touch < along <= r + touch
                and along < nearest
                and abs(cx * dy - cy * dx) <= touch * r
            ):
                met, nearest = c, along
        if met >= 0:
            _put(ends, count, 1, met, 0.0)
            rest = 1 - nearest / r
            return faces, ends, count + 1, CORNER, 3 * face + met, rest * dx, rest * dy
        # Of the sides that (x, y) is beyond, the line crosses the nearest.
        out, first = -1, np.inf
        for c in range(3):
            if c in (entry, corner) or (c + 1) % 3 == corner:
                continue
            _, above = _in_side(soup, 3 * face + c, px, py)
            _, beyond = _in_side(soup, 3 * face + c, x, y)
            if beyond < 0:
                way = max(above, 0.0) / (max(above, 0.0) - beyond)
                if way < first:
                    out, first = c, way
        if out < 0:
            L, (ax, ay) = soup.lengths[3 * face], _corner(soup, face, 2)
            two = y / ay
            one = (x - two * ax) / L
            ends[count, 1, 0], ends[count, 1, 1], ends[count, 1, 2] = 1 - one - two, one, two
            return faces, ends, count + 1, THERE, -1, 0.0, 0.0
        t = 3 * face + out
        L = soup.lengths[t]
        at, _ = _in_side(soup, t, px + first * dx, py + first * dy)
        at = min(max(at, 0.0), L)
        _put(ends, count, 1, out, at / L)
        count += 1
        u = soup.around[t]
        two_faces = u != t and soup.around[u] == t
        if not two_faces and passage < 0:
            return faces, ends, count, EDGE, t, dx * (1 - first), dy * (1 - first)
        if not two_faces:
            u, passage = came[passage], earlier[passage]
        tx, ty = _in_side(soup, t, x, y)
        if soup.tails[u] != soup.tails[t]:
            at, tx = L - at, L - tx
        face, entry, corner = u // 3, u % 3, -1
        begin, share = entry, at / L
        x, y = _in_face(soup, u, tx, -ty)
        px, py = _in_face(soup, u, at, 0.0)
    return faces, ends, count, ENDLESS, -1, 0.0, 0.0


@register_jitable
def _put(ends: Floats, count: int, which: int, c: int, share: float) -> None:
    """Write an end of a segment: at a share of the side from corner c on."""
    for k in range(3):
        ends[count, which, k] = 0.0
    ends[count, which, c], ends[count, which, (c + 1) % 3] = 1 - share, share


@register_jitable
def _corner(soup: Soup, face: int, c: int) -> tuple[float, float]:
    """Return where a corner lies in the frame of its face."""
    if c == 0:
        return 0.0, 0.0
    if c == 1:
        return soup.lengths[3 * face], 0.0
    return soup.apex_x[3 * face], soup.apex_y[3 * face]


@register_jitable
def _axis(soup: Soup, side: int) -> tuple[float, float, float, float]:
    """Return origin and x axis of a side's frame in that of its face."""
    face, c = side // 3, side % 3
    ox, oy = _corner(soup, face, c)
    hx, hy = _corner(soup, face, (c + 1) % 3)
    L = np.hypot(hx - ox, hy - oy)
    return ox, oy, (hx - ox) / L, (hy - oy) / L


@register_jitable
def _in_face(soup: Soup, side: int, x: float, y: float) -> tuple[float, float]:
    ox, oy, ex, ey = _axis(soup, side)
    return ox + x * ex - y * ey, oy + x * ey + y * ex


@register_jitable
def _in_side(soup: Soup, side: int, x: float, y: float) -> tuple[float, float]:
    ox, oy, ex, ey = _axis(soup, side)
    return (x - ox) * ex + (y - oy) * ey, (y - oy) * ex - (x - ox) * ey
