"""Farthest points along the edges of a graph, compiled by numba on first use."""

from __future__ import annotations

from heapq import heappop, heappush

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.compiled import compiled

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_BLOCK = 512  # points


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
