"""Windows of straight paths that cross a surface of triangles; compiled by numba on first use.

Inner functions are `register_jitable`: without an entry from Python for each, which would cost as
much to compile as the function itself. Memory is found, and doubled, outside for the same reason.

A *side* is number ``3 f + c``: that of face f from its corner c to corner c + 1. In the frame of a
side its tail is the origin, its head lies at (length, 0), and its face above. A *window* is a part
of a side through which straight paths leave its face, all of them from one vertex, which lies at
(x, y) once the faces between are unfolded into the plane; y is how far it is *behind* the side.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from spectra_kit._core.compiled import compiled
from spectra_kit._core.types import Floats, Ints

_TIE = 1e-10  # relative; two paths as long as each other must both go on
_TOUCH = 1e-11  # of a side; a ray this near to a vertex meets it
_SAME = 1e-9  # of a side; rays to an apex this near to each other are one line
_THIN = 1e-14  # of a side; a window this narrow is none
_IMPROVED = 1e-12  # relative; what is less does not send the paths from a vertex anew
_ALONG = -2  # in place of what a path passed: it runs along a side


class Soup(NamedTuple):
    """Triangles without coordinates; one entry for a side where nothing else is said."""

    tails: Ints
    """Vertex where the side begins."""
    lengths: Floats
    apex_x: Floats
    apex_y: Floats
    """Third corner, in the frame of the side."""
    around: Ints
    """The next side on the same edge, in a ring."""
    first: Ints
    corners: Ints
    """Vertex v begins the sides ``corners[first[v]:first[v + 1]]``."""
    bends: NDArray[np.bool_]
    """Of each vertex: shortest paths may bend there."""


class Window(NamedTuple):
    """What leaves a face through a part of a side; in the frame of that side."""

    b0: float
    b1: float
    """The part."""
    x: float
    y: float
    """Where the paths come from, y behind the side."""
    before: float
    """How long they are up to there."""
    v: int
    birth: int
    """From which vertex they came, and its `Front.births` when they left it."""
    passage: int
    """The latest entry of `Front.passed` that they are, or -1."""


class Front(NamedTuple):
    """What is known, and what is still to do."""

    d: Floats
    """Distance of each vertex, as far as it is known."""
    births: Ints
    """How often it has become shorter, where paths bend: windows from before are stale."""
    reals: Floats
    whole: Ints
    """Windows, in any order."""
    free: Ints
    """Windows that are done with, a stack."""
    keys: Floats
    items: Ints
    """Heap of windows and, as -1 - v, of vertices v to start from, by their distances."""
    passed: Floats
    """Windows that have passed an edge of more than two faces, in the direction of that side of
    it which has the least number."""
    following: Ints
    """One that passed the same edge before, or -1."""
    latest: Ints
    """The latest to pass, for that side."""
    came: Ints
    """By which side each of those that passed came to its edge."""
    earlier: Ints
    """And its own passage before, or -1."""
    arrived: Ints
    """How the shortest path came to each vertex (n, 3): by which side into its last face, from
    which vertex where it bent last, and its latest passage; or along which side, from which end,
    and less than -1. Less than 0 where it begins."""
    seen: Floats
    """Where that vertex lies in the frame of that side, as x and y of a window (n, 2)."""
    split: Floats
    """Least distance of the apex over each side, by a window that sees it."""
    split_at: Floats
    """Where on the side it came through."""
    size: Ints
    """Of the heap, of the windows, of the stack, of those that have passed; then how many targets
    are known, and how many windows there have been."""


def propagate(soup: Soup, sources: Ints, targets: Ints, d: Floats, most: int) -> Front:
    """Write to `d` (n,), infinite at first, the distances from `sources`, and how they came.

    It stops once all `targets` are known, or at more than `most` windows; what is farther may
    then be too long, or infinite.
    """
    # Entries that one step may add: by an edge of many faces, or around a vertex.
    margin = 64 + 4 * int(np.diff(soup.first).max(initial=0))
    front = _front(d, len(soup.tails), 1024 + margin, 1024 + len(sources) + margin)
    start_from(front, sources)
    while advance(soup, front, targets, most, margin):
        front = _doubled(front)
    return front


def _front(d: Floats, sides: int, room: int, heap: int) -> Front:
    """Return one that knows nothing yet, with room for so many windows and entries of the heap."""
    return Front(
        d,
        np.zeros(len(d), np.int64),
        np.empty((room, 5)),
        np.empty((room, 4), np.int64),
        np.empty(room, np.int64),
        np.empty(heap),
        np.empty(heap, np.int64),
        np.empty((room, 5)),
        np.empty(room, np.int64),
        np.full(sides, -1),
        np.empty(room, np.int64),
        np.empty(room, np.int64),
        np.full((len(d), 3), -1),
        np.zeros((len(d), 2)),
        np.full(sides, np.inf),
        np.zeros(sides),
        np.zeros(6, np.int64),
    )


def _doubled(front: Front) -> Front:
    """Return `front` with twice the room."""
    names = ("reals", "whole", "free", "keys", "items", "passed", "following", "came", "earlier")
    old = {name: getattr(front, name) for name in names}
    return front._replace(**{k: np.concatenate([v, np.empty_like(v)]) for k, v in old.items()})


@compiled()
def start_from(front: Front, sources: Ints) -> None:
    """Put the sources into the heap."""
    for v in sources:
        front.d[v] = 0.0
        _push(front.keys, front.items, front.size, 0.0, -1 - v)


@compiled(_nrt=False)  # nothing is allocated; counting references would double the time
def advance(soup: Soup, front: Front, targets: Ints, most: int, margin: int) -> bool:
    """Go on until there is nothing left to do, or return that there is no room left."""
    d, keys, size = front.d, front.keys, front.size
    while size[0] and size[5] <= most:
        if size[0] + margin > len(keys) or max(size[1], size[3]) + margin > len(front.free):
            return True
        key = keys[0]
        while size[4] < len(targets) and d[targets[size[4]]] <= key:
            size[4] += 1
        if size[4] == len(targets):
            break
        item = _pop(keys, front.items, size)
        if item >= 0:
            size[5] += _go_on(soup, front, item)
        elif key <= d[-1 - item]:  # else a shorter way was found meanwhile
            size[5] += _start(soup, front, -1 - item)
    return False


@register_jitable
def _start(soup: Soup, front: Front, v: int) -> int:
    """Send paths from vertex v along all its sides and through all its faces."""
    d, lengths = front.d[v], soup.lengths
    for i in range(soup.first[v], soup.first[v + 1]):
        s = soup.corners[i]
        for side, end in ((s, _next(s)), (_next(_next(s)), _next(_next(s)))):
            if _reach(soup, front, soup.tails[end], d + lengths[side]):
                _note(front, soup.tails[end], side, v, _ALONG, 0.0, 0.0)
    count = 0
    for i in range(soup.first[v], soup.first[v + 1]):
        t = _next(soup.corners[i])
        x, y = soup.apex_x[t], soup.apex_y[t]
        window = Window(0.0, lengths[t], x, y, d, v, front.births[v], -1)
        count += _add(soup, front, t, window, 0.0)
    return count


@register_jitable
def _go_on(soup: Soup, front: Front, item: int) -> int:
    """Let a window shine through the other faces on its edge."""
    s, v, birth = front.whole[item, 0], front.whole[item, 1], front.whole[item, 2]
    r = front.reals[item]
    window = Window(r[0], r[1], r[2], r[3], r[4], v, birth, front.whole[item, 3])
    front.free[front.size[2]] = item
    front.size[2] += 1
    if birth != front.births[v]:
        return 0
    count, length = 0, soup.lengths[s]
    t = soup.around[s]
    two_faces = soup.around[t] == s
    if not (two_faces or t == s):
        window = _unmatched(soup, front, s, window)
        if window.b1 - window.b0 <= _THIN * length:
            return 0
    turned = _turned(window, length)
    while t != s:
        same = soup.tails[t] == soup.tails[s]  # wound the other way: one direction on the edge
        count += _cross(soup, front, t, window if same else turned, two_faces)
        t = soup.around[t]
    return count


@register_jitable
def _turned(w: Window, length: float) -> Window:
    """Return the same window in the direction from the head of its side to the tail."""
    return Window(
        length - w.b1, length - w.b0, length - w.x, w.y, w.before, w.v, w.birth, w.passage
    )


@register_jitable
def _unmatched(soup: Soup, front: Front, s: int, window: Window) -> Window:
    """Return the part of a window to which no other through the edge has ways as short.

    Where sheets part at an edge and join again at another, windows would multiply without end.
    """
    edge, t = s, soup.around[s]
    while t != s:
        edge, t = min(edge, t), soup.around[t]
    length, turned = soup.lengths[s], soup.tails[edge] != soup.tails[s]
    w = _turned(window, length) if turned else window
    b0, b1, x, y, passage = w.b0, w.b1, w.x, w.y, w.passage
    i = front.latest[edge]
    while i >= 0 and b1 > b0:
        other = front.passed[i]
        low, high = max(b0, other[0]), min(b1, other[1])
        if low < high and (low == b0 or high == b1):
            least = min(_behind(low, w, other), _behind(high, w, other))
            if other[3] != y:
                # Their difference is least at an end, or where both come from one direction.
                p = (x * other[3] - other[2] * y) / (other[3] - y)
                if low < p < high:
                    least = min(least, _behind(p, w, other))
            if least >= -_TIE * (w.before + y):
                if low == b0:
                    b0 = high
                else:
                    b1 = low
        i = front.following[i]
    if b1 > b0:
        new = front.size[3]
        front.size[3] += 1
        row = front.passed[new]
        row[0], row[1], row[2], row[3], row[4] = b0, b1, x, y, w.before
        front.following[new] = front.latest[edge]
        front.latest[edge] = new
        front.came[new], front.earlier[new] = s, passage
        passage = new
    w = Window(b0, b1, x, y, w.before, w.v, w.birth, passage)
    return _turned(w, length) if turned else w


@register_jitable
def _behind(p: float, w: Window, other: Floats) -> float:
    """Return how much longer the way of one window to the point at p is than that of another."""
    return float(w.before + np.hypot(p - w.x, w.y) - other[4] - np.hypot(p - other[2], other[3]))


@register_jitable
def _cross(soup: Soup, front: Front, t: int, w: Window, two_faces: bool) -> int:
    """Let the paths through part of side t cross its face to the other two sides."""
    right = _next(t)
    left = _next(right)
    split, split_at = front.split, front.split_at
    length, ax, ay = soup.lengths[t], soup.apex_x[t], soup.apex_y[t]
    at = w.x + (ax - w.x) * w.y / (w.y + ay)  # where the ray to the apex crosses the side
    goes_left, goes_right = at > w.b0, at < w.b1
    touch = _TOUCH * length
    if w.b0 - touch <= at <= w.b1 + touch:
        far = w.before + np.hypot(ax - w.x, ay + w.y)
        if _reach(soup, front, soup.tails[left], far):
            _note(front, soup.tails[left], t, w.v, w.passage, w.x, w.y)
        # Of the windows that see an apex, only the nearest sheds shortest paths on both sides of it
        # (Chen and Han); another does so on that side where it lies from the nearest. That holds
        # for paths that cross, hence not for those that come from different faces of one edge, or
        # along one line: behind a vertex on it, each side has the part that passes there.
        if not two_faces or far <= split[t] * (1 + _TIE):
            if far < split[t]:
                split[t], split_at[t] = far, at
        elif at > split_at[t] + _SAME * length:
            goes_left = False
        elif at < split_at[t] - _SAME * length:
            goes_right = False
    count = 0
    if goes_left:
        L, part = _unfolded(soup, left, w, ax, ay, at <= w.b1)
        count += _add(soup, front, left, _turned(part, L), 1.0)
    if goes_right:  # the same in the mirror, where `right` runs from its tail
        mirror = _turned(w, length)
        L, part = _unfolded(soup, right, mirror, length - ax, ay, at >= w.b0)
        count += _add(soup, front, right, part, -1.0)
    return count


@register_jitable
def _unfolded(
    soup: Soup, side: int, w: Window, ax: float, ay: float, whole: bool
) -> tuple[float, Window]:
    """Return the length of a side from the tail to the apex (ax, ay), and what w lights of it.

    Up to the apex if it is `whole`; in coordinates along the side from the tail.
    """
    L = soup.lengths[side]
    ex, ey = ax / L, ay / L
    u0 = _meet(w.b0, w.x, w.y, ex, ey)
    u1 = L if whole else min(_meet(w.b1, w.x, w.y, ex, ey), L)
    x, y = w.x * ex - w.y * ey, w.y * ex + w.x * ey
    return L, Window(u0, u1, x, y, w.before, w.v, w.birth, w.passage)


@register_jitable
def _meet(b: float, x: float, y: float, ex: float, ey: float) -> float:
    """Return how far along (ex, ey), from the origin, the ray from (x, -y) by (b, 0) meets it."""
    below = ex * y + ey * (x - b)
    return max(y * b / below, 0.0) if below > 0 else np.inf


@register_jitable
def _add(soup: Soup, front: Front, t: int, window: Window, entered: float) -> int:
    """Keep a window on side t, unless a corner of its face has shorter ways to all of it.

    The paths entered the face by the side at the head of t (1), by that at its tail (-1), or at
    its apex (0). The tests are those of Xin and Wang.
    """
    length, d = soup.lengths[t], front.d
    x, y, before = window.x, window.y, window.before
    b0, b1 = max(window.b0, 0.0), min(window.b1, length)
    if b1 - b0 <= _THIN * length or y <= 0:
        return 0
    r0, r1 = np.hypot(b0 - x, y), np.hypot(b1 - x, y)
    slack = 1 + _TIE
    if (d[soup.tails[t]] + b1) * slack < before + r1:
        return 0
    if (d[soup.tails[_next(t)]] + length - b0) * slack < before + r0:
        return 0
    if entered != 0.0:
        # All paths cross the straight way from the apex to the end away from where they entered.
        far, r = (b1, r1) if entered > 0.0 else (b0, r0)
        apex = d[soup.tails[_next(_next(t))]]
        if (apex + np.hypot(far - soup.apex_x[t], soup.apex_y[t])) * slack < before + r:
            return 0
    if front.size[2]:
        front.size[2] -= 1
        w = front.free[front.size[2]]
    else:
        w = front.size[1]
        front.size[1] += 1
    reals, whole = front.reals[w], front.whole[w]
    reals[0], reals[1], reals[2], reals[3], reals[4] = b0, b1, x, y, before
    whole[0], whole[1], whole[2], whole[3] = t, window.v, window.birth, window.passage
    _push(front.keys, front.items, front.size, before + (y if b0 <= x <= b1 else min(r0, r1)), w)
    return 1


@register_jitable
def _next(side: int) -> int:
    """Return the next side of the same face."""
    return side + 1 if side % 3 < 2 else side - 2


@register_jitable
def _reach(soup: Soup, front: Front, v: int, far: float) -> bool:
    """Take a way of length `far` to vertex v if none is as short; where paths bend they start anew.

    Return whether it was taken.
    """
    if far >= front.d[v]:
        return False
    if soup.bends[v]:
        if far >= front.d[v] * (1 - _IMPROVED):
            return False
        front.births[v] += 1
        _push(front.keys, front.items, front.size, far, -1 - v)
    front.d[v] = far
    return True


@register_jitable
def _note(front: Front, v: int, side: int, origin: int, passage: int, x: float, y: float) -> None:
    arrived, seen = front.arrived[v], front.seen[v]
    arrived[0], arrived[1], arrived[2] = side, origin, passage
    seen[0], seen[1] = x, y


@register_jitable
def _push(keys: Floats, items: Ints, size: Ints, key: float, item: int) -> None:
    i = size[0]
    size[0] += 1
    while i > 0:
        up = (i - 1) // 2
        if keys[up] <= key:
            break
        keys[i], items[i] = keys[up], items[up]
        i = up
    keys[i], items[i] = key, item


@register_jitable
def _pop(keys: Floats, items: Ints, size: Ints) -> int:
    size[0] -= 1
    last = size[0]
    result, key, item = items[0], keys[last], items[last]
    i = 0
    while True:
        down = 2 * i + 1
        if down >= last:
            break
        if down + 1 < last and keys[down + 1] < keys[down]:
            down += 1
        if keys[down] >= key:
            break
        keys[i], items[i] = keys[down], items[down]
        i = down
    keys[i], items[i] = key, item
    return int(result)
