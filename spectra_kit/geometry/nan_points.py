"""Points without a place: NaN, as structured scans write them where they saw nothing."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.records import frozen
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import as_array, check_faces, check_indices, check_points
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.io import content_of
from spectra_kit.geometry.polygons import Polygons, surface
from spectra_kit.geometry.repair import Repaired, RepairReport
from spectra_kit.geometry.shapes import Geometry, PointCloud


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
    return Repaired(geometry, report, frozen(np.flatnonzero(is_there)), frozen(new_index))


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
