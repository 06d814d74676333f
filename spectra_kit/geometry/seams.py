"""Seams: boundary edges that lie on other boundary edges, so that a surface is cut unseen.

Formats that keep a normal or a texture with each vertex repeat the vertices at which these jump,
and programs that transform the parts of a surface one by one round the copies differently. Points
that are only near, and surfaces that touch in a point, are none: edges must lie on each other, as a
whole or from a vertex on. Programs that cut the sides of a surface one by one leave hanging
vertices (T-junctions): those inside a boundary edge of another face, where two sides do not fit.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain, pairwise

import numpy as np

from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import quantity
from spectra_kit._core.warn import warn
from spectra_kit.errors import SplitSurfaceWarning
from spectra_kit.geometry.shapes import TriangleMesh, box_unit, distinct_rows, side_keys
from spectra_kit.geometry.vectors import sums, unit_vectors

#: What is told of one such vertex, and of several.
HANGING = (
    "vertex lies inside a boundary edge of another face",
    "vertices lie inside boundary edges of other faces",
)
#: Of the shortest edge at either point: so near are copies that were rounded. Coordinates of seven
#: digits, of six in texts, are off by 1e-3 of edges that are a thousandth of the whole; what is
#: joined so moves eigenvalues by less than such triangles are off anyway.
NEAR = 0.01
_KEPT = "_seams"
_ALIKE = 0.99  # cosine; faces at two near edges that turn less than that are of two sheets


_INSIDE = 1 - 1e-6  # of half an edge, around its middle: there are its ends not


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
    from scipy.spatial import cKDTree  # slow to import

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
    """Return where boundary edges of a mesh lie on others; None where none does. Kept with it."""
    kept: dict[str, Seams | None] = vars(mesh)
    if _KEPT not in kept:
        kept[_KEPT] = _found(mesh)
    return kept[_KEPT]


def _found(mesh: TriangleMesh) -> Seams | None:
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
    total = sums(line, across, line.max() + 1)
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
    sides = side_keys(mesh.faces, mesh.n)
    keys = boundary[:, 0] * mesh.n + boundary[:, 1]  # ascending
    at = np.minimum(np.searchsorted(keys, sides), len(keys) - 1)
    row, corner = np.nonzero(keys[at] == sides)
    apex, face = np.empty((2, len(keys)), dtype=np.int64)
    apex[at[row, corner]], face[at[row, corner]] = mesh.faces[row, corner - 1], row
    start, end = mesh.points[boundary[:, 0]], mesh.points[boundary[:, 1]]
    along = unit_vectors(end - start)
    across = mesh.points[apex] - start
    return face, unit_vectors(across - np.einsum("er,er->e", across, along)[:, None] * along)


def _hanging(lines: Ints, face: Ints, across: Floats, e: Ints, p: Ints) -> tuple[Ints, Ints]:
    """Return, of edges with points inside, those along which one of another face goes on."""
    pair, f = lying_on(lines, e, p)
    one = e[pair]
    two_sheets = np.einsum("er,er->e", across[one], across[f]) > _ALIKE
    found = np.unique(pair[(face[one] != face[f]) & ~two_sheets])
    return lines[e[found]], p[found]


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
        told.append(f"{n_hanging:,} {HANGING[n_hanging > 1]}")
    cut = f"is slit open there, in {quantity(n_parts, 'part')}"
    if n_parts > n_whole:
        cut = f"falls into {n_parts:,} parts, and has {n_whole:,} if they are joined"
    warn(
        f"{' and '.join(told)}: the surface {cut}",
        SplitSurfaceWarning,
        advice="join them with {}",
        remedies=("geometry.repair(mesh)",),
    )


def points_inside(points: Floats, edges: Ints, reach: Floats) -> tuple[Ints, Ints]:
    """Return the edges that others of their ends lie inside of, and these points.

    Numbers of both, (h,). Boundary edges (e, 2) are given by the places (n, 3) of their ends, each
    of which is there once; `reach` (n,) is how far off an edge each may lie.
    """
    from scipy.spatial import cKDTree  # slow to import

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
    keys = side_keys(faces, n)
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
