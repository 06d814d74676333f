"""Triangles glued to an intrinsic surface without boundary, and flipped to Delaunay; numba.

Half-edge ``3 t + c`` runs along side c of triangle t, from corner c to corner c + 1. In the cover
by front and back faces, those of triangle t are ``6 t + c`` for its sides ``c = 0, 1, 2`` and
``6 t + 5 - c`` for the same side of the back face, which runs the other way. So the cover has no
boundary, and is oriented whatever the input.
"""

from __future__ import annotations

import math

import numpy as np
from numba.extending import register_jitable

from spectra_kit._core.compiled import compiled
from spectra_kit._core.types import Floats, Ints32

_COINCIDENT = 1e-12  # triangles smaller than this, in a geometry of size 1, are mollified to it
_TIE = 1e-12  # cosines that differ by less are equal, but for rounding
#: Sums of cotangents so far below zero are zero: so much, and so much of the cotangents.
ROUNDING = (1e-9, 1e-9)
_NONE, _PAIRED = -1, -2
_BEFORE = (2, 0, 1)  # corners of a triangle


def side_lengths(points: Floats, triangles: Ints32, mollify: float) -> Floats:
    """Return the length of each side ``c`` to ``c + 1`` of each triangle, shape (t, 3).

    A side ij is longer than in space by ``offset[i] + offset[j]``, so that in each triangle the
    sum of two sides exceeds the third by `mollify` times the mean side. This is the mollification
    of Sharp and Crane with an offset for each corner instead of one for all, which would smear
    the dense parts of a cloud.
    """
    sides = np.empty((len(triangles), 3))
    offsets = np.zeros(len(points))
    if _measure_sides(points, triangles, mollify, sides, offsets):
        longer = offsets[triangles]
        sides += longer + longer[:, [1, 2, 0]]
    return sides


@compiled()
def _measure_sides(
    points: Floats, triangles: Ints32, mollify: float, sides: Floats, offsets: Floats
) -> bool:
    """Write sides in space and the offsets of their ends; return whether there are any."""
    any_thin = False
    for t in range(len(triangles)):
        for c in range(3):
            tail, head, square = triangles[t, c], triangles[t, c - 2], 0.0
            for r in range(3):
                square += (points[head, r] - points[tail, r]) ** 2
            sides[t, c] = math.sqrt(square)
        wanted = mollify * max((sides[t, 0] + sides[t, 1] + sides[t, 2]) / 3, _COINCIDENT)
        for c in range(3):  # the far corners of a needle lack nothing
            lacking = wanted - (sides[t, c] + sides[t, c - 1] - sides[t, c - 2])
            if lacking > 0:
                any_thin = True
                offsets[triangles[t, c]] = max(offsets[triangles[t, c]], lacking / 2)
    return any_thin


@compiled()
def sides_by_corner(triangles: Ints32, n: int) -> tuple[Ints32, Ints32, Ints32]:
    """Sort the sides ``3 t + c`` by their lower corner; return their upper ones beside them.

    Those of point i are at ``starts[i]`` to ``starts[i + 1]``.
    """
    starts = np.zeros(n + 2, np.int32)  # of the next point each, which moves to its end
    sides, uppers = np.empty(3 * len(triangles), np.int32), np.empty(3 * len(triangles), np.int32)
    for t in range(len(triangles)):
        for c in range(3):
            starts[min(triangles[t, c], triangles[t, c - 2]) + 2] += 1
    for i in range(n):
        starts[i + 2] += starts[i + 1]
    for t in range(len(triangles)):
        for c in range(3):
            tail, head = triangles[t, c], triangles[t, c - 2]
            low = min(tail, head) + 1
            sides[starts[low]], uppers[starts[low]] = 3 * t + c, max(tail, head)
            starts[low] += 1
    return starts[:-1], sides, uppers


@compiled()
def both_faces(triangles: Ints32, lengths: Floats) -> tuple[Ints32, Floats]:
    """Return corners and sides (2 t, 3) of the front and the back of each triangle, in turn."""
    corners, sides = np.empty((2 * len(triangles), 3), np.int32), np.empty((2 * len(lengths), 3))
    for t in range(len(triangles)):
        for c in range(3):
            corners[2 * t, c] = corners[2 * t + 1, (3 - c) % 3] = triangles[t, c]
            sides[2 * t, c] = sides[2 * t + 1, 2 - c] = lengths[t, c]
    return corners, sides


@compiled()
def pair_sides(
    triangles: Ints32, starts: Ints32, sides: Ints32, uppers: Ints32, twins: Ints32
) -> bool:
    """Glue the two triangles at each edge; return whether there are two that may be, at all.

    They must run along it in opposite directions, and be no copies of each other (see `glue`).
    """
    waiting = np.empty(len(starts) - 1, np.int32)  # by upper corner: one without partner
    for low in range(len(starts) - 1):
        waiting[low] = _NONE
    for low in range(len(starts) - 1):
        unpaired = 0
        for at in range(starts[low], starts[low + 1]):
            side, other = sides[at], waiting[uppers[at]]
            if other == _NONE:
                waiting[uppers[at]] = side
                unpaired += 1
                continue
            t, c, s, b = side // 3, side % 3, other // 3, other % 3
            if other == _PAIRED or triangles[t, c] == triangles[s, b]:
                return False
            if triangles[t, _BEFORE[c]] == triangles[s, _BEFORE[b]]:
                return False
            twins[side], twins[other] = other, side
            waiting[uppers[at]] = _PAIRED
            unpaired -= 1
        if unpaired:
            return False
        for at in range(starts[low], starts[low + 1]):
            waiting[uppers[at]] = _NONE
    return True


@compiled()
def glue(
    points: Floats,
    triangles: Ints32,
    starts: Ints32,
    sides: Ints32,
    uppers: Ints32,
    sharpest: float,
    twins: Ints32,
    first: int,
    last: int,
) -> None:
    """Glue the faces at all edges whose lower corner is in ``first .. last - 1``."""
    most = 0
    for low in range(first, last):
        most = max(most, starts[low + 1] - starts[low])
    head, link = np.full(len(points), _NONE, np.int32), np.empty(most, np.int32)
    group, halves, out = (
        np.empty(most, np.int32),
        np.empty((3, most), np.int32),
        np.empty((most, 3)),
    )
    for low in range(first, last):
        begin, end = starts[low], starts[low + 1]
        for at in range(end - 1, begin - 1, -1):  # a list of sides for each upper corner
            link[at - begin], head[uppers[at]] = head[uppers[at]], at - begin
        for high in uppers[begin:end]:
            d, j = 0, head[high]
            while j != _NONE:
                group[d] = sides[begin + j]
                d, j = d + 1, link[j]
            head[high] = _NONE
            if d:
                _glue_edge(points, triangles, group[:d], low, high, sharpest, halves, out, twins)


@register_jitable
def _glue_edge(
    points: Floats,
    triangles: Ints32,
    sides: Ints32,
    low: int,
    high: int,
    sharpest: float,
    halves: Ints32,
    out: Floats,
    twins: Ints32,
) -> None:
    """Pair the triangles of one edge that continue each other best, and glue their faces.

    The cosine of the angle between them must be below `sharpest`. Copies of one triangle are
    never glued to each other, where flips would fold them away. A triangle without a partner has
    its front glued to its back, which is a boundary. `halves` and `out` are scratch.
    """
    d = len(sides)
    up, down, apex = halves[0], halves[1], halves[2]  # half-edges from and to `low`
    for j in range(d):
        t, c = sides[j] // 3, sides[j] % 3
        front, back = 6 * t + c, 6 * t + 5 - c
        up[j], down[j] = (front, back) if triangles[t, c] == low else (back, front)
        apex[j] = triangles[t, _BEFORE[c]]
        twins[up[j]], twins[down[j]] = down[j], up[j]
        if d > 1:
            i = 0
            while apex[i] != apex[j]:
                i += 1
            if i == j:
                _direction(points, low, high, apex[j], out, j)
            for r in range(3):
                out[j, r] = out[i, r]
    for _ in range(d // 2):
        best, p, q = sharpest, -1, -1
        for i in range(d):
            for j in range(i + 1, d if apex[i] != _PAIRED else 0):
                if apex[i] != apex[j] and apex[j] != _PAIRED:
                    dot = out[i, 0] * out[j, 0] + out[i, 1] * out[j, 1] + out[i, 2] * out[j, 2]
                    if dot < best - _TIE:  # the first of equals, whatever the rounding
                        best, p, q = dot, i, j
        if p < 0:
            break
        apex[p] = apex[q] = _PAIRED
        twins[up[p]], twins[down[q]] = down[q], up[p]
        twins[up[q]], twins[down[p]] = down[p], up[q]


@register_jitable
def _direction(points: Floats, low: int, high: int, apex: int, out: Floats, j: int) -> None:
    """Write the unit vector from the line through two points towards a third one, to row j.

    Views of single rows would take as long to make.
    """
    along, square = 0.0, 0.0
    for r in range(3):
        edge = points[high, r] - points[low, r]
        out[j, r] = points[apex, r] - points[low, r]
        along += edge * out[j, r]
        square += edge * edge
    norm = 0.0
    for r in range(3):
        if square > 0:
            out[j, r] -= along / square * (points[high, r] - points[low, r])
        norm += out[j, r] * out[j, r]
    if norm > 0:
        for r in range(3):
            out[j, r] /= math.sqrt(norm)


@compiled(error_model="numpy")
def flip_to_delaunay(
    tails: Ints32,
    lengths: Floats,
    twins: Ints32,
    most: int,
    slack: tuple[float, float],
    recorded: bool,
) -> tuple[bool, Ints32, Floats]:
    """Flip edges until the two angles opposite each sum to at most pi; return if all do.

    Flipping lowers the Dirichlet energy (Rippa 1990), so it comes to an end but for rounding;
    after `most` flips it is given up. In place.

    Also return both half-edges (flips, 2) of each edge that was flipped and its length (flips,)
    before, in their order; none unless `recorded`.
    """
    waiting, stack = np.empty(len(tails), np.bool_), np.empty(len(tails), np.int32)
    flipped, before = np.empty((len(tails) if recorded else 0, 2), np.int32), np.empty(0)
    if recorded:
        before = np.empty(len(tails))
    top = 0
    for h in range(len(tails)):
        waiting[h] = False
        if h < twins[h] and _is_bad(lengths, h, twins[h] + 0, slack):
            stack[top], waiting[h] = h, True
            top += 1
    flips = 0
    while top > 0:
        top -= 1
        h = stack[top] + 0  # of 64 bits: nothing is compiled for two kinds of integers
        waiting[h] = False
        g = twins[h] + 0
        if h // 3 == g // 3 or not _is_bad(lengths, h, g, slack):
            continue
        if flips == most:
            return False, flipped[:0], before[:0]
        if recorded:
            if flips == len(before):
                flipped, before = _longer(flipped, before)
            flipped[flips, 0], flipped[flips, 1], before[flips] = h, g, lengths[h]
        _flip(tails, lengths, twins, h, g)
        flips += 1
        for outer in (_next(h), _previous(h), _next(g), _previous(g)):
            low = min(outer, twins[outer])
            if not waiting[low]:
                stack[top], waiting[low] = low, True
                top += 1
    kept = flips if recorded else 0
    return True, flipped[:kept].copy(), before[:kept].copy()


@compiled(error_model="numpy")
def flip_in_order(
    tails: Ints32, lengths: Floats, twins: Ints32, leads: Ints32, most: int, least: float
) -> tuple[bool, Ints32, Floats]:
    """Flip as `flip_to_delaunay` does, in the order of the library robust_laplacian, recorded.

    It visits all edges, and again those beside one that it has flipped, after all that wait.
    `leads` has one half-edge of each edge; sums of two cotangents down to -`least` are zero to it.
    """
    n_edges, n_visits, flips = len(leads), len(leads), 0
    edges = np.empty(len(tails), np.int32)
    for e in range(n_edges):
        edges[leads[e]] = edges[twins[leads[e]]] = e
    queue, waiting = np.arange(n_edges).astype(np.int32), np.ones(n_edges, np.bool_)
    flipped, before = np.empty((len(tails), 2), np.int32), np.empty(len(tails))
    first = 0  # in a ring: no edge is in it twice
    while n_visits > 0:
        e = queue[first]
        first, n_visits = (first + 1) % n_edges, n_visits - 1
        waiting[e] = False
        h = leads[e] + 0
        g = twins[h] + 0
        if h // 3 == g // 3 or not _is_bad(lengths, h, g, (least, 0.0)):
            continue
        if flips == most:
            return False, flipped[:0], before[:0]
        if flips == len(before):
            flipped, before = _longer(flipped, before)
        flipped[flips, 0], flipped[flips, 1], before[flips] = h, g, lengths[h]
        flips += 1
        bc, ca, ad, db = _next(h), _previous(h), _next(g), _previous(g)
        new = (ca, ad, db, bc)  # where they are after it: see `_flip`
        names = (edges[bc], edges[ca], edges[ad], edges[db])
        is_lead = (
            leads[edges[bc]] == bc,
            leads[edges[ca]] == ca,
            leads[edges[ad]] == ad,
            leads[edges[db]] == db,
        )
        _flip(tails, lengths, twins, h, g)
        for j in range(4):
            edges[new[j]] = names[j]
            if is_lead[j]:
                leads[names[j]] = new[j]
        # This order of the four is what its masses agree with.
        for outer in (_previous(g), _next(g), _previous(h), _next(h)):
            if not waiting[edges[outer]]:
                queue[(first + n_visits) % n_edges] = edges[outer]
                waiting[edges[outer]] = True
                n_visits += 1
    return True, flipped[:flips].copy(), before[:flips].copy()


@compiled(error_model="numpy")
def undo_flips(lengths: Floats, slopes: Floats, flipped: Ints32, before: Floats) -> None:
    """Take flips back, and the derivatives by the lengths of all half-edges with them.

    `lengths` and `slopes` are those after the flips, and become those before them. Both halves of
    an edge have the same length, so what they have of its derivative may be split in any way.
    """
    for i in range(len(flipped) - 1, -1, -1):
        h, g = flipped[i, 0] + 0, flipped[i, 1] + 0
        bc, ca, ad, db = _next(h), _previous(h), _next(g), _previous(g)
        cd, slope = lengths[h], slopes[h] + slopes[g]
        # The outer half-edges have moved by one place: see `_flip`.
        for side in (lengths, slopes):
            side[bc], side[ca], side[ad], side[db] = side[ca], side[ad], side[db], side[bc]
        ab = lengths[h] = lengths[g] = before[i]
        # With a at 0 and b at (ab, 0), c is at (cx, up) and d at (dx, -down).
        cx = (ab * ab + lengths[ca] * lengths[ca] - lengths[bc] * lengths[bc]) / (2 * ab)
        dx = (ab * ab + lengths[ad] * lengths[ad] - lengths[db] * lengths[db]) / (2 * ab)
        up, down = 2 * _area(lengths, h) / ab, 2 * _area(lengths, g) / ab
        along, across = (cx - dx) / cd, (up + down) / cd
        slopes[ca] += slope * lengths[ca] / ab * (along + across * (ab - cx) / up)
        slopes[bc] += slope * lengths[bc] / ab * (across * cx / up - along)
        slopes[ad] += slope * lengths[ad] / ab * (across * (ab - dx) / down - along)
        slopes[db] += slope * lengths[db] / ab * (across * dx / down + along)
        slopes[h] = slope * (
            (1 - cx / ab) * (along - across * cx / up)
            - (1 - dx / ab) * (along + across * dx / down)
        )
        slopes[g] = 0.0


@register_jitable
def _longer(flipped: Ints32, before: Floats) -> tuple[Ints32, Floats]:
    """Return copies with twice the room."""
    n = len(before)
    more, longer = np.empty((2 * n, 2), np.int32), np.empty(2 * n)
    for i in range(n):  # `np.concatenate` takes longer to compile
        more[i, 0], more[i, 1], longer[i] = flipped[i, 0], flipped[i, 1], before[i]
    return more, longer


@register_jitable
def _flip(tails: Ints32, lengths: Floats, twins: Ints32, h: int, g: int) -> None:
    """Replace the edge ab of the faces abc (h: a to b) and bad (g) by cd.

    The faces become cdb (h: c to d) and dca; each outer half-edge moves by one place.
    """
    bc, ca, ad, db = _next(h), _previous(h), _next(g), _previous(g)
    a, b, c, d = tails[h], tails[g], tails[ca], tails[db]
    ab = lengths[h]
    length_bc, length_ca, length_ad, length_db = lengths[bc], lengths[ca], lengths[ad], lengths[db]
    cx = (ab * ab + length_ca * length_ca - length_bc * length_bc) / (2 * ab)
    dx = (ab * ab + length_ad * length_ad - length_db * length_db) / (2 * ab)
    height = 2 * (_area(lengths, h) + _area(lengths, g)) / ab
    lengths[h] = lengths[g] = math.hypot(cx - dx, height)
    tails[h], tails[g] = c, d
    old = (bc, ca, ad, db)
    new = (ca, ad, db, bc)
    partner = (twins[bc], twins[ca], twins[ad], twins[db])
    tails[new[0]], tails[new[1]], tails[new[2]], tails[new[3]] = b, c, a, d
    lengths[new[0]], lengths[new[1]] = length_bc, length_ca
    lengths[new[2]], lengths[new[3]] = length_ad, length_db
    for j in range(4):
        other = partner[j]
        for i in range(4):  # glued to another side of the same two faces: that has moved, too
            if partner[j] == old[i]:
                other = new[i]
        twins[new[j]], twins[other] = other, new[j]


@register_jitable
def _is_bad(lengths: Floats, h: int, g: int, slack: tuple[float, float]) -> bool:
    one, other = _cotangent(lengths, h), _cotangent(lengths, g)
    return one + other < -slack[0] - slack[1] * (abs(one) + abs(other))


@register_jitable
def _cotangent(lengths: Floats, h: int) -> float:
    """Cotangent of the angle opposite half-edge `h`."""
    a, b, c = lengths[h], lengths[_next(h)], lengths[_previous(h)]
    return float((b * b + c * c - a * a) / (4 * _area(lengths, h)))


@register_jitable
def _area(lengths: Floats, h: int) -> float:
    a, b, c = lengths[h], lengths[_next(h)], lengths[_previous(h)]
    square = (a + b + c) * (b + c - a) * (c + a - b) * (a + b - c)
    return math.sqrt(max(square, 0.0)) / 4


@register_jitable
def _next(h: int) -> int:
    return h - 2 if h % 3 == 2 else h + 1


@register_jitable
def _previous(h: int) -> int:
    return h + 2 if h % 3 == 0 else h - 1
