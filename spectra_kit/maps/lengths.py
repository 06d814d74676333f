"""How far apart points lie along a surface: what maps between unlike bodies keep best.

A leg may be twice as thick in one species as in another, and none of its modes alike; but the way
from paw to paw, or to the tip of the tail, is much the same share of the whole.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from spectra_kit._core.types import Floats, Ints
from spectra_kit.maps.placed import Placed
from spectra_kit.operators.oriented import OrientedTriangles

_SHORT = 0.05  # lengths below that, of surfaces at unit area, say little


def lengths_from(placed: Placed, points: Ints) -> Floats:
    """Return the lengths of the shortest ways along edges from some points to all, (p, n).

    What no way leads to, as single points of a cloud, counts as the farthest.
    """
    edges = edges_of(placed.oriented)
    n, weights = len(placed.points), lengths_of(placed.points, edges)
    graph = sparse.csr_array((weights, (edges[:, 0], edges[:, 1])), shape=(n, n))
    ways = dijkstra(graph, directed=False, indices=points)
    out: Floats = np.minimum(ways, ways[np.isfinite(ways)].max())
    return out


def changed(source: Floats, target: Floats, back: Ints, forth: Ints) -> float:
    """Return the mean relative difference of lengths that a map carries over, in [0, 1].

    Of p points of the source, (p, n1), and q of the target, (q, n2): `back` are the source points
    of the latter, `forth` the target points of the former. Both lengths join a point of the one and
    a point of the other, seen from either side.
    """
    here, there = source[:, back], target[:, forth].T
    return float((np.abs(here - there) / (here + there + _SHORT)).mean())


def edges_of(oriented: OrientedTriangles) -> Ints:
    """Return the edges i < j of the triangles, (e, 2)."""
    both = np.concatenate([oriented.faces[:, [c - 1, c]] for c in range(3)])
    both.sort(axis=1)
    return np.unique(both, axis=0)


def lengths_of(points: Floats, edges: Ints) -> Floats:
    """Return the lengths of edges (e, 2) between points (n, 3)."""
    out: Floats = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    return out
