"""The cover of a mesh as the library robust_laplacian makes it: its triangles, and their order.

The library returns matrices and keeps to itself what they are sums over. Where four points are on
a circle, the order in which it visits the edges tells which triangles it ends with, and so the
masses. Half-edges are numbered as in `_edge_flips`.
"""

from __future__ import annotations

import math

import numpy as np
from numba.extending import register_jitable

from spectra_kit._core.compiled import compiled
from spectra_kit._core.types import Floats, Ints, Ints32


@compiled()
def tufted_cover(
    points: Floats, faces: Ints32, starts: Ints, sides: Ints, twins: Ints32, leads: Ints32
) -> None:
    """Glue front and back of each face to the faces next to it around each edge.

    Sides ``3 t + c`` of edge e are at ``starts[e]`` to ``starts[e + 1]``; edges, and the sides of
    each, come in the order of the faces. Of the edges of the cover, ``leads`` has one half-edge
    each, in the order in which the library visits them.
    """
    new = len(starts) - 1
    for e in range(len(starts) - 1):
        own = sides[starts[e] : starts[e + 1]].copy()
        own[1:] = own[:0:-1].copy()  # its lists run backwards from the first
        d, low = len(own), faces[own[0] // 3, own[0] % 3]
        ring = np.empty(2 * d, np.int64)
        for j in range(d):
            ring[2 * j], ring[2 * j + 1] = _front(own[j]), _back(own[j])
        own = own[np.argsort(-_angles(points, faces, own), kind="mergesort")]
        here = _front(own[0]) if _runs_from(faces, low, own[0]) else _back(own[0])
        # All half-edges are glued that run from `low` to such as run to it.
        for i in range(d):
            side = own[(i + 1) % d]
            there = _back(side) if _runs_from(faces, low, side) else _front(side)
            twins[here], twins[there] = there, here
            if len(ring) > 2:
                leads[new] = here
                new += 1
                ring = ring[(ring != here) & (ring != there)]
            else:
                leads[e] = ring[0]
            here = _back(side) if there == _front(side) else _front(side)


@register_jitable
def _angles(points: Floats, faces: Ints32, sides: Ints) -> Floats:
    """Angles of the faces around an edge, measured as the library does.

    In the same operations: on flat parts, rounding tells pi from -pi.
    """
    t, c = sides[0] // 3, sides[0] % 3
    tail = points[faces[t, c]]
    along = _unit(points[faces[t, (c + 1) % 3]] - tail)
    test = np.array([0.0, 1.0, 0.0]) if abs(along[0]) > 0.9 else np.array([1.0, 0.0, 0.0])
    x = _unit(np.cross(test, along))
    y = _unit(np.cross(along, x))
    angles = np.empty(len(sides))
    for j in range(len(sides)):
        out = _unit(points[faces[sides[j] // 3, (sides[j] % 3 + 2) % 3]] - tail)
        angles[j] = math.atan2(_dot(y, out), _dot(x, out))
    return angles


@register_jitable
def _dot(u: Floats, v: Floats) -> float:
    return float(u[0] * v[0] + u[1] * v[1] + u[2] * v[2])


@register_jitable
def _unit(u: Floats) -> Floats:
    return u * (1.0 / math.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2]))


@register_jitable
def _runs_from(faces: Ints32, low: int, side: int) -> bool:
    return bool(faces[side // 3, side % 3] == low)


@register_jitable
def _front(side: int) -> int:
    return 6 * (side // 3) + side % 3


@register_jitable
def _back(side: int) -> int:
    return 6 * (side // 3) + 5 - side % 3
