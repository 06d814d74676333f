"""Farthest points along the edges of a graph, compiled by numba on first use."""

from __future__ import annotations

from heapq import heappop, heappush

import numpy as np
from numpy.typing import NDArray

from spectra_kit.linalg.compiled import compiled

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@compiled()
def farthest_along_edges(
    starts: NDArray[np.int32], neighbours: NDArray[np.int32], lengths: Floats, first: Ints, count: int
) -> tuple[Ints, Ints, Floats]:
    """Return `count` points, those `first` and then each as far as possible from all before it.

    With them, of each point of the graph (CSR): the position of the closest one, -1 where none can
    be reached, and its distance. A new point is followed no further than it is the closest, so all
    of it costs O(n log n log count), and O(n) for each to find the farthest.
    """
    n = len(starts) - 1
    chosen = np.empty(count, np.int64)
    closest = np.full(n, -1, np.int64)
    apart = np.full(n, np.inf)
    for c in range(count):
        centre = first[c] if c < len(first) else apart.argmax()
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
