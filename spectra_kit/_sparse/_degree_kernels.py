"""Inner loops of `minimum_degree`, compiled by numba on first use."""

from __future__ import annotations

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from spectra_kit._core.compiled import compiled

Ints = NDArray[np.int32]
Longs = NDArray[np.int64]


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


@compiled(_nrt=False)
def eliminate(
    starts: Ints, columns: Ints, order: Ints, lists: Ints, longs: Longs, ints: Ints, state: Longs
) -> int:
    """Write the points to `order`, in that in which they are eliminated.

    Returns 0 at the end; before, how long `lists` must be to go on: call again with longer ones,
    which begin with what is there.

    In a quotient graph: an eliminated point is a front, which stands for the edges between all its
    points. Points with the same neighbours are merged. Degrees are bounds from above.

    To work in: `lists` (2 len(columns) + n,), zeros `longs` (4, n), -1 in `ints` (11, n + 1), and
    zeros `state` (5,). Each kind of array that a loop makes itself costs a tenth of a second to
    compile.
    """
    n = len(starts) - 1
    # Beside v: so many `fronts` from ``begin[v]`` on, then points, up to ``end[v]``, in place of
    # its neighbours. Those of a front are its points, at the tail when it is made.
    begin, end, fronts = longs[0], longs[1], ints[0]
    degree = ints[1]  # of a front: 0 if another one holds it
    weight = ints[2]  # how many were merged: 0 if gone, negative while in the front
    follower, last = ints[3], ints[4]  # merged into v
    head, after, before = ints[5], ints[6], ints[7]
    outside = longs[2]  # of a front: `mark` and weight not in the new one
    bucket, chain = ints[8], ints[9]
    key, seen = ints[10], longs[3]
    done, least, tail, stamp, mark = state[0], state[1], state[2], state[3], state[4]
    for v in range(n if mark == 0 else 0):
        begin[v], fronts[v], weight[v], last[v] = tail, 0, 1, v
        for p in range(starts[v], starts[v + 1]):
            if columns[p] != v:
                lists[tail] = columns[p]
                tail += 1
        end[v] = tail
        degree[v] = tail - begin[v]
        # The same v of 32 bits, as below: nothing is compiled for two kinds of integers.
        _put(last[v], degree[v], head, after, before)
    if mark == 0:
        mark += 1
    while done < n:
        while head[least] < 0:
            least += 1
        pivot = head[least]
        # Its front takes the points beside it, and those of the fronts beside it.
        own = begin[pivot] + fronts[pivot]
        most = end[pivot] - own
        for p in range(begin[pivot], own):
            most += end[lists[p]] - begin[lists[p]]
        if tail + most > len(lists):
            state[0], state[1], state[2], state[3], state[4] = done, least, tail, stamp, mark
            return tail + most  # type: ignore[no-any-return]  # `int` would be compiled
        _take(pivot, head, after, before)
        size = weight[pivot]
        weight[pivot] = 0
        first, total = tail, 0
        for p in range(begin[pivot], own + 1):
            low, high = own, end[pivot]
            if p < own:
                e = lists[p]
                if degree[e] == 0:
                    continue
                degree[e] = 0
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
                if degree[e] > 0:
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
                if degree[e] > 0:
                    if outside[e] > mark:
                        bound += outside[e] - mark
                        total_key += e
                        lists[at] = e
                        at += 1
                    else:  # the new one holds all of it
                        degree[e] = 0
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
            if degree[v] > bound:
                degree[v] = bound
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
                degree[v] += total - weight[v]
                if degree[v] > n - done - size - weight[v]:
                    degree[v] = n - done - size - weight[v]
                _put(v, degree[v], head, after, before)
                if least > degree[v]:
                    least = degree[v]
                lists[tail] = v
                tail += 1
        end[pivot], degree[pivot] = tail, total
        while pivot >= 0:
            order[done] = pivot
            done += 1
            pivot = follower[pivot]
    return 0
