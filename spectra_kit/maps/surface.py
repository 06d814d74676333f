"""A surface at unit area, without its modes: which side is out, its edges, what maps should keep.

How far apart points lie along a surface is what maps between unlike bodies keep best: a leg may be
twice as thick in one species as in another, and none of its modes alike; but the way from paw to
paw, or to the tip of the tail, is much the same share of the whole. Bending keeps handles and rims,
too; and smoothed mean curvature tells the front of a limb from its back.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components, dijkstra

from spectra_kit._core.records import Rebuilt
from spectra_kit._core.types import Floats, Ints
from spectra_kit.eigen import Spectrum
from spectra_kit.geodesics.edges import edge_graph
from spectra_kit.geometry import TriangleMesh
from spectra_kit.geometry.vectors import sums
from spectra_kit.operators.oriented import OrientedTriangles

_SHORT = 0.05  # lengths below that, of surfaces at unit area, say little
_FAR = 6.0  # times their distance: surfaces of different kinds stretch less almost everywhere
_GAPS = 6  # between eigenvalues
_EQUAL = 2e-3  # relative difference of eigenvalues that coarse meshes make of equal ones


@dataclass(frozen=True, eq=False, kw_only=True)
class Surface(Rebuilt):
    """A mesh or cloud in the unit frame: scaled to area 1, with the side that is out."""

    points: Floats  # (n, 3)
    mass: Floats  # (n,), of the spectrum
    oriented: OrientedTriangles

    @cached_property
    def mesh(self) -> TriangleMesh:
        """The triangles as a mesh; of a cloud, those around its points."""
        return TriangleMesh(self.points, self.oriented.faces)

    @property
    def edges(self) -> Ints:
        """The edges of the triangles, (e, 2)."""
        return self.mesh.unique_edges[0]

    @property
    def is_mesh(self) -> bool:
        """Whether these are triangles of a mesh, not of a cloud or images of dense ones."""
        return bool((self.oriented.weights == 1).all())

    def reflected(self) -> Surface:
        """Return the surface as a mirror shows it."""
        return Surface(
            points=self.points * [-1.0, 1.0, 1.0],
            mass=self.mass,
            oriented=self.oriented.reversed(),
        )

    def lengths_from(self, points: Ints) -> Floats:
        """Return the lengths of the shortest ways along edges from some points to all, (p, n).

        What no way leads to, as single points of a cloud, counts as the farthest.
        """
        ways = dijkstra(edge_graph(self.mesh), directed=False, indices=points)
        return np.asarray(np.minimum(ways, ways[np.isfinite(ways)].max()))

    def links_between(self, points: Ints) -> Ints:
        """Return which of some points are neighbours, (l, 2): those whose cells meet."""
        ways = {"directed": False, "min_only": True, "return_predecessors": True}
        cells = dijkstra(edge_graph(self.mesh), indices=points, **ways)[2][self.edges]
        order = np.argsort(points)
        met = np.unique(np.sort(cells[cells[:, 0] != cells[:, 1]], axis=1), axis=0)
        return np.asarray(order[np.searchsorted(points[order], met)])

    @cached_property
    def spacing(self) -> float:
        """Mean length of an edge."""
        return float(lengths_of(self.points, self.edges).mean())


def lengths_of(points: Floats, edges: Ints) -> Floats:
    """Return the lengths of edges (e, 2) between points (n, 3)."""
    return np.asarray(np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1))


def changed(source: Floats, target: Floats, back: Ints, forth: Ints) -> float:
    """Return the mean relative difference of lengths that a map carries over, in [0, 1].

    Of p points of the source, (p, n1), and q of the target, (q, n2): `back` are the source points
    of the latter, `forth` the target points of the former. Both lengths join a point of the one and
    a point of the other, seen from either side.
    """
    here, there = source[:, back], target[:, forth].T
    return float((np.abs(here - there) / (here + there + _SHORT)).mean())


def discontinuity(source: Surface, target: Surface, point_map: Ints) -> float:
    """Return the share of a target's edges whose ends lead far apart, in [0, 1].

    Far is more than six times the length of the edge, or that of an average edge of the source if
    that is longer: no map to vertices can do better. Where two maps look alike in all modes, the
    wrong one is torn, as it leads from a leg to the tail and back.
    """
    edges = target.edges
    long = np.maximum(lengths_of(target.points, edges), source.spacing)
    return float((lengths_of(source.points, point_map[edges]) > _FAR * long).mean())


def outward_normals(points: Floats, oriented: OrientedTriangles) -> Floats:
    """Return unit normals at the points, (n, 3): of the triangles around, weighted by area.

    Zero where no triangle is, or where the triangles around cancel.
    """
    i, j, k = oriented.faces.T
    across = np.cross(points[j] - points[i], points[k] - points[i]) * oriented.weights[:, None]
    corners, n = oriented.faces.ravel(), len(points)
    sums: Floats = np.column_stack([np.bincount(corners, np.repeat(x, 3), n) for x in across.T])
    return unit_rows(sums)


def unit_rows(rows: Floats) -> Floats:
    """Return rows divided by their lengths; zero stays zero."""
    lengths = np.linalg.norm(rows, axis=1, keepdims=True)
    return np.asarray(np.divide(rows, lengths, out=np.zeros_like(rows), where=lengths > 0))


def smoothed_mean_curvature(
    spectrum: Spectrum, points: Floats, oriented: OrientedTriangles, modes: tuple[int, ...]
) -> Floats:
    """Return twice the signed mean curvature of the surface, smoothed by a short heat flow.

    In 1/length, positive where the surface is convex; a column for each of `modes`, with heat that
    flows for the time 1 / lambda of that mode. The mean curvature normal is the Laplacian of the
    coordinates, ``2 H n = L x``; with the heat flow, ``n . U diag(lambda exp(-t lambda)) U^T M x``.
    Bending a surface changes it at the bends only. It does not see reflections.
    """
    normals = outward_normals(points, oriented)
    coefficients = spectrum.project(points)
    columns = []
    for mode in modes:
        gain = spectrum.eigenvalues * np.exp(-spectrum.eigenvalues / spectrum.eigenvalues[mode])
        smooth = spectrum.eigenvectors @ (gain[:, None] * coefficients)
        columns.append(np.einsum("nr,nr->n", smooth, normals))
    return np.column_stack(columns)


class Topology(NamedTuple):
    """Of one connected surface at unit area."""

    genus: int | None  # handles, once its holes are closed; None of a cloud, or if not a surface
    rim: float  # of where it is cut: 0 of a closed surface, and of a cloud


def topology_of(surface: Surface) -> Topology:
    """Return the genus and the rim of a mesh.

    ``2 - 2 g`` is the number of vertices less that of edges and more that of triangles, once each
    loop of the border is closed by a disc: holes of a scan are no handles. The rim is as long as
    that of the one round hole that is as wide as all of them together, by the vector areas of the
    loops: raggedness does not count. Where the surface around a hole faces as the hole does, it is
    a gap in a wall and not the end of what was cut off: it counts the less by the cosine, not at
    all in a plane. No hole counts for more than its width: the border of a flat disc is its rim.
    """
    if not surface.is_mesh:
        return Topology(None, 0.0)
    points, faces, n = surface.points, surface.oriented.faces, len(surface.points)
    _, edge, uses = np.unique(  # of each triangle its three sides, in its own sense
        np.sort(sides := faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1),
        axis=0, return_counts=True, return_inverse=True,
    )  # fmt: skip
    border = np.flatnonzero(uses[edge.ravel()] == 1)
    a, b = sides[border].T
    graph = sparse.coo_array((np.ones(len(a)), (a, b)), shape=(n, n))
    holes, hole = np.unique(connected_components(graph, directed=False)[1][a], return_inverse=True)
    areas = sums(hole, np.cross(points[b], points[a]) / 2, len(holes))
    lengths = lengths_of(points, sides[border])
    i, j, k = faces[border // 3].T
    normals = unit_rows(np.cross(points[j] - points[i], points[k] - points[i]))
    around = sums(hole, normals * lengths[:, None], len(holes))
    around /= np.maximum(np.bincount(hole, lengths, len(holes)), 1e-300)[:, None]
    within = np.maximum(np.einsum("hr,hr->h", areas, around), 0.0)  # of a gap; a border faces away
    wide = np.linalg.norm(areas, axis=1) - within
    rim = float(np.sqrt(4 * np.pi * np.maximum(wide, 0.0).sum()))  # in a plane it is rounding
    met = np.bincount(sides[border].ravel(), minlength=n)
    if uses.max() > 2 or not np.isin(met, (0, 2)).all():
        return Topology(None, rim)
    euler = len(np.unique(faces)) - len(uses) + len(faces) + len(holes)
    return Topology((2 - euler) // 2 if euler % 2 == 0 else None, rim)


def topologies(source: Surface, target: Surface) -> dict[str, Any]:
    """Return the topologies of both as `Match` has them."""
    one, other = topology_of(source), topology_of(target)
    known = one.genus is not None and other.genus is not None
    return {"genera": (one.genus, other.genus) if known else None, "rims": (one.rim, other.rim)}


def clustered(eigenvalues: Floats) -> float:
    """Return how much closer than by chance the lowest eigenvalues lie: about 1 by chance.

    Of a surface with more symmetries than two halves that are alike, and of one that is nearly so,
    eigenvalues come in twos, threes and more. By chance the i-th and the next differ by a factor
    whose logarithm is exponential with mean 1 / i (Weyl's law); the result is the mean over the
    lowest six of minus the logarithm of how likely that is to be so small. Bodies and animals have
    0.5 to 1.2, round shapes 1.8 and more.
    """
    lowest = eigenvalues[1 : _GAPS + 2]
    i = np.arange(1, len(lowest))
    gaps = np.maximum(np.diff(np.log(lowest)), _EQUAL)
    return float(-np.log(-np.expm1(-i * gaps)).mean())
