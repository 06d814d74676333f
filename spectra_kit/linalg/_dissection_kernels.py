"""Inner loops of `nested_dissection`, compiled by numba on first use."""

from __future__ import annotations

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from spectra_kit.linalg.compiled import compiled

Ints = NDArray[np.int32]
Bits = NDArray[np.uint64]

_LEAF = 64  # points, whose neighbours are the bits of a number
_BALANCE = 0.6  # share of the points that a side may grow to


@compiled()
def hops(starts: Ints, columns: Ints, count: int) -> Ints:
    """Return how many edges all points are away from `count` landmarks, shape (count, n).

    Each component has landmarks of its own, each as far as possible from those before; its numbers
    go on from those of the component before, so that a number separates what is below from what is
    above, whatever the components.
    """
    n = len(starts) - 1
    queue, label = np.empty(n, np.int32), np.full(n, -1, np.int32)
    seeds = np.empty(n, np.int32)
    parts, tail = 0, 0
    for v in range(n):
        if label[v] < 0:
            head = tail
            label[v] = parts
            queue[tail] = v
            tail += 1
            while head < tail:
                for p in range(starts[queue[head]], starts[queue[head] + 1]):
                    if label[columns[p]] < 0:
                        label[columns[p]] = parts
                        queue[tail] = columns[p]
                        tail += 1
                head += 1
            seeds[parts] = queue[tail - 1]  # far from where the search began
            parts += 1
    found = np.full((count, n), -1, np.int32)
    nearest = np.full(n, n, np.int32)
    bases, farthest = np.empty(parts, np.int32), np.empty(parts, np.int32)
    for k in range(count):
        level = found[k]
        tail, base = 0, 0
        for c in range(parts):
            head = tail
            bases[c] = base
            level[seeds[c]] = base
            queue[tail] = seeds[c]
            tail += 1
            while head < tail:
                v = queue[head]
                for p in range(starts[v], starts[v + 1]):
                    if level[columns[p]] < 0:
                        level[columns[p]] = level[v] + 1
                        queue[tail] = columns[p]
                        tail += 1
                head += 1
            base = level[queue[tail - 1]] + 1
        farthest[:] = -1
        for v in range(n):
            c = label[v]
            nearest[v] = min(nearest[v], level[v] - bases[c])
            if nearest[v] > farthest[c]:
                farthest[c], seeds[c] = nearest[v], v
    return found


@register_jitable
def _ones(x: np.uint64) -> np.uint64:
    """Count the bits that are set."""
    x = x - ((x >> np.uint64(1)) & np.uint64(0x5555555555555555))
    x = (x & np.uint64(0x3333333333333333)) + ((x >> np.uint64(2)) & np.uint64(0x3333333333333333))
    x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (x * np.uint64(0x0101010101010101)) >> np.uint64(56)


@register_jitable
def _minimum_degree(
    starts: Ints, columns: Ints, items: Ints, place: Ints, inside: Bits, outside: Bits
) -> None:
    """Order at most 64 `items` by minimum degree; those outside come later, counted by a hash."""
    one, m = np.uint64(1), len(items)
    for a in range(m):
        place[items[a]] = a
    for a in range(m):
        here, there = np.uint64(0), np.uint64(0)
        for p in range(starts[items[a]], starts[items[a] + 1]):
            w = columns[p]
            if place[w] >= 0:
                here |= one << np.uint64(place[w])
            else:
                there |= one << ((np.uint64(w) * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(58))
        inside[a], outside[a] = here & ~(one << np.uint64(a)), there
    left = np.ones(m, np.bool_)
    chosen = items.copy()
    for k in range(m):
        best, least = -1, np.int64(200)
        for a in range(m):
            if left[a]:
                degree = np.int64(_ones(inside[a]) + _ones(outside[a]))
                if degree < least:
                    best, least = a, degree
        left[best] = False
        chosen[k] = items[best]
        bit = one << np.uint64(best)
        for a in range(m):
            if left[a] and inside[a] & bit:
                inside[a] = (inside[a] | inside[best]) & ~bit & ~(one << np.uint64(a))
                outside[a] |= outside[best]
    for a in range(m):
        place[items[a]] = -1
    items[:] = chosen


@register_jitable
def _cheapest(items: Ints, levels: Ints, count: Ints, least: float) -> tuple[int, int]:
    """Return the landmark and the number of hops from it that separate `items` best.

    At least the share `least` of them must lie on each side; -1 if there is no such number.
    """
    m, best, landmark, cut = len(items), np.inf, -1, 0
    for k in range(len(levels)):
        level = levels[k]
        low = high = level[items[0]]
        for v in items:
            count[level[v]] += 1
            low, high = min(low, level[v]), max(high, level[v])
        below = 0
        for x in range(low, high + 1):
            above = m - below - count[x]
            if min(below, above) >= max(least * m, 1):
                cost = count[x] * (1.0 + abs(below - above) / m)
                if cost < best:
                    best, landmark, cut = cost, k, x
            below += count[x]
            count[x] = 0
    return landmark, cut


@register_jitable
def _count_sides(starts: Ints, columns: Ints, side: Ints, mark: int, v: int, beside: Ints) -> None:
    """Write how many neighbours of v are on either side."""
    beside[v, 0] = beside[v, 1] = 0
    for p in range(starts[v], starts[v + 1]):
        where = side[columns[p]] - mark
        if where == 1 or where == 2:
            beside[v, where - 1] += 1


@register_jitable
def _refine(
    starts: Ints,
    columns: Ints,
    side: Ints,
    mark: int,
    separator: Ints,
    many: int,
    sizes: Ints,
    beside: Ints,
    fixed: Ints,
) -> bool:
    """Make the first `many` points of `separator` fewer; return whether that went well.

    One pass of Fiduccia and Mattheyses: the best point moves to a side, even for the worse, and
    takes its neighbours on the other side into the separator; then all is undone back to the best.
    """
    m = sizes[1] + sizes[2] + many
    here = [separator[a] for a in range(many)]
    for v in here:
        _count_sides(starts, columns, side, mark, v, beside)
        fixed[v] = 0
    moves = [(np.int32(0), 0, 0) for _ in range(0)]
    taken = [np.int32(0) for _ in range(0)]
    now = least = many
    even = abs(sizes[1] - sizes[2])
    kept, idle = 0, 0
    while idle < 20 + many // 8:
        gain, best, to = -10000, -1, 0
        for a in range(len(here)):
            v = here[a]
            for s in (1, 2):
                smaller = sizes[s] < sizes[3 - s]
                if smaller or sizes[s] <= _BALANCE * m:
                    value = 2 * (1 - beside[v, 2 - s]) + (1 if smaller else 0)
                    if value > gain:
                        gain, best, to = value, a, s
        if best < 0:
            break
        v = here[best]
        here[best] = here[-1]
        here.pop()
        side[v] = mark + to
        fixed[v] = mark
        sizes[to] += 1
        pulled = 0
        for p in range(starts[v], starts[v + 1]):
            w = columns[p]
            if side[w] == mark + 3:
                beside[w, to - 1] += 1
            elif side[w] == mark + 3 - to:
                side[w] = mark + 3
                sizes[3 - to] -= 1
                pulled += 1
                taken.append(w)
                _count_sides(starts, columns, side, mark, w, beside)
                for q in range(starts[w], starts[w + 1]):
                    if side[columns[q]] == mark + 3 and columns[q] != w:
                        beside[columns[q], 2 - to] -= 1
                if fixed[w] != mark:
                    here.append(w)
        moves.append((v, to, pulled))
        now += pulled - 1
        idle += 1
        difference = abs(sizes[1] - sizes[2])
        if now < least or (now == least and difference < even):
            idle = 0 if now < least else idle
            least, even, kept = now, difference, len(moves)
    while len(moves) > kept:
        v, to, pulled = moves.pop()
        side[v] = mark + 3
        sizes[to] -= 1
        for _ in range(pulled):
            side[taken.pop()] = mark + 3 - to
            sizes[3 - to] += 1
    return least < many


@compiled()
def dissect(starts: Ints, columns: Ints, levels: Ints, passes: int, least: float) -> Ints:
    """Return the points in an order of elimination: both sides of a separator, then itself."""
    n = len(starts) - 1
    items = np.arange(n).astype(np.int32)
    side, fixed = np.zeros(n, np.int32), np.zeros(n, np.int32)
    beside = np.zeros((n, 2), np.int32)
    place, work = np.full(n, -1, np.int32), np.empty(n, np.int32)
    inside, outside = np.empty(_LEAF, np.uint64), np.empty(_LEAF, np.uint64)
    count = np.zeros(levels.max() + 1, np.int32)
    sizes = np.zeros(4, np.int32)
    stack = [(0, n)]
    mark = 0
    while len(stack) > 0:
        begin, end = stack.pop()
        mine = items[begin:end]
        if end - begin <= _LEAF:
            _minimum_degree(starts, columns, mine, place, inside, outside)
            continue
        landmark, cut = _cheapest(mine, levels, count, least)
        if landmark < 0:
            landmark, cut = _cheapest(mine, levels, count, 0.02)
        if landmark < 0:
            continue  # too close to each other to be separated
        level = levels[landmark]
        mark += 4
        sizes[:] = 0
        for v in mine:
            where = 1 if level[v] < cut else 2 if level[v] > cut else 3
            side[v] = mark + where
            sizes[where] += 1
        for _ in range(passes):
            many = 0
            for v in mine:
                if side[v] == mark + 3:
                    work[many] = v
                    many += 1
            if not _refine(starts, columns, side, mark, work, many, sizes, beside, fixed):
                break
        left = right = middle = 0
        for v in mine:
            where = side[v] - mark
            if where == 1:
                mine[left] = v
                left += 1
            elif where == 2:
                work[right] = v
                right += 1
            else:
                middle += 1
                work[n - middle] = v
        mine[left : left + right] = work[:right]
        mine[left + right :] = work[n - middle :]
        if max(left, right) < end - begin:
            stack.append((begin, begin + left))
            stack.append((begin + left, begin + left + right))
    return items
