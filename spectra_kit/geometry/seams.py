"""Seams: boundary edges that lie on other boundary edges, so that a surface is cut unseen.

Formats that keep a normal or a texture with each vertex repeat the vertices at which these jump,
and programs that transform the parts of a surface one by one round the copies differently. Points
that are only near, and surfaces that touch in a point, are none: edges must lie on each other, as a
whole or from a vertex on.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import numpy as np
from scipy.spatial import cKDTree

from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import quantity
from spectra_kit._core.warn import warn
from spectra_kit.errors import SplitSurfaceWarning
from spectra_kit.geometry.hanging import divided, lying_on, points_inside
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
    opened: Ints  # (h, 2): edges inside which vertices hang, by labels; with several, as often
    hanging: Ints  # (h,): these vertices, by labels

    def closed(self, mesh: TriangleMesh) -> TriangleMesh:
        """Return the mesh with its seams joined, and faces cut where vertices hang."""
        faces = self.label[mesh.faces]
        if len(self.hanging):
            faces = divided(mesh.points, faces, self.opened, self.hanging)
        return TriangleMesh(mesh.points, faces)


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
    reach = _reach(mesh, vertices, place)
    place = joined(points[first], reach)[place]
    lines = np.sort(place[ends], axis=1)
    proper = lines[:, 0] < lines[:, 1]
    keys = lines[:, 0] * len(first) + lines[:, 1]
    _, line, alike = np.unique(keys, return_inverse=True, return_counts=True)
    on_others = proper & (alike[line] > 1)
    rest = np.flatnonzero(proper & ~on_others)
    inner = points_inside(points[first], lines[rest], reach)
    if not on_others.any() and not len(inner[0]):
        return None
    face, across = _sides(mesh, boundary)
    rounded = (points[ends] != points[first][place[ends]]).any(axis=(1, 2))
    rounded = np.bincount(line, rounded) > 0
    total = np.column_stack([np.bincount(line, column) for column in across.T])
    two_sheets = np.linalg.norm(total, axis=1) > _ALIKE * np.bincount(line)
    on_others &= ~(rounded & two_sheets)[line]
    opened, inside = _hanging(lines[rest], face[rest], across[rest], *inner)
    if not on_others.any() and not len(inside):
        return None
    at = np.isin(place, np.concatenate([opened.ravel(), inside]))
    at[ends[on_others]] = True
    label = np.arange(mesh.n)
    leader = np.full(len(vertices), len(vertices))
    np.minimum.at(leader, place[at], np.flatnonzero(at))
    label[vertices[at]] = vertices[leader[place[at]]]
    moved = np.flatnonzero(label != np.arange(mesh.n))
    exact = int((mesh.points[moved] == mesh.points[label[moved]]).all(axis=1).sum())
    opened, inside = np.sort(vertices[leader[opened]], axis=1), vertices[leader[inside]]
    return Seams(int(on_others.sum()), exact, len(moved) - exact, label, opened, inside)


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


def _sides(mesh: TriangleMesh, boundary: Ints) -> tuple[Ints, Floats]:
    """Return the face (b,) of each boundary edge, and the direction (b, 3) in which it lies."""
    heads = np.roll(mesh.faces, -1, axis=1)
    sides = np.minimum(mesh.faces, heads) * mesh.n + np.maximum(mesh.faces, heads)
    keys = boundary[:, 0] * mesh.n + boundary[:, 1]  # ascending
    at = np.minimum(np.searchsorted(keys, sides), len(keys) - 1)
    row, corner = np.nonzero(keys[at] == sides)
    apex, face = np.empty((2, len(keys)), dtype=np.int64)
    apex[at[row, corner]], face[at[row, corner]] = mesh.faces[row, corner - 1], row
    start, end = mesh.points[boundary[:, 0]], mesh.points[boundary[:, 1]]
    along = _unit(end - start)
    across = mesh.points[apex] - start
    return face, _unit(across - np.einsum("er,er->e", across, along)[:, None] * along)


def _hanging(lines: Ints, face: Ints, across: Floats, e: Ints, p: Ints) -> tuple[Ints, Ints]:
    """Return, of edges with points inside, those along which one of another face goes on."""
    pair, f = lying_on(lines, e, p)
    one = e[pair]
    two_sheets = np.einsum("er,er->e", across[one], across[f]) > _ALIKE
    found = np.unique(pair[(face[one] != face[f]) & ~two_sheets])
    return lines[e[found]], p[found]


def _unit(vectors: Floats) -> Floats:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 0))


def warn_of_seams(mesh: TriangleMesh) -> None:
    """Tell of edges that lie on each other without being joined."""
    found = seams(mesh)
    if found is None:
        return
    n_parts = len(np.unique(mesh.component_labels))
    n_whole = len(np.unique(found.closed(mesh).without_unreferenced().component_labels))
    told = []
    if found.edges:
        rounded = f", {found.near:,} of them up to rounding" if found.near else ""
        told.append(
            f"{found.edges:,} boundary edges lie on others, whose"
            f" {quantity(found.exact + found.near, 'vertex')} repeat earlier ones{rounded}"
        )
    if n_hanging := len(np.unique(found.hanging)):
        which = "vertex lies inside a boundary edge" if n_hanging == 1 else "vertices lie inside"
        which += " of another face" if n_hanging == 1 else " boundary edges of other faces"
        told.append(f"{n_hanging:,} {which}")
    cut = f"is slit open there, in {quantity(n_parts, 'part')}"
    if n_parts > n_whole:
        cut = f"falls into {n_parts:,} parts, and has {n_whole:,} if they are joined"
    warn(
        f"{' and '.join(told)}: the surface {cut}",
        SplitSurfaceWarning,
        advice="join them with {}",
        remedies=("geometry.repair(mesh)",),
    )
