"""`TriangleMesh` and `PointCloud`: the two kinds of input, frozen and validated; and their units.

Units of length are powers of two: in them nothing overflows, and nothing is rounded.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from spectra_kit._core.checked import checked
from spectra_kit._core.records import Rebuilt, frozen
from spectra_kit._core.shown import draw, drawn
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_faces, check_points
from spectra_kit.errors import InvalidInputError

_BLOCK = 1 << 13


class _Shape(Rebuilt):
    """What both kinds share: what else they may be given as, and how they show themselves."""

    points: Floats

    def plot(self, path: str | os.PathLike[str] | None = None, *, view: Any = None) -> Any:
        """Draw it, seen as a `show.View` says, or from where it shows most.

        Return the `show.Picture`, which is written to `path` if there is one.
        """
        seen = {} if view is None else {"view": view}
        return draw("plot_thumbnails", self._thumbnails(), path=path, **seen)

    def _repr_html_(self) -> str:
        return drawn(repr(self), "plot_thumbnails", self._thumbnails())

    def _thumbnails(self) -> Any:
        return [draw("Thumbnail", geometry=self, lines=(repr(self),))]

    #: What makes one of these of a thing: set by `adapt`, which reads files into them.
    _made_of: ClassVar[Callable[[Any], Geometry]]


@checked
@dataclass(frozen=True, eq=False, repr=False)
class PointCloud(_Shape):
    """Points sampled from a surface, in the order they came.

    Parameters
    ----------
    points : array_like of shape (n, 3)
        Coordinates, in any unit of length.

    Examples
    --------
    >>> from spectra_kit import PointCloud
    >>> cloud = PointCloud([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    >>> cloud.n
    3
    """

    points: Floats

    if TYPE_CHECKING:  # what it is made of is more than what it holds

        def __init__(self, points: ArrayLike) -> None: ...

    def __post_init__(self) -> None:
        # A copy: what the caller later writes into the array must not reach in here.
        points = check_points("points", self.points).copy()
        object.__setattr__(self, "points", frozen(points))

    def __repr__(self) -> str:
        return f"PointCloud({self.n} points)"

    @property
    def n(self) -> int:
        """Number of points."""
        return len(self.points)

    def with_points(self, points: Floats) -> PointCloud:
        """Return the same cloud at other coordinates, of shape (n, 3)."""
        return PointCloud(points)

    def without_duplicates(self) -> PointCloud:
        """Return the cloud with each distinct point kept once, at its first place.

        Only exactly equal coordinates count.
        """
        first, _ = distinct_rows(self.points)
        return PointCloud(self.points[first])


@checked
@dataclass(frozen=True, eq=False, repr=False)
class TriangleMesh(_Shape):
    """A triangle mesh: any topology, boundary and non-manifold edges allowed.

    The constructor refuses what no operator can use (NaN, indices out of range, no faces) and keeps
    everything else as it came; `geometry.diagnose` reports dirt, the ``without_*`` methods
    return a cleaned copy.

    Parameters
    ----------
    points : array_like of shape (n, 3)
        Vertex coordinates, in any unit of length.
    faces : array_like of shape (f, 3)
        Vertex indices of each triangle, counted from 0.

    Examples
    --------
    >>> from spectra_kit import TriangleMesh
    >>> mesh = TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    >>> mesh.area
    0.5
    """

    points: Floats
    faces: Ints

    if TYPE_CHECKING:

        def __init__(self, points: ArrayLike, faces: ArrayLike) -> None: ...

    def __post_init__(self) -> None:
        points = check_points("points", self.points).copy()
        faces = check_faces("faces", self.faces, len(points)).copy()
        object.__setattr__(self, "points", frozen(points))
        object.__setattr__(self, "faces", frozen(faces))

    def __repr__(self) -> str:
        return f"TriangleMesh({self.n} vertices, {len(self.faces)} faces)"

    @property
    def n(self) -> int:
        """Number of vertices."""
        return len(self.points)

    @property
    def vertices(self) -> Floats:
        """The `points`, by the name that trimesh and others have for them."""
        return self.points

    @cached_property
    def face_areas(self) -> Floats:
        """Area of each triangle, shape (f,), in length^2."""
        areas, _, exponents = self._measured
        with np.errstate(over="ignore"):  # infinite is what they are in this unit
            return frozen(np.ldexp(areas, 2 * exponents))

    @cached_property
    def _measured(self) -> tuple[Floats, Floats, NDArray[np.int32]]:
        return _measures(self.points, self.faces)

    @property
    def area(self) -> float:
        """Total surface area, in length^2."""
        return float(self.face_areas.sum())

    @cached_property
    def edges(self) -> Ints:
        """Undirected edges, one row (smaller index, larger index) per side of a face: (3f, 2)."""
        return frozen(np.sort(_half_edges(self.faces), axis=1))

    @cached_property
    def unique_edges(self) -> tuple[Ints, Ints]:
        """Distinct rows of `edges`, sorted, shape (e, 2), and how often each occurs, shape (e,)."""
        i, j = _half_edges(self.faces.astype(np.int32)).T  # by columns, which takes no sorting
        ends = np.minimum(i, j), np.maximum(i, j)
        table = sparse.csr_array((np.ones(len(i), np.int64), ends), shape=(self.n, self.n))
        lower = np.repeat(np.arange(self.n), np.diff(table.indptr))
        return frozen(np.column_stack([lower, table.indices])), frozen(table.data)

    @cached_property
    def boundary_vertices(self) -> Ints:
        """Vertices of edges that belong to exactly one face, ascending."""
        edges, counts = self.unique_edges
        return frozen(np.unique(edges[counts == 1]))

    @cached_property
    def referenced_vertices(self) -> Ints:
        """Vertices that a face uses, ascending."""
        return frozen(np.flatnonzero(np.bincount(self.faces.ravel(), minlength=self.n)))

    @cached_property
    def component_labels(self) -> Ints:
        """Connected component of each vertex, shape (n,); an unreferenced vertex is its own."""
        a, b, c = self.faces.astype(np.int32).T  # two sides connect a face
        return frozen(connected(np.concatenate([a, b]), np.concatenate([b, c]), self.n))

    def with_points(self, points: Floats) -> TriangleMesh:
        """Return the same connectivity at other coordinates, of shape (n, 3)."""
        return TriangleMesh(points, self.faces)

    def as_cloud(self) -> PointCloud:
        """Return the vertices as a point cloud."""
        return PointCloud(self.points)

    def without_unreferenced(self) -> TriangleMesh:
        """Return the mesh with only those vertices that a face uses, in their original order."""
        used = self.referenced_vertices
        return TriangleMesh(self.points[used], np.searchsorted(used, self.faces))

    def without_degenerate_faces(self, *, relative_area: float = 1e-12) -> TriangleMesh:
        """Return the mesh without faces of repeated vertices or (near) zero area.

        Faces of area <= relative_area * (longest side)^2 go. Vertices stay, some without a face.
        """
        return TriangleMesh(self.points, self.faces[~self.degenerate_faces(relative_area)])

    def degenerate_faces(self, relative_area: float = 1e-12) -> NDArray[np.bool_]:
        """Mark faces with a repeated vertex or area <= relative_area * (longest side)^2."""
        if not 0 <= relative_area < 1:
            raise InvalidInputError("relative_area", "be in [0, 1)", repr(relative_area))
        a, b, c = self.faces.T
        repeated = (a == b) | (b == c) | (c == a)
        areas, longest, _ = self._measured
        return np.asarray(repeated | (areas <= relative_area * longest**2))

    def without_duplicate_faces(self) -> TriangleMesh:
        """Return the mesh with one face per vertex triple (first kept, orientation ignored)."""
        first, _ = distinct_rows(np.sort(self.faces, axis=1))
        return TriangleMesh(self.points, self.faces[first])

    def with_merged_vertices(self) -> TriangleMesh:
        """Return the mesh with exactly coincident vertices joined, first kept.

        STL files store every triangle with its own three corners: without this they fall apart
        into as many components as faces.
        """
        first, label = distinct_rows(self.points)
        return TriangleMesh(self.points[first], label[self.faces])


def _measures(points: Floats, faces: Ints) -> tuple[Floats, Floats, NDArray[np.int32]]:
    """Area and longest side of each face, and its unit: two to the power of the third.

    So no square of a side over- or underflows. Done in blocks of faces: all corners at once would
    take more memory than all else that is counted of a mesh.
    """
    blocks, columns = [], np.ascontiguousarray(points.T)
    for start in range(0, len(faces), _BLOCK):
        # Arrays (3, 3, f), coordinates first: face by face it would take three times as long.
        some = faces[start : start + _BLOCK].T
        corners = columns.take(some.ravel(), axis=1).reshape(3, *some.shape)
        sides = np.concatenate([corners[:, 1:], corners[:, :1]], axis=1)
        sides -= corners
        exponents = np.frexp(np.abs(sides).reshape(9, -1).max(axis=0))[1]
        half = -exponents // 2  # one power of two might overflow
        sides *= np.ldexp(1.0, half)
        sides *= np.ldexp(1.0, -exponents - half)
        (ax, bx), (ay, by), (az, bz) = sides[:, [0, 2]]
        normals = (ay * bz - az * by) ** 2 + (az * bx - ax * bz) ** 2 + (ax * by - ay * bx) ** 2
        areas = 0.5 * np.sqrt(normals)
        longest = np.sqrt((sides**2).sum(axis=0).max(axis=0))
        blocks.append((areas, longest, exponents))
    areas, longest, exponents = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    return areas, longest, exponents


def _half_edges(faces: Ints) -> Ints:
    """From corner to corner of each face in turn, shape (3f, 2)."""
    return faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)


def side_keys(faces: Ints, n: int) -> Ints:
    """Return ``lower end * n + higher end`` of each side of faces on n points, shape (f, 3)."""
    heads = np.roll(faces, -1, axis=1)
    return np.minimum(faces, heads) * n + np.maximum(faces, heads)


def connected(a: Ints, b: Ints, n: int) -> Ints:
    """Return the part (n,) of each of n things, of which pairs are connected."""
    graph = sparse.csr_array((np.ones(len(a)), (a, b)), shape=(n, n))  # as the search takes it
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def distinct_rows(rows: Floats | Ints) -> tuple[Ints, Ints]:
    """Return the first place of each distinct row (n, d), ascending, and which one each row equals.

    So ``rows[first][label]`` is `rows`.
    """
    # Sorting brings equal rows together; lexsort is stable, so each group starts with its first.
    order = np.lexsort(rows.T)
    is_new = np.ones(len(rows), dtype=bool)
    is_new[1:] = (rows[order[1:]] != rows[order[:-1]]).any(axis=1)
    first = order[is_new]
    by_appearance = np.argsort(first)
    rank = np.empty_like(by_appearance)
    rank[by_appearance] = np.arange(len(first))
    label = np.empty_like(order)
    label[order] = rank[np.cumsum(is_new) - 1]
    return first[by_appearance], label


Geometry = TriangleMesh | PointCloud

# What `checked` makes a geometry or a mesh of (paths, pairs of arrays, objects of others) has no
# type in common: a type checker is told that it may be anything, and what it has become.
if TYPE_CHECKING:
    GeometryLike: TypeAlias = Geometry | Any
    MeshLike: TypeAlias = TriangleMesh | Any
else:
    GeometryLike, MeshLike = Geometry, TriangleMesh


def power_of_two(length: float | Floats) -> Floats:
    """Return the largest power of two that is not above `length`, 0 for 0."""
    return np.where(length, np.ldexp(1.0, np.frexp(length)[1] - 1), 0.0)


def box_unit(points: Floats) -> float:
    """Return about the longest side of the box around all points (n, 3); 1 where they coincide."""
    with np.errstate(over="ignore"):
        extent = np.ptp(points, axis=0).max()
    return float(power_of_two(min(extent, np.finfo(float).max))) or 1.0


def component_units(mesh: TriangleMesh) -> Floats:
    """Return about the longest side of the box around each vertex's component, shape (n,).

    0 where all its points coincide.
    """
    labels = mesh.component_labels
    order = np.argsort(labels, kind="stable")
    starts = np.flatnonzero(np.diff(labels[order], prepend=-1))
    low, high = (f.reduceat(mesh.points[order], starts) for f in (np.minimum, np.maximum))
    with np.errstate(over="ignore"):
        extents = (high - low).max(axis=1)
    return power_of_two(np.minimum(extents, np.finfo(float).max))[labels]
