"""Inner loops of `minimum_degree`, compiled by numba on first use."""

from __future__ import annotations

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from spectra_kit._core.compiled import compiled

Ints = NDArray[np.int32]


@register_jitable
def _put(v: int, degree: int, head: Ints, after: Ints, before: Ints) -> None:
    """Put a point in front of the list of those of its degree."""
    after[v], before[v] = head[degree], -1 - degree
    if head[degree] >= 0:
        before[head[degree]] = v
    head[degree] = v


@register_jitable
def _take(v: int, head: Ints, after: Ints, before: Ints) -> None:
    """Take a point out of its list."""
    if before[v] >= 0:
        after[before[v]] = after[v]
    else:
        head[-1 - before[v]] = after[v]
    if after[v] >= 0:
        before[after[v]] = before[v]


@compiled()
def eliminate(starts: Ints, columns: Ints) -> Ints:
    """Return the points in the order in which they are eliminated.

    In a quotient graph: an eliminated point is a front, which stands for the edges between all its
    points. Points with the same neighbours are merged. Degrees are bounds from above.
    """
    n = len(starts) - 1
    # Beside v: so many `fronts` from ``begin[v]`` on, then points, up to ``end[v]``, in place of
    # its neighbours. Those of a front are its points, at the tail when it is made.
    lists = np.empty(2 * len(columns) + n, np.int32)
    begin, end = np.empty(n, np.int64), np.empty(n, np.int64)
    fronts, degree = np.zeros(n, np.int32), np.empty(n, np.int32)
    weight = np.ones(n, np.int32)  # how many were merged: 0 if gone, negative while in the front
    alive = np.ones(n, np.bool_)  # fronts that no other one holds
    follower, last = np.full(n, -1, np.int32), np.arange(n).astype(np.int32)  # merged into v
    head, after, before = np.full(n + 1, -1, np.int32), np.empty(n, np.int32), np.empty(n, np.int32)
    outside, mark = np.zeros(n, np.int64), np.int64(1)  # of a front: weight not in the new one
    bucket, chain = np.full(n, -1, np.int32), np.empty(n, np.int32)
    key, seen = np.empty(n, np.int32), np.zeros(n, np.int64)
    stamp, tail = np.int64(0), np.int64(0)
    for v in range(n):
        begin[v] = tail
        for p in range(starts[v], starts[v + 1]):
            if columns[p] != v:
                lists[tail] = columns[p]
                tail += 1
        end[v] = tail
        degree[v] = tail - begin[v]
        _put(v, degree[v], head, after, before)
    order = np.empty(n, np.int32)
    done = least = 0
    while done < n:
        while head[least] < 0:
            least += 1
        pivot = head[least]
        _take(pivot, head, after, before)
        size = weight[pivot]
        weight[pivot] = 0
        # Its front takes the points beside it, and those of the fronts beside it.
        own = begin[pivot] + fronts[pivot]
        most = end[pivot] - own
        for p in range(begin[pivot], own):
            most += end[lists[p]] - begin[lists[p]]
        if tail + most > len(lists):
            longer = np.empty(2 * (tail + most), np.int32)
            longer[:tail] = lists[:tail]
            lists = longer
        first, total = tail, 0
        for p in range(begin[pivot], own + 1):
            low, high = own, end[pivot]
            if p < own:
                e = lists[p]
                if not alive[e]:
                    continue
                alive[e] = False
                low, high = begin[e], end[e]
            for q in range(low, high):
                v = lists[q]
                if weight[v] > 0:
                    total += weight[v]
                    weight[v] = -weight[v]
                    lists[tail] = v
                    tail += 1
        begin[pivot], fronts[pivot] = first, 0
        mark += n + 1
        for p in range(first, tail):
            v = lists[p]
            for q in range(begin[v], begin[v] + fronts[v]):
                e = lists[q]
                if alive[e]:
                    if outside[e] < mark:
                        outside[e] = mark + degree[e]
                    outside[e] += weight[v]
        many = tail
        for p in range(first, many):
            v = lists[p]
            _take(v, head, after, before)
            at, old, bound, total_key = begin[v], begin[v] + fronts[v], 0, np.int64(pivot)
            for q in range(at, old):
                e = lists[q]
                if alive[e]:
                    if outside[e] > mark:
                        bound += outside[e] - mark
                        total_key += e
                        lists[at] = e
                        at += 1
                    else:  # the new one holds all of it
                        alive[e] = False
            fronts[v] = at - begin[v] + 1
            if at == old:  # the pivot is among the points: its place is for its front
                q = old
                while lists[q] != pivot:
                    q += 1
                lists[q] = lists[old]
                old += 1
            lists[at] = pivot
            at += 1
            for q in range(old, end[v]):
                w = lists[q]
                if weight[w] > 0:
                    bound += weight[w]
                    total_key += w
                    lists[at] = w
                    at += 1
            end[v] = at
            if at - begin[v] == 1:  # nothing but this front: goes with it
                size -= weight[v]
                total += weight[v]
                weight[v] = 0
                follower[last[pivot]], last[pivot] = v, last[v]
                continue
            degree[v] = min(degree[v], bound)
            key[v] = total_key % n
            chain[v], bucket[key[v]] = bucket[key[v]], v
        for p in range(first, many):  # merge those with the same neighbours
            a = lists[p]
            if weight[a] == 0 or bucket[key[a]] < 0:
                continue
            a, bucket[key[a]] = bucket[key[a]], -1
            while a >= 0:
                stamp += 1
                for q in range(begin[a], end[a]):
                    seen[lists[q]] = stamp
                previous, b = a, chain[a]
                while b >= 0:
                    same = end[b] - begin[b] == end[a] - begin[a] and fronts[b] == fronts[a]
                    q = begin[b]
                    while same and q < end[b]:
                        same = seen[lists[q]] == stamp
                        q += 1
                    if same:
                        weight[a] += weight[b]
                        weight[b] = 0
                        follower[last[a]], last[a] = b, last[b]
                        chain[previous] = chain[b]
                    else:
                        previous = b
                    b = chain[b]
                a = chain[a]
        tail = first
        for p in range(first, many):
            v = lists[p]
            if weight[v] < 0:
                weight[v] = -weight[v]
                degree[v] = min(degree[v] + total - weight[v], n - done - size - weight[v])
                _put(v, degree[v], head, after, before)
                least = min(least, degree[v])
                lists[tail] = v
                tail += 1
        end[pivot], degree[pivot], alive[pivot] = tail, total, total > 0
        while pivot >= 0:
            order[done] = pivot
            done += 1
            pivot = follower[pivot]
    return order
