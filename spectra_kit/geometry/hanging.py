"""Hanging vertices: those inside a boundary edge of another face, where two sides do not fit.

Programs that cut the sides of a surface one by one leave them, as T-junctions: the surface is open
there, though no gap is seen.
"""

from __future__ import annotations

from itertools import chain, pairwise

import numpy as np
from scipy.spatial import cKDTree

from spectra_kit._core.types import Floats, Ints
from spectra_kit.geometry.units import box_unit

_INSIDE = 1 - 1e-6  # of half an edge, around its middle: there are its ends not


def points_inside(points: Floats, edges: Ints, reach: Floats) -> tuple[Ints, Ints]:
    """Return the edges that others of their ends lie inside of, and these points.

    Numbers of both, (h,). Boundary edges (e, 2) are given by the places (n, 3) of their ends, each
    of which is there once; `reach` (n,) is how far off an edge each may lie.
    """
    unit = box_unit(points)
    points, reach = points / unit, reach / unit
    start, end = points[edges].transpose(1, 0, 2)
    half = np.linalg.norm(end - start, axis=1) / 2
    used = np.unique(edges)
    tree, middle = cKDTree(points[used]), (start + end) / 2
    number = tree.query_ball_point(middle, _INSIDE * half, return_length=True)
    some = np.flatnonzero(number)  # hardly any, as a rule
    around = tree.query_ball_point(middle[some], _INSIDE * half[some])
    e = np.repeat(some, number[some])
    p = used[np.fromiter(chain.from_iterable(around), np.int64, len(e))]
    along = (end - start)[e] / (2 * half[e])[:, None]
    at = np.einsum("er,er->e", points[p] - start[e], along)
    away = np.linalg.norm(points[p] - start[e] - at[:, None] * along, axis=1)
    bound = np.minimum(reach[p], reach[edges[e]].min(axis=1))
    on = (away <= bound) & (at > bound) & (at < 2 * half[e] - bound)
    return e[on], p[on]


def lying_on(edges: Ints, e: Ints, p: Ints) -> tuple[Ints, Ints]:
    """Return which edges lie on which, in part, of edges `e` with points `p` inside.

    An edge f of p goes on along e where its other end is on e too, or an end of e is inside f. So
    numbers of pairs of e and p, and for each an edge that goes on from p along e: (m,) both.
    """
    flat = np.argsort(edges, axis=None, kind="stable")
    ends = edges.ravel()[flat]
    low, high = np.searchsorted(ends, p, "left"), np.searchsorted(ends, p, "right")
    pair = np.repeat(np.arange(len(e)), high - low)
    f = flat[np.arange(len(pair)) - np.repeat(np.cumsum(high - low) - high, high - low)] // 2
    n, one = int(edges.max(initial=0)) + 1, e[pair]
    inside = e * n + p
    closed = np.concatenate([inside, *(e * n + edges[e, side] for side in (0, 1))])
    goes_on = np.isin(one * n + edges[f].sum(axis=1) - p[pair], closed)
    for side in (0, 1):
        goes_on |= np.isin(f * n + edges[one, side], inside)
    return pair[goes_on], f[goes_on]


def divided(points: Floats, faces: Ints, edges: Ints, inside: Ints) -> Ints:
    """Return faces (f, 3) cut at the vertices inside their edges, so that all sides fit.

    `edges` (h, 2) are of one face each, and `inside` (h,) has a vertex of each; an edge with
    several is there as often. Faces stay where they are, further ones follow.
    """
    n = len(points)
    wanted, number = np.unique(edges[:, 0] * n + edges[:, 1], return_inverse=True)
    heads = np.roll(faces, -1, axis=1)
    keys = np.minimum(faces, heads) * n + np.maximum(faces, heads)
    rows = np.flatnonzero(np.isin(keys, wanted).any(axis=1))
    cut = {row: [tuple(faces[row].tolist())] for row in rows.tolist()}
    owner = {key: row for row in cut for key in keys[row].tolist()}
    for j, key in enumerate(wanted.tolist()):
        some = np.unique(inside[number == j])
        pieces = cut[owner[key]]
        low, high = divmod(key, n)
        which, corner = next(
            (i, c)
            for i, piece in enumerate(pieces)
            for c in range(3)
            if {piece[c], piece[c - 2]} == {low, high}
        )
        a, b, apex = (pieces[which][corner - i] for i in (0, 2, 1))
        along = (points[some] - points[a]) @ (points[b] - points[a])
        line = [a, *some[np.argsort(along)].tolist(), b]
        pieces[which : which + 1] = [(u, v, apex) for u, v in pairwise(line)]
    first = faces.copy()
    for row, pieces in cut.items():
        first[row] = pieces[0]
    more = [piece for pieces in cut.values() for piece in pieces[1:]]
    return np.concatenate([first, np.reshape(more, (-1, 3)).astype(faces.dtype)])
