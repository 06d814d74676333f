"""Cleaning a geometry on request, and saying what went."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spectra_kit._core.checked import checked
from spectra_kit._core.records import Rebuilt
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import (
    as_array,
    check_faces,
    check_indices,
    check_points,
    real_array,
)
from spectra_kit._core.warn import warn
from spectra_kit.errors import InvalidInputError, SpectraKitWarning
from spectra_kit.geometry.io import content_of
from spectra_kit.geometry.polygons import Polygons, surface
from spectra_kit.geometry.seams import divided, joined, seams
from spectra_kit.geometry.shapes import (
    Geometry,
    GeometryLike,
    PointCloud,
    TriangleMesh,
    distinct_rows,
)
from spectra_kit.geometry.winding import turn, wound_against


@checked
@dataclass(frozen=True, kw_only=True)
class RepairReport:
    """How many of each were removed or turned; all 0 where nothing was wrong.

    Parameters
    ----------
    merged_points : int
        Points joined with an earlier one at exactly the same place.
    near_points : int
        Points joined with an earlier one that was only near.
    degenerate_faces : int
        Faces with a repeated vertex or without area, after the merge.
    duplicate_faces : int
        Faces that repeated the vertices of an earlier one.
    unreferenced_vertices : int
        Vertices that no remaining face used.
    nan_points : int
        Points that were NaN or infinite, of `without_nan`.
    turned_faces : int
        Faces that were wound against their neighbours.
    hanging_vertices : int
        Vertices at which faces were cut, inside of whose edges they lay.
    masked_points : int
        Points that were left out by `restrict`.
    """

    merged_points: int = 0
    near_points: int = 0
    degenerate_faces: int = 0
    duplicate_faces: int = 0
    unreferenced_vertices: int = 0
    nan_points: int = 0
    turned_faces: int = 0
    hanging_vertices: int = 0
    masked_points: int = 0


@checked
@dataclass(frozen=True, eq=False)
class Repaired(Rebuilt):
    """A cleaned geometry and its relation to the original.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        The cleaned copy, with n points.
    report : RepairReport
        What was removed.
    vertex_index : ndarray of shape (n,)
        The original point that each point is: ``values[vertex_index]`` carries a function of the
        original over.
    new_index : ndarray of shape (n_original,)
        The point that each original point has become; -1 where it was removed.
    """

    geometry: Geometry
    report: RepairReport
    vertex_index: Ints
    new_index: Ints

    def restore(self, values: ArrayLike, *, fill: float = np.nan) -> Floats:
        """Carry a function of the cleaned geometry, (n,) or (n, d), back to the original points.

        Merged points all get the value of their common point, removed ones get `fill`.
        """
        array = real_array("values", values)
        if array.shape[:1] != (self.geometry.n,):
            raise InvalidInputError(
                "values",
                f"have {self.geometry.n} rows, one for each point of the repaired geometry",
                f"shape {array.shape}",
            )
        restored = array[self.new_index]
        restored[self.new_index < 0] = fill
        return restored


@checked
def repair(
    geometry: GeometryLike, *, merge: bool = True, tolerance: float | None = None
) -> Repaired:
    """Return a clean copy of `geometry`: each point and face once, every face with area.

    For a mesh: coincident vertices are joined, and those that repeat each other up to rounding
    where boundary edges lie on others; where such an edge goes on from inside another, the face of
    that is cut; then degenerate and duplicate faces dropped, then vertices
    without a face; and the faces turned that are wound against their neighbours. Non-manifold
    edges, boundaries and separate components stay: the tufted Laplacian needs nothing done about
    them. For a cloud: duplicate points are dropped.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        Is left as it is.
    merge : bool, default True
        Join coincident points. False keeps a surface apart where it only touches itself.
    tolerance : float, optional
        Join what is so near, in length: points of a cloud, boundary vertices of a mesh, whether or
        not edges lie on others; 0 joins coincident points alone. By default, up to a hundredth of
        the shortest edge at either, along edges that lie on others as a whole.

    Returns
    -------
    Repaired
        The copy, what was removed, and index arrays in both directions. Points stay at the place of
        the earliest of those that were joined: none is moved farther than the tolerance.

    Notes
    -----
    Which faces are turned is told by the other faces of a component, the more against the fewer.
    Where no turning makes them agree, as on a Möbius strip, as few edges as may be are left where
    they do not; `diagnose` counts them.

    Examples
    --------
    >>> from spectra_kit.geometry import TriangleMesh, repair
    >>> mesh = TriangleMesh(
    ...     [[0, 0, 0], [7, 7, 7], [1, 0, 0], [0, 1, 0], [1, 0, 0]],
    ...     [[0, 2, 3], [0, 4, 3], [2, 4, 3]],
    ... )
    >>> repaired = repair(mesh)
    >>> {what: n for what, n in vars(repaired.report).items() if n}
    {'merged_points': 1, 'degenerate_faces': 1, 'duplicate_faces': 1, 'unreferenced_vertices': 1}
    >>> repaired.vertex_index
    array([0, 2, 3])
    >>> repaired.restore([10.0, 20.0, 30.0])
    array([10., nan, 20., 30., 20.])
    """
    if tolerance is not None and not 0 <= tolerance < np.inf:
        raise InvalidInputError("tolerance", "be a length, 0 or more", f"{tolerance:g}")
    first = label = np.arange(geometry.n)
    near, cut = 0, None
    if merge:
        first, label = distinct_rows(geometry.points)
        points = geometry.points[first]
        if isinstance(geometry, TriangleMesh) and tolerance is None:
            cut = seams(TriangleMesh(points, label[geometry.faces]))
            leader = cut.label if cut else np.arange(len(first))
        else:
            leader = _near(geometry, points, label, tolerance or 0.0)
        kept = leader == np.arange(len(first))
        near = int((~kept).sum())
        first, label = first[kept], (np.cumsum(kept) - 1)[leader[label]]
    merged = geometry.n - len(first) - near
    if isinstance(geometry, PointCloud):
        cloud = PointCloud(geometry.points[first])
        report = RepairReport(merged_points=merged, near_points=near)
        return Repaired(cloud, report, first, label)
    whole = TriangleMesh(geometry.points[first], label[geometry.faces])
    hanging = 0
    if cut and len(cut.hanging):
        new = np.cumsum(kept) - 1
        faces = divided(whole.points, whole.faces, new[cut.opened], new[cut.hanging])
        whole, hanging = TriangleMesh(whole.points, faces), len(np.unique(cut.hanging))
    if whole.degenerate_faces().all():
        raise InvalidInputError(
            "geometry",
            "have a face with area",
            f"{len(geometry.faces)} degenerate ones",
            advice="`as_cloud()` keeps its vertices",
        )
    proper = whole.without_degenerate_faces()
    distinct = proper.without_duplicate_faces()
    used = distinct.referenced_vertices
    new_index = np.full(whole.n, -1)
    new_index[used] = np.arange(len(used))
    clean = distinct.without_unreferenced()
    turned, _ = wound_against(clean)
    report = RepairReport(
        merged_points=merged,
        near_points=near,
        hanging_vertices=hanging,
        degenerate_faces=len(whole.faces) - len(proper.faces),
        duplicate_faces=len(proper.faces) - len(distinct.faces),
        unreferenced_vertices=whole.n - len(used),
        turned_faces=int(turned.sum()),
    )
    if turned.any():
        clean = TriangleMesh(clean.points, turn(clean.faces, turned))
    return Repaired(clean, report, first[used], new_index[label])


def _near(geometry: Geometry, points: Floats, label: Ints, tolerance: float) -> Ints:
    """Return which of the distinct points each of them is to be joined with."""
    alone = np.arange(len(points))
    if tolerance == 0:
        return alone
    if isinstance(geometry, PointCloud):
        return joined(points, np.full(len(points), tolerance))
    edge = TriangleMesh(points, label[geometry.faces]).boundary_vertices
    alone[edge] = edge[joined(points[edge], np.full(len(edge), tolerance))]
    return alone


@checked
def restrict(geometry: GeometryLike, keep: Any) -> Repaired:
    """Return the region of some points alone: cortex without its medial wall, a marked part.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        With n points; is left as it is.
    keep : array_like of bool, shape (n,)
        Which points are in the region. Faces of which a corner is not go, and then points without
        a face; where they were, the region has a boundary.

    Returns
    -------
    Repaired
        The region, and index arrays in both directions: ``values[vertex_index]`` carries a function
        over, ``restore(modes)`` brings one back to all points, NaN elsewhere.

    Warns
    -----
    SpectraKitWarning
        If nothing is left out, as where a mask names a label that the file has under another name.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> ball = sk.geometry.sphere(subdivisions=3).geometry
    >>> cap = sk.geometry.restrict(ball, ball.points[:, 2] > 0.5)
    >>> modes = sk.spectrum(cap.geometry, 4).eigenvectors
    >>> cap.restore(modes).shape, bool(np.isnan(cap.restore(modes)[ball.points[:, 2] < 0]).all())
    ((642, 4), True)
    """
    n = geometry.n
    mask: NDArray[Any] = as_array("keep", keep)
    if mask.dtype != bool or mask.shape != (n,):
        raise InvalidInputError(
            "keep",
            f"say True or False of each of {n} points",
            f"shape {mask.shape} of {mask.dtype}",
            advice="of indices, numpy.isin(numpy.arange(n), indices) does; of labels, labels > 0",
        )
    kept = mask
    if isinstance(geometry, TriangleMesh):
        faces = geometry.faces[mask[geometry.faces].all(axis=1)]
        if not len(faces):
            raise InvalidInputError("keep", "leave a face with all of its corners")
        kept = np.bincount(faces.ravel(), minlength=n) > 0
    elif not mask.any():
        raise InvalidInputError("keep", "leave a point")
    new_index = np.where(kept, np.cumsum(kept) - 1, -1)
    points = geometry.points[kept]
    region: Geometry = PointCloud(points)
    if isinstance(geometry, TriangleMesh):
        region = TriangleMesh(points, new_index[faces])
    if not (out := n - int(mask.sum())):
        advice = "of labels, look at the names: the medial wall may be one of them"
        warn(f"`keep` leaves out none of {n:,} points", SpectraKitWarning, advice=advice)
    report = RepairReport(masked_points=out, unreferenced_vertices=n - out - int(kept.sum()))
    return Repaired(region, report, np.flatnonzero(kept), new_index)


def without_nan(points: Any, faces: Any = None) -> Repaired:
    """Make a geometry of the points that are finite, and tell which they are.

    Parameters
    ----------
    points : path-like or array_like of shape (n, 3)
        A file, as `read` takes it, or coordinates, in length.
    faces : array_like of shape (f, 3), optional
        Vertex indices of triangles. Those of a point that is NaN or infinite go with it.

    Returns
    -------
    Repaired
        The geometry, with the index arrays that lead from its points to the rows of `points` and
        back: ``restore`` carries values over, NaN where there was no point.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.geometry import without_nan
    >>> scan = np.array([[0.0, 0, 0], [np.nan, np.nan, np.nan], [1, 0, 0]])
    >>> seen = without_nan(scan)
    >>> seen.geometry, seen.vertex_index
    (PointCloud(2 points), array([0, 2]))
    >>> seen.restore([5.0, 7.0])
    array([ 5., nan,  7.])
    """
    if isinstance(points, str | os.PathLike):
        return content_of(Path(points), _cleaned)
    return _cleaned(points, faces)


def _cleaned(points: Any, faces: Any) -> Repaired:
    if isinstance(faces, InvalidInputError):
        raise faces
    table: NDArray[Any] = as_array("points", points)
    if table.ndim != 2 or table.shape[1] != 3 or table.dtype.kind not in "fiu":
        check_points("points", table)
    is_there = np.isfinite(table).all(axis=1)
    new_index = np.where(is_there, np.cumsum(is_there) - 1, -1)
    report = RepairReport(nan_points=int((~is_there).sum()))
    geometry = _remaining(table[is_there], faces, new_index)
    return Repaired(geometry, report, np.flatnonzero(is_there), new_index)


def _remaining(points: Floats, faces: Any, new_index: Ints) -> Geometry:
    if faces is None:
        return PointCloud(points)
    n = len(new_index)
    corners, sizes = (
        faces if isinstance(faces, Polygons) else Polygons.of(check_faces("faces", faces, n))
    )
    corners = new_index[check_indices("faces", corners, n)]
    row = np.repeat(np.arange(len(sizes)), sizes)
    whole = np.bincount(row, corners < 0, minlength=len(sizes)) == 0
    if not whole.any():
        raise InvalidInputError("faces", "have one without NaN points")
    return surface(points, Polygons(corners[np.repeat(whole, sizes)], sizes[whole]))
