"""Shortest paths that stop as soon as what was asked for is found: SciPy's go on to every point."""

from __future__ import annotations

from heapq import heappop, heappush

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.compiled import compiled

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


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
