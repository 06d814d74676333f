"""What the order of an elimination decides of `SparseLDL`, compiled by numba on first use."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.compiled import compiled

Ints = NDArray[np.int32]
Longs = NDArray[np.int64]

# Share of zeros in what is eliminated together, and more up to so many columns: the rule of CHOLMOD
# (Chen, Davis, Hager and Rajamanickam, ACM TOMS 35, 2008), which has 0.8 and 0.1. On three real
# models of 23,000 to 90,000 points those save at most 6 % of the factor's time and take 7 to 17 %
# more memory; without any zeros it takes 8 to 36 % longer.
_ZEROS = 0.05
_NARROW = ((4, 1.0), (16, 0.4), (48, 0.15))


@compiled(_nrt=False)
def elimination_tree(
    starts: Ints,
    columns: Ints,
    order: Ints,
    ordered: Ints,
    up: Ints,
    below: Ints,
    place: Ints,
    parent: Ints,
    above: Ints,
    child: Ints,
    sibling: Ints,
    new: Ints,
) -> None:
    """Write `order` in postorder, then the parent and the entries below the diagonal of columns.

    After Liu (*The Role of Elimination Trees in Sparse Factorization*, 1990). The last six, of n
    entries as all, are to work in.
    """
    n = len(order)
    for i in range(n):
        place[order[i]] = i
        parent[i] = above[i] = child[i] = -1
    for i in range(n):
        v = order[i]
        for p in range(starts[v], starts[v + 1]):
            k = place[columns[p]]
            while k != -1 and k < i:
                next_one = above[k]  # with short cuts
                above[k] = i
                if next_one == -1:
                    parent[k] = i
                k = next_one
    for i in range(n - 1, -1, -1):
        if parent[i] >= 0:
            sibling[i] = child[parent[i]]
            child[parent[i]] = i
    stack, count = above, 0  # `new`: place of a column in postorder
    for root in range(n):
        if parent[root] >= 0:
            continue
        top = 0
        stack[0] = root
        while top >= 0:
            i = stack[top]
            if child[i] >= 0:
                top += 1
                stack[top] = child[i]
                child[i] = sibling[child[i]]
            else:
                new[i] = count
                count += 1
                top -= 1
    seen = child
    for i in range(n):
        ordered[new[i]] = order[i]
        place[order[i]] = new[i]
        up[new[i]] = new[parent[i]] if parent[i] >= 0 else -1
        below[i], seen[i] = 0, -1
    for i in range(n):  # the entries of row i of L are a subtree: walk it once
        seen[i] = i
        v = ordered[i]
        for p in range(starts[v], starts[v + 1]):
            k = place[columns[p]]
            while k < i and seen[k] != i:
                seen[k] = i
                below[k] += 1
                k = up[k]


@compiled(_nrt=False)
def supernodes(parent: Ints, below: Ints, begins: Ints, kept: Ints) -> int:
    """Write n to `kept`, and where runs of columns begin that are eliminated together, from behind.

    They have the same rows below them, or nearly so: a few zeros cost less than small fronts.
    Returns how many were written; both of the last have room for n + 1.
    """
    n = len(parent)
    count = 0
    for j in range(n):
        if j == 0 or parent[j - 1] != j or below[j - 1] != below[j] + 1:
            begins[count] = j
            count += 1
    begins[count] = n
    # From the root down: the run [begins[s], end) joins the one behind it if that is its parent.
    kept[0] = n
    many = 1
    end = n
    zeros = 0.0
    for s in range(count - 1, -1, -1):
        a, b = begins[s], begins[s + 1]
        width = b - a
        joined = False
        if b < n and parent[b - 1] >= b and parent[b - 1] < end:
            behind = end - b
            more = zeros + width * float(behind + below[end - 1] - below[b - 1])
            total = width + behind
            entries = total * (total + 1) / 2 + float(total) * below[end - 1]
            share = more / entries
            joined = share < _ZEROS
            for wide, most in _NARROW:
                joined = joined or (total <= wide and share < most)
            if joined:
                zeros = more
        if not joined:
            if b < n:
                kept[many] = b
                many += 1
            end = b
            zeros = 0.0
    kept[many] = 0
    return many + 1


@compiled(_nrt=False)
def front_rows(
    starts: Ints,
    columns: Ints,
    order: Ints,
    parent: Ints,
    begins: Ints,
    rows: Ints,
    above: Ints,
    end: Longs,
    place: Ints,
    node: Ints,
    seen: Ints,
) -> None:
    """Write the rows below each supernode from ``end[s]`` on, which moves on, and its parent.

    The last three, of n entries, are to work in.
    """
    n, count = len(order), len(begins) - 1
    for s in range(count):
        for j in range(begins[s], begins[s + 1]):
            place[order[j]], node[j] = j, s
        seen[s] = -1
    for s in range(count):
        up = parent[begins[s + 1] - 1]
        above[s] = node[up] if up >= 0 else -1
    for i in range(n):  # it is a row of the supernodes on the way up from its entries to its own
        seen[node[i]] = i
        v = order[i]
        for p in range(starts[v], starts[v + 1]):
            k = place[columns[p]]
            if k < i:
                s = node[k] + 0
                while seen[s] != i:
                    seen[s] = i
                    rows[end[s]] = i
                    end[s] += 1
                    s = above[s] + 0


@compiled(_nrt=False)
def find_subtrees(
    begins: Ints,
    first: Longs,
    rows: Ints,
    above: Ints,
    whole: Longs,
    most: int,
    subtrees: Longs,
    places: Ints,
    tail: Longs,
    slot: Longs,
) -> int:
    """Write which supernodes are subtrees that do `most` at most, as ``[begin, end)``.

    Those that do a thirty-second of that are left with what is above. `whole` is what each
    supernode does, then with all below it; `places`, the rows at first, are `Elimination.places`.
    The last two, of n entries, are to work in. Returns how many there are.
    """
    n, count = begins[-1], len(begins) - 1
    for s in range(count):
        tail[s] = s
    for s in range(count):
        if above[s] >= 0:
            whole[above[s]] += whole[s]
            tail[above[s]] = min(tail[above[s]], tail[s])
    many, slots = 0, np.int64(n)
    for s in range(count):
        if most // 32 < whole[s] <= most and (above[s] < 0 or whole[above[s]] > most):
            subtrees[many, 0], subtrees[many, 1] = tail[s], s + 1
            many += 1
            for p in range(first[s], first[s + 1]):
                slot[rows[p]] = slots
                slots += 1
            for p in range(first[tail[s]], first[s + 1]):
                if rows[p] >= begins[s + 1]:
                    places[p] = slot[rows[p]]
    return many
