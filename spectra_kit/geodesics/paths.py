"""Shortest paths on triangles: `geodesic_path`, and `GeodesicPaths` for many from one source."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spectra_kit._core.checked import checked
from spectra_kit._core.records import Rebuilt, frozen
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_indices, check_points
from spectra_kit.errors import ConvergenceError, InvalidInputError
from spectra_kit.geodesics.exact import propagated
from spectra_kit.geodesics.sources import FacePoint, SourcesLike, points_named
from spectra_kit.geodesics.splits import Split, split_at
from spectra_kit.geometry import MeshLike
from spectra_kit.operators.checks import of_shape


@checked
@dataclass(frozen=True, eq=False, repr=False)
class SurfacePath(Rebuilt):
    """A polyline on the faces of a mesh, or over a cloud.

    Attributes
    ----------
    points : ndarray of shape (p, 3)
        Where it begins, crosses edges, bends, and ends; in the unit of the mesh.
    faces : ndarray of shape (p,)
        A face that holds each point and the segment that begins there; for the last, that before.
        Empty over a cloud.
    barycentric : ndarray of shape (p, 3)
        Weights of the corners of that face at the point; of a cloud (0, 3).

    Examples
    --------
    >>> import spectra_kit as sk
    >>> mesh = sk.geometry.sphere(subdivisions=3).geometry
    >>> path = sk.geodesic_path(mesh, 0, 100)
    >>> values = (path.barycentric * mesh.points[mesh.faces[path.faces], 2]).sum(axis=1)
    >>> bool(abs(values - path.points[:, 2]).max() < 1e-12)
    True
    """

    points: Floats
    faces: Ints
    barycentric: Floats

    def __post_init__(self) -> None:
        points = check_points("points", self.points)
        faces = check_indices("faces", self.faces, np.iinfo(np.int64).max)
        if faces.shape not in ((len(points),), (0,)):
            raise InvalidInputError("faces", f"have shape ({len(points)},) or (0,)", faces.shape)
        weights = of_shape("barycentric", self.barycentric, (len(faces), 3))
        for name, array in (("points", points), ("faces", faces), ("barycentric", weights)):
            object.__setattr__(self, name, frozen(np.array(array)))

    @property
    def lengths(self) -> Floats:
        """Length of the way from the first point to each, shape (p,)."""
        steps = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        return np.append(0.0, np.cumsum(steps))

    @property
    def length(self) -> float:
        """Length of the whole path."""
        return float(self.lengths[-1])

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        return f"SurfacePath({len(self.points)} points, length={self.length:.6g})"


@checked
class GeodesicPaths:
    """Shortest paths from one set of sources: the surface is searched once, each path is quick.

    Parameters
    ----------
    mesh : TriangleMesh
        With n vertices; any topology, as of `exact_distances`.
    sources : int, FacePoint, sequence or array of these, or mask
        Where paths begin, each at the nearest; see `check_sources`.
    targets : int, FacePoint, sequence or array of these, or mask, optional
        Where they shall end (default: any vertex): the search stops once these are known. Points
        inside faces must be named here.

    Attributes
    ----------
    mesh : TriangleMesh
        As given.

    Raises
    ------
    ConvergenceError
        As of `exact_distances`.

    Notes
    -----
    Exact, but that points of faces within 1e-6 of a corner or a side, in barycentric coordinates,
    are put there. Paths are straight over the unfolded triangles, and bend where `exact_distances`
    says; of several that are as short, one is returned. potpourri3d and pygeodesic have paths on
    manifold meshes of one winding.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> paths = sk.geodesics.GeodesicPaths(sk.geometry.sphere(subdivisions=3).geometry, 0)
    >>> bool(abs(paths.to(100).length - paths.distances[100]) < 1e-12)
    True
    """

    def __init__(
        self, mesh: MeshLike, sources: SourcesLike, *, targets: SourcesLike | None = None
    ) -> None:
        self.mesh = mesh
        begins = points_named("sources", sources, mesh)
        ends = [] if targets is None else points_named("targets", targets, mesh)
        self._split = split_at(mesh, [*begins, *ends])
        vertices = self._split.vertices
        self._places = dict(zip(ends, vertices[len(begins) :], strict=True))
        asked = list(self._places.values()) if targets is not None else np.arange(mesh.n)
        starts = np.unique(vertices[: len(begins)])
        self._known = propagated(self._split.mesh, starts, np.asarray(asked))
        self._all = targets is None

    def __repr__(self) -> str:
        known = "all vertices" if self._all else f"{len(self._places)} targets"
        return f"GeodesicPaths(n={self.mesh.n}, {known})"

    @property
    def distances(self) -> Floats:
        """Length of the path to each vertex, shape (n,); infinite where there is none.

        With `targets`, too long or infinite at vertices that are farther than all of them.
        """
        return frozen(self._known.distances[: self.mesh.n])

    def to(self, target: int | FacePoint) -> SurfacePath:
        """Return the shortest path from the nearest source to a vertex, or another of `targets`."""
        from spectra_kit.geodesics._walk_kernels import backtrace

        named = points_named("target", target, self.mesh)[0]
        end = self._places.get(named, named if self._all else None)
        if not isinstance(end, int):
            raise InvalidInputError(
                "target",
                "be a vertex" if self._all else "be one of `targets`",
                f"{target!r}",
                advice="name it in GeodesicPaths(mesh, sources, targets=...)",
            )
        if not np.isfinite(self._known.distances[end]):
            raise InvalidInputError(
                "target",
                "be reached from a source along faces",
                f"{target!r}, which is on another component",
                advice="`mesh.component_labels` tells them apart",
            )
        faces, ends, count, side, _ = backtrace(self._known.soup, self._known.front, end)
        if count and side < 0:
            raise ConvergenceError(
                f"the path to {target!r} is lost in triangles that are extremely thin; its length"
                " is known: remesh to see where it goes"
            )
        return path_of(self._split, faces[:count][::-1], ends[:count][::-1, ::-1], end)


@checked
def geodesic_path(mesh: MeshLike, source: int | FacePoint, target: int | FacePoint) -> SurfacePath:
    """Find the shortest path along the triangles between two points.

    Parameters
    ----------
    mesh : TriangleMesh
        Any topology, as of `exact_distances`.
    source, target : int or FacePoint
        Vertices, or points of faces, where it begins and ends.

    Returns
    -------
    SurfacePath
        Exact, as is its length, to a relative accuracy of about 1e-9.

    Raises
    ------
    InvalidInputError
        If no path leads there.

    See Also
    --------
    GeodesicPaths : Many paths from one source.
    shortened_path : The shortest of those that wind as a given one.

    Examples
    --------
    Over a roof, unfolded into the plane:

    >>> import spectra_kit as sk
    >>> points = [[0, 0, 0], [0, 4, 0], [2, 0, 2], [2, 4, 2], [4, 0, 0], [4, 4, 0]]
    >>> roof = sk.TriangleMesh(points, [[0, 2, 1], [1, 2, 3], [2, 4, 3], [3, 4, 5]])
    >>> path = sk.geodesic_path(roof, 0, 5)
    >>> bool(abs(path.length**2 - (4**2 + 2 * 4**2)) < 1e-12)
    True
    """
    (begin,), (end,) = (
        points_named(name, point, mesh) for name, point in (("source", source), ("target", target))
    )
    return GeodesicPaths(mesh, [begin], targets=[end]).to(end)


def path_of(split: Split, faces: Ints, ends: Floats, start: int) -> SurfacePath:
    """Return the path of segments (m,), (m, 2, 3) on a split mesh; at vertex `start` if none."""
    mesh = split.mesh
    corners = np.einsum("msc,mcr->msr", ends, mesh.points[mesh.faces[faces]])
    some = (corners[:, 0] != corners[:, 1]).any(axis=1)
    faces, ends = faces[some], ends[some]
    if len(faces):
        faces, weights = np.append(faces, faces[-1]), np.vstack([ends[:, 0], ends[-1:, 1]])
    else:
        where = np.argwhere(mesh.faces == start)[:1]
        faces, weights = where[:, 0], np.eye(3)[where[:, 1]]
    points = np.einsum("pc,pcr->pr", weights, mesh.points[mesh.faces[faces]])
    return SurfacePath(points, *split.original(faces, weights))
