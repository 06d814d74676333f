"""Seams: boundary edges that lie on other boundary edges, so that a surface is cut unseen.

Formats that keep a normal or a texture with each vertex repeat the vertices at which these jump,
and programs that transform the parts of a surface one by one round the copies differently. Points
that are only near, and surfaces that touch in a point, are none: edges must lie on each other as a
whole.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import numpy as np
from scipy.spatial import cKDTree

from spectra_kit._types import Bools, Floats, Ints
from spectra_kit._validate import quantity, warn
from spectra_kit.errors import SplitSurfaceWarning
from spectra_kit.geometry.shapes import TriangleMesh, distinct_rows
from spectra_kit.geometry.units import box_unit

#: Of the shortest edge at either point: so near are copies that were rounded. Coordinates of seven
#: digits, of six in texts, are off by 1e-3 of edges that are a thousandth of the whole; what is
#: joined so moves eigenvalues by less than such triangles are off anyway.
NEAR = 0.01
_ALIKE = 0.99  # cosine; faces at two near edges that turn less than that are of two sheets


@dataclass(frozen=True, eq=False)
class Seams:
    """Where boundary edges lie on each other."""

    edges: int  # how many lie on another
    exact: int  # vertices of theirs at the place of an earlier one
    near: int  # at that of an earlier one up to rounding
    label: Ints  # (n,): the first of the vertices of each such place; elsewhere itself


def joined(points: Floats, reach: Floats) -> Ints:
    """Return the point that each is joined with, itself where it is none, shape (n,).

    That is the earliest one not joined itself within the smaller `reach` of the two. So none moves
    farther than that, and points that follow each other are not drawn together in a chain.
    """
    label = np.arange(len(points))
    if len(points) < 2:
        return label
    unit = box_unit(points)  # in which nothing overflows
    points, reach = points / unit, reach / unit
    tree = cKDTree(points)
    beside = tree.query(points, k=2)[0][:, 1]
    some = np.flatnonzero(beside <= reach)  # hardly any, as a rule
    around = tree.query_ball_point(points[some], reach[some])
    i = np.repeat(some, np.fromiter(map(len, around), np.int64, len(some)))
    j = np.fromiter(chain.from_iterable(around), np.int64, len(i))
    i, j = i[later := i < j], j[later]
    apart = np.linalg.norm(points[i] - points[j], axis=1)
    i, j = i[near := apart <= np.minimum(reach[i], reach[j])], j[near]
    order = np.argsort(i, kind="stable")
    leader = label.tolist()
    for a, b in zip(i[order].tolist(), j[order].tolist(), strict=True):
        if leader[a] == a and leader[b] == b:
            leader[b] = a
    return np.array(leader)


def seams(mesh: TriangleMesh) -> Seams | None:
    """Return where boundary edges of a mesh lie on others; None where none does."""
    edges, counts = mesh.unique_edges
    boundary = edges[counts == 1]
    if not len(boundary):
        return None
    vertices, ends = np.unique(boundary, return_inverse=True)
    ends = ends.reshape(-1, 2)
    points = mesh.points[vertices]
    first, place = distinct_rows(points)
    place = joined(points[first], _reach(mesh, vertices, place))[place]
    lines = np.sort(place[ends], axis=1)
    proper = lines[:, 0] < lines[:, 1]
    keys = lines[:, 0] * len(first) + lines[:, 1]
    _, line, alike = np.unique(keys, return_inverse=True, return_counts=True)
    on_others = proper & (alike[line] > 1)
    if not on_others.any():
        return None
    rounded = (points[ends] != points[first][place[ends]]).any(axis=(1, 2))
    rounded = np.bincount(line, rounded) > 0
    on_others[on_others] = ~(rounded[line] & _two_sheets(mesh, boundary, line))[on_others]
    if not on_others.any():
        return None
    at = np.zeros(len(vertices), dtype=bool)
    at[ends[on_others]] = True
    label = np.arange(mesh.n)
    leader = np.full(len(vertices), len(vertices))
    np.minimum.at(leader, place[at], np.flatnonzero(at))
    label[vertices[at]] = vertices[leader[place[at]]]
    moved = np.flatnonzero(label != np.arange(mesh.n))
    exact = int((mesh.points[moved] == mesh.points[label[moved]]).all(axis=1).sum())
    return Seams(int(on_others.sum()), exact, len(moved) - exact, label)


def _reach(mesh: TriangleMesh, vertices: Ints, place: Ints) -> Floats:
    """Return how near copies are at each of the places of some vertices."""
    low, high = mesh.unique_edges[0].T
    index = np.full(mesh.n, -1)
    index[vertices] = place
    there = (index[low] >= 0) | (index[high] >= 0)
    low, high = low[there], high[there]
    lengths = np.linalg.norm(mesh.points[high] - mesh.points[low], axis=1)
    shortest = np.full(place.max() + 2, np.inf)  # the last is of vertices inside
    np.minimum.at(shortest, index[low], lengths)
    np.minimum.at(shortest, index[high], lengths)
    return NEAR * shortest[:-1]


def _two_sheets(mesh: TriangleMesh, boundary: Ints, line: Ints) -> Bools:
    """Mark boundary edges on others whose faces lie on the same side: sheets on each other."""
    heads = np.roll(mesh.faces, -1, axis=1)
    sides = np.minimum(mesh.faces, heads) * mesh.n + np.maximum(mesh.faces, heads)
    keys = boundary[:, 0] * mesh.n + boundary[:, 1]  # ascending
    at = np.minimum(np.searchsorted(keys, sides), len(keys) - 1)
    face, corner = np.nonzero(keys[at] == sides)
    apex = np.empty(len(keys), dtype=np.int64)
    apex[at[face, corner]] = mesh.faces[face, corner - 1]
    start, end = mesh.points[boundary[:, 0]], mesh.points[boundary[:, 1]]
    along = _unit(end - start)
    across = mesh.points[apex] - start
    across = _unit(across - np.einsum("er,er->e", across, along)[:, None] * along)
    total = np.column_stack([np.bincount(line, column) for column in across.T])
    return np.asarray((np.linalg.norm(total, axis=1) > _ALIKE * np.bincount(line))[line])


def _unit(vectors: Floats) -> Floats:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 0))


def warn_of_seams(mesh: TriangleMesh) -> None:
    """Tell of edges that lie on each other without being joined."""
    found = seams(mesh)
    if found is None:
        return
    n_parts = len(np.unique(mesh.component_labels))
    whole = TriangleMesh(mesh.points, found.label[mesh.faces]).without_unreferenced()
    n_whole = len(np.unique(whole.component_labels))
    rounded = f", {found.near:,} of them up to rounding" if found.near else ""
    cut = f"is slit open there, in {quantity(n_parts, 'part')}"
    if n_parts > n_whole:
        cut = f"falls into {n_parts:,} parts, and has {n_whole:,} if they are joined"
    warn(
        f"{found.edges:,} boundary edges lie on others, whose"
        f" {quantity(found.exact + found.near, 'vertex')} repeat earlier ones{rounded}: the surface"
        f" {cut}",
        SplitSurfaceWarning,
        advice="join them with {}",
        remedies=("geometry.repair(mesh)",),
    )
