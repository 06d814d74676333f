"""Walks along the edges of a graph, compiled by numba on first use.

Shortest paths stop as soon as what was asked for is found (SciPy's go on to every point), and
farthest points as soon as another one is nearer.
"""

from __future__ import annotations

from heapq import heappop, heappush

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.compiled import compiled

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_BLOCK = 512  # points


@compiled()
def shortest_paths(
    first_edge: Ints,
    neighbors: Ints,
    lengths: Floats,
    starts: Ints,
    first_end: Ints,
    ends: Ints,
    found: Floats,
) -> None:
    """Write to `found` (q,) the distance of each end from its start; the rest stays as it is.

    The edges of vertex i are ``first_edge[i]:first_edge[i + 1]``, the ends of start i are
    ``first_end[i]:first_end[i + 1]`` (Dijkstra, with stale entries left in the heap).
    """
    n = len(first_edge) - 1
    best = np.full(n, np.inf)
    wanted = np.zeros(n, np.bool_)
    for s in range(len(starts)):
        mine = ends[first_end[s] : first_end[s + 1]]
        left = 0
        for end in mine:
            left += not wanted[end]
            wanted[end] = True
        best[:] = np.inf
        best[starts[s]] = 0.0
        heap = [(0.0, np.int64(starts[s]))]
        while left and len(heap):
            distance, i = heappop(heap)
            if distance > best[i]:
                continue
            if wanted[i]:
                wanted[i] = False
                left -= 1
            for edge in range(first_edge[i], first_edge[i + 1]):
                j, further = neighbors[edge], distance + lengths[edge]
                if further < best[j]:
                    best[j] = further
                    heappush(heap, (further, np.int64(j)))
        for q in range(len(mine)):
            if not wanted[mine[q]]:  # else out of reach
                found[first_end[s] + q] = best[mine[q]]
        for end in mine:
            wanted[end] = False


@compiled()
def farthest_along_edges(
    starts: NDArray[np.int32],
    neighbours: NDArray[np.int32],
    lengths: Floats,
    first: Ints,
    count: int,
) -> tuple[Ints, Ints, Floats]:
    """Return `count` points, those `first` and then each as far as possible from all before it.

    With them, of each point of the graph (CSR): the position of the closest one and its distance. A
    new point is followed no further than it is the closest, so all walks cost O(n log n log count).
    """
    n = len(starts) - 1
    chosen = np.empty(count, np.int64)
    closest = np.full(n, -1, np.int64)
    apart = np.full(n, np.inf)
    # The largest distance of each block, or what it was: distances only shrink.
    tops = np.full(-(-n // _BLOCK), np.inf)
    for c in range(count):
        centre = first[c] if c < len(first) else np.int64(-1)
        while centre < 0:
            b = tops.argmax()
            block = apart[b * _BLOCK : (b + 1) * _BLOCK]
            within = block.argmax()
            if block[within] == tops[b]:
                centre = np.int64(b * _BLOCK + within)
            tops[b] = block[within]
        chosen[c], closest[centre], apart[centre] = centre, c, 0.0
        heap = [(0.0, np.int64(centre))]
        while len(heap):
            distance, i = heappop(heap)
            if distance > apart[i]:
                continue
            for p in range(starts[i], starts[i + 1]):
                j, further = neighbours[p], distance + lengths[p]
                if further < apart[j]:
                    closest[j], apart[j] = c, further
                    heappush(heap, (further, np.int64(j)))
    return chosen, closest, apart
