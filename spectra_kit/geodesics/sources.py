"""Where the heat is put: at vertices, or at any point of a face."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spectra_kit._core.checked import checked
from spectra_kit._core.records import frozen
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_count, check_indices, real_array
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import GeometryLike, MeshLike, TriangleMesh
from spectra_kit.geometry.shapes import box_unit

_FAR = 1e6  # times the largest coordinate of the points
#: What rounding may do to barycentric coordinates.
_ROUNDING = 1e-9


@checked
@dataclass(frozen=True)
class FacePoint:
    """A point of a face of a mesh.

    Parameters
    ----------
    face : int
        Index of the face.
    barycentric : array_like of shape (3,)
        Weights of the corners of the face, in its order: not negative, and of sum 1.

    See Also
    --------
    nearest_source : The point of a mesh that is nearest to a coordinate.

    Notes
    -----
    What takes a mesh takes it. What knows no faces, as a triangulation or a spectrum, takes
    ``check_sources(point, mesh)``; a cloud, its nearest point.

    Examples
    --------
    >>> from spectra_kit.geodesics import FacePoint, exact_distances
    >>> from spectra_kit.geometry import sphere
    >>> mesh, point = sphere(subdivisions=2).geometry, FacePoint(7, [0.5, 0.25, 0.25])
    >>> point
    FacePoint(face=7, barycentric=(0.5, 0.25, 0.25))
    >>> exact_distances(mesh, point)[mesh.faces[point.face]]
    array([0.1..., 0.2..., 0.2...])
    """

    face: int
    barycentric: tuple[float, float, float]

    def __post_init__(self) -> None:
        weights = np.array(self.barycentric)
        if weights.min() < -_ROUNDING or abs(weights.sum() - 1) > _ROUNDING:
            raise InvalidInputError(
                "barycentric",
                "be non-negative and sum to 1",
                f"{tuple(weights.tolist())} of sum {weights.sum():.6g}",
                advice="`nearest_source` finds those of a coordinate",
            )
        weights = np.maximum(weights, 0.0)
        object.__setattr__(self, "face", check_count("face", self.face, low=0))
        object.__setattr__(self, "barycentric", tuple((weights / weights.sum()).tolist()))

    def position(self, mesh: MeshLike) -> Floats:
        """Return the coordinates (3,) of the point on a mesh, whose faces it counts."""
        return np.asarray(np.array(self.barycentric) @ mesh.points[_corners(self, mesh)])


@checked
@dataclass(frozen=True, eq=False)
class Sources:
    """Heat at vertices, and how far each is from the nearest source: what `check_sources` makes.

    Parameters
    ----------
    n : int
        Number of points of the geometry.
    vertices : ndarray of shape (m,)
        Vertices that receive heat, ascending, each once: the sources, or the corners around them.
    heat : ndarray of shape (m,)
        Heat that each receives, positive.
    offsets : ndarray of shape (m,)
        Distance of each to the nearest source around it, in length: 0 at a source.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> cloud = sk.PointCloud([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    >>> found = sk.geodesics.check_sources([2, 0], cloud)
    >>> found.vertices, found.right_hand_side()
    (array([0, 2]), array([1., 0., 1.]))
    """

    n: int
    vertices: Ints
    heat: Floats
    offsets: Floats

    def right_hand_side(self) -> Floats:
        """Return the heat (n,) at all points, integrated: the right side of the step."""
        heat = np.zeros(self.n)
        heat[self.vertices] = self.heat
        return heat


@runtime_checkable
class HasPoints(Protocol):
    """A geometry, or what was made of one and has kept its points: a triangulation, a spectrum."""

    @property
    def n(self) -> int:
        """Number of points."""


#: What names sources: an index, a face point, several of these, or a mask of the points.
SourcesLike = Sources | FacePoint | int | Sequence[int | FacePoint] | NDArray[np.integer | np.bool_]


@checked
def check_sources(
    sources: SourcesLike, geometry: HasPoints, weights: ArrayLike | None = None
) -> Sources:
    """Turn any way to name sources into heat at vertices.

    Parameters
    ----------
    sources : int, FacePoint, sequence of these, array of int or bool, or Sources
        Indices of vertices, a mask of shape (n,) of them, points of faces, or what this function
        returned before. Two sources at one place are one that emits the heat of both.
    geometry : TriangleMesh, PointCloud, IntrinsicTriangulation or Spectrum
        Of n points. A `FacePoint` needs the mesh, whose faces it counts.
    weights : array_like of shape (s,), optional
        Heat that each of the s sources emits, positive; 1 by default. The shorter the time, the
        less it matters to distances.

    Returns
    -------
    Sources
        The heat of a point of a face goes to its corners by its barycentric coordinates, so that
        one at a corner is that vertex, and the heat stays linear across the face.

    Examples
    --------
    >>> from spectra_kit.geodesics import FacePoint, check_sources
    >>> from spectra_kit.geometry import TriangleMesh
    >>> mesh = TriangleMesh([[0, 0, 0], [3, 0, 0], [0, 4, 0]], [[0, 1, 2]])
    >>> found = check_sources([0, FacePoint(0, [0, 0.5, 0.5])], mesh)
    >>> found.vertices, found.heat, found.offsets
    (array([0, 1, 2]), array([1. , 0.5, 0.5]), array([0. , 2.5, 2.5]))
    """
    if isinstance(sources, Sources):
        if weights is not None:
            raise InvalidInputError("weights", "be None where `sources` are checked, and hold them")
        if sources.n != geometry.n:
            expected = f"belong to the geometry of {geometry.n} points"
            raise InvalidInputError("sources", expected, f"those of one of {sources.n}")
        return sources
    owners, every, shares, lengths = spread(sources, geometry)
    if weights is not None:
        shares = shares * _check_weights(weights, int(owners[-1]) + 1)[owners]
    vertices, index = np.unique(every, return_inverse=True)
    offsets = np.full(len(vertices), np.inf)
    np.minimum.at(offsets, index, lengths)
    heat = np.zeros(len(vertices))
    np.add.at(heat, index, shares)
    return Sources(geometry.n, frozen(vertices), frozen(heat), frozen(offsets))


@checked
def nearest_source(geometry: GeometryLike, coordinate: ArrayLike) -> int | FacePoint:
    """Find the source nearest to a point of space.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        Where to search.
    coordinate : array_like of shape (3,)
        In the unit of `geometry`; it need not lie on the surface.

    Returns
    -------
    FacePoint or int
        The nearest point of the faces of a mesh, put on a corner or side within 1e-9 of it (in
        barycentric coordinates); the index of the nearest point of a cloud.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> mesh = sk.TriangleMesh([[0, 0, 0], [3, 0, 0], [0, 4, 0]], [[0, 1, 2]])
    >>> sk.geodesics.nearest_source(mesh, [0.0, 1.0, 5.0])
    FacePoint(face=0, barycentric=(0.75, 0.0, 0.25))
    >>> sk.geodesics.nearest_source(mesh.as_cloud(), [0.0, 1.0, 5.0])
    0
    """
    target = real_array("coordinate", coordinate)
    if target.shape != (3,):
        raise InvalidInputError("coordinate", "have shape (3,)", target.shape)
    low, high = geometry.points.min(axis=0), geometry.points.max(axis=0)
    size, away = np.abs([low, high]).max(), np.abs(target).max()
    if away > _FAR * size > 0:
        raise InvalidInputError(
            "coordinate",
            f"lie near the points, which reach {size:.3g}",
            f"{away:.3g}",
            advice="is the unit the same?",
        )
    unit = box_unit(geometry.points)
    points, target = geometry.points / unit, target / unit
    if not isinstance(geometry, TriangleMesh):
        return int(np.argmin(np.sum((points - target) ** 2, axis=1)))
    import igl

    # A face of no area has no coordinates of its own; its sides belong to others too.
    proper = np.flatnonzero(~geometry.degenerate_faces())
    if not len(proper):
        raise InvalidInputError(
            "geometry", "have a face of positive area", f"{len(geometry.faces)} without"
        )
    faces = np.array(geometry.faces[proper])
    _, face, closest = igl.point_mesh_squared_distance(target[None], points, faces)
    a, b, c = points[faces[face[0]]]
    sides = np.column_stack([b - a, c - a])
    beta, gamma = np.linalg.lstsq(sides, closest[0] - a)[0]
    weights = np.array([1 - beta - gamma, beta, gamma])
    weights = np.where(weights < _ROUNDING, 0.0, weights)
    return FacePoint(int(proper[face[0]]), tuple((weights / weights.sum()).tolist()))


def points_named(name: str, points: Any, mesh: TriangleMesh) -> list[int | FacePoint]:
    """Return points one by one, all of them on the surface; a vertex as such, however named."""
    named = named_sources(points, mesh, name)
    if not named:
        raise InvalidInputError(name, "name at least one point", "none")
    for i, point in enumerate(named):
        if isinstance(point, FacePoint):
            corners = _corners(point, mesh)
            if max(point.barycentric) == 1:
                named[i] = int(corners[np.argmax(point.barycentric)])
    _check_used(name, np.array([p for p in named if not isinstance(p, FacePoint)], int), mesh)
    return named


def spread(
    sources: Any, geometry: HasPoints, name: str = "sources"
) -> tuple[Ints, Ints, Floats, Floats]:
    """Return which source heats which vertices, what share of it that is, and how far it is."""
    named = named_sources(sources, geometry, name)
    if not named:
        raise InvalidInputError(name, "name at least one source", "none")
    rows = [_spread(source, geometry) for source in named]
    owners = np.repeat(np.arange(len(rows)), [len(row[0]) for row in rows])
    points, shares, lengths = (np.concatenate(column) for column in zip(*rows, strict=True))
    _check_used(name, points, geometry)
    return owners, points, shares, lengths


def _check_used(name: str, vertices: Ints, geometry: HasPoints) -> None:
    if not isinstance(geometry, TriangleMesh) or not len(vertices):
        return
    used = geometry.referenced_vertices  # ascending
    lone = np.sort(vertices[used[np.searchsorted(used[:-1], vertices)] != vertices])
    if len(lone):
        raise InvalidInputError(
            name,
            "lie on the surface",
            f"vertex {lone[0]}, which no face uses",
            advice="drop such vertices with {}",
            remedies=("mesh.without_unreferenced()",),
        )


def named_sources(
    sources: Any, geometry: HasPoints, name: str = "sources"
) -> list[int | FacePoint]:
    """Return the sources one by one."""
    if isinstance(sources, Sources):
        if sources.offsets.any():
            raise InvalidInputError(
                name,
                "be vertices and points of faces as they were named",
                "what became of points inside faces, the heat of their corners",
            )
        return list(sources.vertices.tolist())
    if isinstance(sources, FacePoint):
        return [sources]
    listed = isinstance(sources, Sequence)
    if listed and (not len(sources) or any(isinstance(s, FacePoint) for s in sources)):
        high = geometry.n - 1  # to NumPy an empty list is one of floats
        return [
            s if isinstance(s, FacePoint) else check_count(name, s, low=0, high=high)
            for s in sources
        ]
    if isinstance(sources, np.ndarray) and sources.dtype == bool:
        if sources.shape != (geometry.n,):
            raise InvalidInputError(name, f"have shape ({geometry.n},) as a mask", sources.shape)
        sources = np.flatnonzero(sources)
    array = check_indices(name, sources, geometry.n)
    if array.ndim > 1:
        raise InvalidInputError(
            name,
            "be one index or a vector of them",
            f"shape {array.shape}",
            advice="`nearest_source` finds that of a coordinate",
        )
    return list(np.atleast_1d(array).tolist())


def _spread(source: int | FacePoint, geometry: HasPoints) -> tuple[Ints, Floats, Floats]:
    """Return the vertices a source heats, their shares and their distances to it."""
    if not isinstance(source, FacePoint):
        return np.array([source]), np.ones(1), np.zeros(1)
    if not isinstance(geometry, TriangleMesh):
        raise InvalidInputError(
            "sources",
            "be vertices where `geometry` has no faces",
            f"a FacePoint on a {type(geometry).__name__}",
            advice="on a cloud, name the nearest point; for a spectrum or triangulation pass"
            " `check_sources(sources, mesh)`",
        )
    corners, shares = _corners(source, geometry), np.array(source.barycentric)
    lengths = np.linalg.norm(geometry.points[corners] - source.position(geometry), axis=1)
    heated = shares > 0
    return corners[heated], shares[heated], lengths[heated]


def _corners(point: FacePoint, mesh: TriangleMesh) -> Ints:
    return np.asarray(mesh.faces[check_indices("face", point.face, len(mesh.faces))])


def _check_weights(weights: ArrayLike, count: int) -> Floats:
    array = real_array("weights", weights)
    if array.shape != (count,):
        raise InvalidInputError(
            "weights", f"have one entry for each of the {count} sources", f"shape {array.shape}"
        )
    if not (array > 0).all():
        raise InvalidInputError(
            "weights", "be positive", f"{array.min():.3g}", advice="leave the source out instead"
        )
    return array
