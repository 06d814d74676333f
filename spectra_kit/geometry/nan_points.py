"""Points without a place: NaN, as structured scans write them where they saw nothing."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from spectra_kit._types import Floats, Ints
from spectra_kit._validate import as_array, check_indices, frozen
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
    faces : array_like of shape (f, s), optional
        The corners of each face. Those that use a point that is NaN or infinite go with it.

    Returns
    -------
    Repaired
        The geometry, with the index arrays that lead from its points to the rows of `points` and
        back: ``restore`` carries values over, NaN where there was no point.

    Raises
    ------
    InvalidInputError
        If no point or no face is left, or as from `read`, `PointCloud` and `TriangleMesh`.

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
    table = as_array("points", points)
    is_there = np.ones(len(table), dtype=bool)
    if table.ndim == 2 and table.dtype.kind == "f":
        is_there = np.isfinite(table).all(axis=1)
    new_index = np.where(is_there, np.cumsum(is_there) - 1, -1)
    report = RepairReport(nan_points=int((~is_there).sum()))
    geometry = _remaining(table[is_there], faces, new_index)
    return Repaired(geometry, report, frozen(np.flatnonzero(is_there)), frozen(new_index))


def _remaining(points: Floats, faces: Any, new_index: Ints) -> Geometry:
    if faces is None:
        return PointCloud(points)
    corners, sizes = faces if isinstance(faces, Polygons) else Polygons.of(np.asarray(faces))
    corners = new_index[check_indices("faces", corners, len(new_index))]
    row = np.repeat(np.arange(len(sizes)), sizes)
    whole = np.bincount(row, corners < 0, minlength=len(sizes)) == 0
    if not whole.any():
        raise InvalidInputError("faces", "have one without NaN points")
    return surface(points, Polygons(corners[np.repeat(whole, sizes)], sizes[whole]))
