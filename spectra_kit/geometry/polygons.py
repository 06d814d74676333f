"""Polygons of any number of corners, cut into triangles: fans where they are right, ears elsewhere.

A fan around the first corner is right for every convex polygon, and for those others of which that
corner sees all. What it does not fit is cut by Mapbox's ear clipping in the polygon's own plane;
a hole is part of its outline, by a bridge that is passed twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import as_array, check_indices, check_points, quantity
from spectra_kit._core.warn import warn
from spectra_kit.errors import IgnoredContentWarning, InvalidInputError
from spectra_kit.geometry.shapes import TriangleMesh

# All below is measured in the largest extent of each polygon, and its square.
_ROUNDING = 1e-13  # of cross products of doubles
_TOUCHING = 1e-5  # by which outlines overlap themselves where coordinates have six digits
_STEEP = 2.0  # times as large as its shadow is what stands at 60 degrees to its plane
_BLOCK = 1 << 16


class Polygons(NamedTuple):
    """The corners of p polygons, one after the other, and how many each has."""

    corners: Ints  # (c,)
    sizes: Ints  # (p,)

    @classmethod
    def of(cls, rows: Sequence[Sequence[int]] | Ints) -> Polygons:
        """Return the polygons that `rows` list, or the rows of a table."""
        if isinstance(rows, np.ndarray):
            return cls(rows.ravel(), np.full(len(rows), rows.shape[1]))
        flat = [corner for row in rows for corner in row]
        return cls(np.array(flat, dtype=np.int64), np.array([len(row) for row in rows], np.int64))


def surface(points: Any, faces: Any) -> TriangleMesh:
    """Return the mesh of polygons of any size, as files and other programs have them.

    Faces of fewer than three corners beside proper ones, and NaN points that no face uses, are left
    out with a warning. (A table of four columns may be one of tetrahedra.)
    """
    if not isinstance(faces, Polygons):
        table: NDArray[Any] = as_array("faces", faces)
        if table.ndim != 2 or table.shape[1] != 3 or table.dtype.kind not in "iu":
            return TriangleMesh(points, table)
        faces = Polygons.of(table)
    corners, sizes = faces
    points, proper = as_array("points", points), sizes >= 3
    if proper.any() and not proper.all():
        check_indices("faces", corners, len(points))  # those left out tell of damage as well
        told = f"{quantity((~proper).sum(), 'face')} of fewer than 3 corners"
        first = f"the first being face {proper.argmin()}, counted from 0"
        warn(f"passed over {told}, {first}", IgnoredContentWarning)
        corners, sizes = corners[np.repeat(proper, sizes)], sizes[proper]
    points, corners = _without_unused_nan(points, corners)
    if (sizes == 3).all():
        return TriangleMesh(points, corners.reshape(-1, 3))
    points = check_points("points", points)
    return TriangleMesh(points, triangulate(points, Polygons(corners, sizes)))


def _without_unused_nan(points: NDArray[Any], corners: Ints) -> tuple[NDArray[Any], Ints]:
    """Leave out points that are NaN or infinite where no face uses one of them."""
    if points.ndim != 2 or points.dtype.kind != "f" or np.isfinite(points).all():
        return points, corners
    is_there = np.isfinite(points).all(axis=1)
    corners = check_indices("faces", corners, len(points))
    if not is_there[corners].all():
        return points, corners
    lost = int((~is_there).sum())
    warn(
        f"left out {quantity(lost, 'NaN vertex')} that no face uses, the first being vertex"
        f" {is_there.argmin()}, counted from 0; those behind have moved up",
        IgnoredContentWarning,
    )
    return points[is_there], (np.cumsum(is_there) - 1)[corners]


def triangulate(points: Floats, polygons: Polygons | Sequence[Sequence[int]] | Ints) -> Ints:
    """Cut polygons of three or more corners into triangles, in their order and of their winding.

    A triangle stays as it is; s corners make s - 2 triangles with all of them, or none where an
    outline runs back upon itself and encloses nothing.
    """
    corners, sizes = polygons if isinstance(polygons, Polygons) else Polygons.of(polygons)
    corners = check_indices("faces", corners, len(points))
    if len(sizes) and sizes.min() < 3:
        raise InvalidInputError(f"a face must have at least 3 corners, got one with {sizes.min()}")
    first, place = np.cumsum(sizes) - sizes, np.cumsum(sizes - 2) - (sizes - 2)
    triangles = np.empty((int((sizes - 2).sum()), 3), dtype=np.int64)
    is_there = np.ones(len(triangles), dtype=bool)
    steep: list[int] = []
    for size in np.unique(sizes).tolist():
        of_size, fan = np.flatnonzero(sizes == size), np.arange(size - 2)
        block = max(_BLOCK // size, 1)
        for these in (of_size[i : i + block] for i in range(0, len(of_size), block)):
            table = corners[first[these, None] + np.arange(size)]
            rows = place[these, None] + fan
            if size == 3:
                triangles[rows[:, 0]] = table
                continue
            outlines = _scaled(points[table])
            areas, is_fan = _fans(outlines)
            cut = np.tile(np.stack([0 * fan, fan + 1, fan + 2], axis=1), (len(these), 1, 1))
            for i in np.flatnonzero(~is_fan):
                ears = _ears(outlines[i], int(these[i]))
                cut[i, : len(ears)] = ears
                is_there[rows[i, len(ears) :]] = False
            each = np.arange(len(these))[:, None, None]
            triangles[rows] = table[each, cut]
            a, b, c = np.moveaxis(outlines[each, cut], 2, 0)
            slopes = np.linalg.norm(np.cross(b - a, c - a), axis=2) * is_there[rows]
            steep += these[slopes.sum(axis=1) > _STEEP * areas + _TOUCHING].tolist()
    if steep:
        warn(
            f"{quantity(len(steep), 'polygon')} cut as if flat, though far from any plane, the"
            f" first being face {min(steep)}, counted from 0",
            IgnoredContentWarning,
        )
    return triangles[is_there]


def _scaled(outlines: Floats) -> Floats:
    """Return corners (m, s, 3) from the first of each polygon, in its largest extent."""
    with np.errstate(over="ignore", invalid="ignore"):
        half = 0.5 * outlines  # the difference of two numbers near the largest is none
        outlines = half - half[:, :1]
        extent = np.abs(outlines).max(axis=(1, 2), keepdims=True)
        return outlines / np.where(extent > 0, extent, 1.0)


def _fans(outlines: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Return twice the area that each outline has in its plane, and whether its fan is right.

    It is where all triangles face one way, and turn less than once around the first corner.
    """
    sides = outlines[:, 1:]
    crosses = np.cross(sides[:, :-1], sides[:, 1:])
    normals = crosses.sum(axis=1)  # Newell's
    areas = np.linalg.norm(normals, axis=1)
    normals = normals / np.where(areas > 0, areas, 1.0)[:, None]
    facing = np.einsum("mtj,mj->mt", crosses, normals)
    flat = sides - np.einsum("msj,mj->ms", sides, normals)[..., None] * normals[:, None]
    angles = np.arctan2(facing, np.einsum("mtj,mtj->mt", flat[:, :-1], flat[:, 1:]))
    before, after = sides[:, :-1], sides[:, 1:]  # a corner twice makes no triangle, however cut
    twice = (before == after).all(axis=2) | (before == 0).all(axis=2) | (after == 0).all(axis=2)
    right = ((facing > _ROUNDING) | twice).all(axis=1) & (angles.sum(axis=1) < 2 * np.pi)
    without_area = np.linalg.norm(crosses, axis=2).max(axis=1) <= _ROUNDING
    return areas, right | without_area  # on a line, where nothing depends on how it is cut


def _ears(outline: Floats, face: int) -> Ints:
    """Cut one outline (s, 3) by its ears: s - 2 triangles, or none where it encloses nothing."""
    import mapbox_earcut  # where a mesh has such polygons: few do

    normal = np.cross(outline[:-1], outline[1:]).sum(axis=0)
    area = float(np.linalg.norm(normal))
    # Where areas cancel there is no plane but that in which the corners spread most.
    towards = normal / area if area > _TOUCHING else np.linalg.svd(outline)[2][2]
    across = np.cross(towards, np.eye(3)[np.abs(towards).argmin()])
    across /= np.linalg.norm(across)
    flat = outline @ np.stack([across, np.cross(towards, across)], axis=1)
    cut = mapbox_earcut.triangulate_float64(flat, np.array([len(flat)], dtype=np.uint32))
    ears = cut.reshape(-1, 3).astype(np.int64)
    (x, y), (u, v) = ((flat[ears[:, i]] - flat[ears[:, 0]]).T for i in (1, 2))
    is_whole = abs(np.abs(x * v - y * u).sum() - area) <= _TOUCHING
    if not is_whole or len(ears) > len(outline) - 2:
        raise InvalidInputError(
            f"face {face}, counted from 0, crosses itself, and encloses areas that cancel",
            advice="list its corners in order around it, or cut it into triangles",
        )
    return _with_dropped(ears, len(outline)) if len(ears) else ears


def _with_dropped(ears: Ints, size: int) -> Ints:
    """Put back the corners on straight sides that the clipping dropped: others may meet them there.

    Each parts the triangle behind its side.
    """
    rows, kept = ears.tolist(), set(ears.ravel().tolist())
    before = start = min(kept)
    for corner in (i % size for i in range(start + 1, start + size)):
        if corner not in kept:
            after = next(i % size for i in range(corner + 1, corner + size) if i % size in kept)
            tips = [(i, row[j - 1]) for i, row in enumerate(rows) for j in range(3)
                    if (row[j - 3], row[j - 2]) == (before, after)]  # fmt: skip
            if tips:
                i, tip = tips[0]
                rows[i] = [before, corner, tip]
                rows.append([corner, after, tip])
            else:
                rows.append([before, corner, after])
            kept.add(corner)
        before = corner
    return np.array(rows, dtype=np.int64)
