"""Cleaning a geometry on request, and saying what went."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._checked import checked
from spectra_kit._types import Floats, Ints
from spectra_kit._validate import Brief, frozen, real_array
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import Geometry, PointCloud, TriangleMesh, distinct_rows


@checked
@dataclass(frozen=True, kw_only=True)
class RepairReport:
    """How many of each were removed; all 0 where nothing was wrong.

    Parameters
    ----------
    merged_points : int
        Points joined with an earlier one at exactly the same place.
    degenerate_faces : int
        Faces with a repeated vertex or without area, after the merge.
    duplicate_faces : int
        Faces that repeated the vertices of an earlier one.
    unreferenced_vertices : int
        Vertices that no remaining face used.
    nan_points : int
        Points that were NaN or infinite, of `without_nan`.
    """

    merged_points: int = 0
    degenerate_faces: int = 0
    duplicate_faces: int = 0
    unreferenced_vertices: int = 0
    nan_points: int = 0


@checked
@dataclass(frozen=True, eq=False)
class Repaired(Brief):
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
        """Carry a function of the cleaned geometry back to the original points.

        Parameters
        ----------
        values : array_like of shape (n,) or (n, d)
            One number or row for each point of the cleaned geometry.
        fill : float, default nan
            What removed points get.

        Returns
        -------
        ndarray of shape (n_original,) or (n_original, d)
            Merged points all get the value of their common point.

        Raises
        ------
        InvalidInputError
            If `values` has another number of rows.
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
def repair(geometry: Geometry, *, merge: bool = True) -> Repaired:
    """Return a clean copy of `geometry`: each point and face once, every face with area.

    For a mesh: coincident vertices are joined, then degenerate and duplicate faces dropped, then
    vertices without a face. Non-manifold edges, boundaries and separate components stay: the
    tufted Laplacian needs nothing done about them. For a cloud: duplicate points are dropped.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        Is left as it is.
    merge : bool, default True
        Join exactly coincident points. False keeps a surface apart where it only touches itself.

    Returns
    -------
    Repaired
        The copy, what was removed, and index arrays in both directions.

    Raises
    ------
    InvalidInputError
        If no face of a mesh has any area.

    Examples
    --------
    >>> from spectra_kit.geometry import TriangleMesh, repair
    >>> mesh = TriangleMesh(
    ...     [[0, 0, 0], [7, 7, 7], [1, 0, 0], [0, 1, 0], [1, 0, 0]],
    ...     [[0, 2, 3], [0, 4, 3], [2, 4, 3]],
    ... )
    >>> repaired = repair(mesh)
    >>> repaired.report
    RepairReport(merged_points=1, degenerate_faces=1, duplicate_faces=1, unreferenced_vertices=1,
                 nan_points=0)
    >>> repaired.vertex_index
    array([0, 2, 3])
    >>> repaired.restore([10.0, 20.0, 30.0])
    array([10., nan, 20., 30., 20.])
    """
    if merge:
        first, label = distinct_rows(geometry.points)
    else:
        first = label = np.arange(geometry.n)
    merged = geometry.n - len(first)
    if isinstance(geometry, PointCloud):
        cloud = PointCloud(geometry.points[first])
        return Repaired(cloud, RepairReport(merged_points=merged), frozen(first), frozen(label))
    joined = TriangleMesh(geometry.points[first], label[geometry.faces])
    if joined.degenerate_faces().all():
        raise InvalidInputError(
            "geometry",
            "have a face with area",
            f"{len(geometry.faces)} degenerate ones",
            advice="`as_cloud()` keeps its vertices",
        )
    proper = joined.without_degenerate_faces()
    distinct = proper.without_duplicate_faces()
    used = distinct.referenced_vertices
    new_index = np.full(joined.n, -1)
    new_index[used] = np.arange(len(used))
    report = RepairReport(
        merged_points=merged,
        degenerate_faces=len(joined.faces) - len(proper.faces),
        duplicate_faces=len(proper.faces) - len(distinct.faces),
        unreferenced_vertices=joined.n - len(used),
    )
    clean = distinct.without_unreferenced()
    return Repaired(clean, report, frozen(first[used]), frozen(new_index[label]))
