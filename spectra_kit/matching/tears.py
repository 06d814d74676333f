"""How much of a map is torn: neighbours that it takes far apart."""

from __future__ import annotations

import numpy as np

from spectra_kit._types import Floats, Ints
from spectra_kit.matching.placed import Placed
from spectra_kit.operators.oriented import OrientedTriangles

_FAR = 6.0  # times their distance: surfaces of different kinds stretch less almost everywhere


def torn(source: Placed, target: Placed, point_map: Ints) -> float:
    """Return the share of a target's edges whose ends lead far apart, in [0, 1].

    Far is more than six times the length of the edge, or that of an average edge of the source if
    that is longer: no map to vertices can do better. Where two maps look alike in all modes, the
    wrong one is torn, as it leads from a leg to the tail and back.
    """
    edges = edges_of(target.oriented)
    long = np.maximum(lengths_of(target.points, edges), _spacing(source))
    return float((lengths_of(source.points, point_map[edges]) > _FAR * long).mean())


def edges_of(oriented: OrientedTriangles) -> Ints:
    """Return the edges i < j of the triangles, (e, 2)."""
    both = np.concatenate([oriented.faces[:, [c - 1, c]] for c in range(3)])
    both.sort(axis=1)
    return np.unique(both, axis=0)


def lengths_of(points: Floats, edges: Ints) -> Floats:
    """Return the lengths of edges (e, 2) between points (n, 3)."""
    out: Floats = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    return out


def _spacing(surface: Placed) -> float:
    return float(lengths_of(surface.points, edges_of(surface.oriented)).mean())
