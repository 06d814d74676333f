"""Inner loops of the heat step and of walks along edges, compiled by numba on first use.

Heat at distance d is about ``exp(-d / sqrt(t))``: a few hundred mean edges away it leaves the range
of float64. So it is held as ``values * 2**exponents``, with an exponent at each point; between
neighbours the exponents differ by little, and every operation here is between neighbours.
"""

from __future__ import annotations

import math
from heapq import heappop, heappush

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from spectra_kit._core.compiled import compiled
from spectra_kit._core.types import Floats, Indices, Ints, Ints32

_MOST = 1023
_BLOCK = 512  # points among which the farthest is sought at once
_POWERS = 2.0 ** np.arange(-1074.0, _MOST + 1)  # a look-up is quicker than `ldexp`


@register_jitable
def _power(exponent: int) -> float:
    """Two to the power of `exponent`, the nearest there is."""
    return float(_POWERS[min(max(exponent, -1074), _MOST) + 1074])


@compiled()
def edge_costs(
    starts: Indices,
    columns: Indices,
    entries: Floats,
    diagonal: Floats,
    points: Floats,
    decay: float,
) -> Floats:
    """Return how much ``-log u`` may grow along each entry of ``M + t L`` (CSR), at most.

    By `decay` times the length of the edge; or less, as a value is at least its neighbour's times
    their entry over the diagonal one: along edges far longer than ``1 / decay`` heat decays less
    than exponentially. Infinite where an entry is zero.
    """
    found = np.empty(len(entries))
    for i in range(len(starts) - 1):
        for p in range(starts[i], starts[i + 1]):
            j = columns[p]
            square = 0.0
            for c in range(3):
                square += (points[i, c] - points[j, c]) ** 2
            cost = decay * math.sqrt(square)
            if i != j:
                weight = -entries[p]
                if weight <= 0.0:
                    cost = np.inf
                elif cost > 1.0:
                    cost = min(cost, math.log(max(diagonal[i], diagonal[j]) / weight))
            found[p] = cost
    return found


@compiled()
def scaled_entries(
    starts: Indices,
    columns: Indices,
    entries: Floats,
    exponents: Indices,
    forward: Floats,
    backward: Floats,
) -> None:
    """Write ``a_ij 2**(e_j - e_i)`` to `forward` and ``a_ij 2**(e_i - e_j)`` to `backward`."""
    for i in range(len(starts) - 1):
        for p in range(starts[i], starts[i + 1]):
            shift = exponents[columns[p]] - exponents[i]
            forward[p] = entries[p] * _power(shift)
            backward[p] = entries[p] * _power(-shift)


@compiled()
def residual(
    starts: Indices, columns: Indices, entries: Floats, rhs: Floats, x: Floats, out: Floats
) -> float:
    """Write ``rhs - A x`` to `out`; return its largest share of the sizes of what was summed.

    Entries of A (CSR) and x are scaled alike, so the share is the componentwise backward error.
    """
    worst = 0.0
    for i in range(len(starts) - 1):
        total, size = rhs[i], abs(rhs[i])
        for p in range(starts[i], starts[i + 1]):
            term = entries[p] * x[columns[p]]
            total -= term
            size += abs(term)
        out[i] = total
        if size > 0.0 and not abs(total) <= worst * size:
            worst = abs(total) / size
    return worst


@compiled()
def solve_scaled(
    starts: Indices,
    columns: Indices,
    forward: Floats,
    backward: Floats,
    inverse: Floats,
    rhs: Floats,
    out: Floats,
) -> None:
    """Write to `out` the solution with the factor ``(I + L) D (I + L)^T``, scaled on both sides.

    L is stored by rows, strictly lower: `forward` scaled for the first sweep and `backward` for
    the second, see `scaled_entries`; `inverse` holds 1 / D.
    """
    n = len(inverse)
    for i in range(n):
        total = rhs[i]
        for p in range(starts[i], starts[i + 1]):
            total -= forward[p] * out[columns[p]]
        out[i] = total
    for i in range(n):
        out[i] *= inverse[i]
    for i in range(n - 1, -1, -1):
        value = out[i]
        for p in range(starts[i], starts[i + 1]):
            out[columns[p]] -= backward[p] * value


@compiled(error_model="numpy")
def divergence_of_directions(
    corners: Indices,
    lengths: Floats,
    apex: Floats,
    values: Floats,
    exponents: Indices,
    flat: float,
    sources: NDArray[np.bool_],
) -> tuple[Floats, int]:
    """Return the integrated divergence of the unit vectors down the gradient of heat, shape (n,).

    Triangles on which heat differs by less than the share `flat`, or whose corners are all
    `sources`, have no direction and add nothing; returns the number of the former too. Signs and
    frames are those of `IntrinsicTriangulation.divergence`.
    """
    found = np.zeros(len(values))
    level = 0
    for t in range(len(corners)):
        i, j, k = corners[t, 0], corners[t, 1], corners[t, 2]
        if sources[i] and sources[j] and sources[k]:
            continue
        a, b, c = values[i], values[j], values[k]
        if exponents[i] != exponents[j] or exponents[i] != exponents[k]:
            top = max(exponents[i], exponents[j], exponents[k])
            a *= _power(exponents[i] - top)
            b *= _power(exponents[j] - top)
            c *= _power(exponents[k] - top)
        largest = max(a, b, c)
        if largest - min(a, b, c) <= flat * largest:
            level += largest > 0.0
            continue
        ij, x, y = lengths[t, 0], apex[t, 0], apex[t, 1]
        along = (a - b) / ij
        across = (a - c - x * along) / y
        scale = 0.5 / math.sqrt(along * along + across * across)
        one = (y * along - x * across) * scale
        two = ij * across * scale
        found[i] -= one + two
        found[j] += one
        found[k] += two
    return found, level


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
    ``first_end[i]:first_end[i + 1]``. Dijkstra, with stale entries left in the heap, that stops as
    soon as what was asked for is found: SciPy's goes on to every point.
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
    starts: Ints32,
    neighbours: Ints32,
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
