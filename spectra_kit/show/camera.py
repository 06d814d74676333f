"""Where to look at a geometry from: upright where that can be told, and its broad side."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.sampling import sample
from spectra_kit.geometry.shapes import Geometry, GeometryLike, TriangleMesh

Up = Literal["x", "y", "z", "-x", "-y", "-z"]

_AZIMUTHS = np.deg2rad([30, -30, 60, -60, 150, -150, 120, -120])
_ELEVATION = np.deg2rad(22.0)
_STEEP = np.deg2rad(55.0)  # for what lies flat, like a sheet or a terrain
_STANDS = 0.1  # of the footprint that the lowest layer spans, at least, under what stands
_RATHER = 1.5  # times as much support makes the top a likelier side to stand on than the bottom
_TILT = np.cos(np.deg2rad(20))  # how level a face must lie on the floor, to be stood on
_TOP, _AT_AN_END = 0.15, 0.2  # of the height; of the width that it lies away from the middle
_PLANE = 1e-3  # thinner than this, relative to its width, is no more than a plane
_GRID = 40
_CLEARLY = 1.06  # a later view must show this much more than an earlier one


@checked
@dataclass(frozen=True)
class View:
    """Where a geometry is seen from.

    Attributes
    ----------
    up : {"x", "y", "z", "-x", "-y", "-z"}, optional
        The axis that points up in the picture, or, with a minus, down; by default the one the
        geometry seems to stand on.
    turn : float, default 0
        Degrees to turn the geometry about that axis, from the view chosen: its front goes right.

    Notes
    -----
    Up is y, or z where the geometry stands on that side, and more broadly, or what is said; and
    the other way round where it stands on nothing below, but could be put down on what is above.
    Of eight oblique views the one that covers most of the picture plane wins, earlier ones when in
    doubt, of those that see the head come towards them, where what is highest lies at one end, as
    of animals. What lies in a plane is faced, unless `up` is given.

    Examples
    --------
    >>> from spectra_kit.show import View
    >>> View("z", turn=150)
    View(up='z', turn=150)
    """

    up: Up | None = None
    turn: float = 0.0

    def __post_init__(self) -> None:
        if not np.isfinite(self.turn):
            raise InvalidInputError("turn", "be a finite number of degrees", repr(self.turn))

    def rotation(self, geometry: GeometryLike) -> Floats:
        """Return the rotation (3, 3) whose rows point right, up, and towards the viewer."""
        if isinstance(geometry, TriangleMesh) and geometry.area > 0:
            points = sample(geometry, 4000, seed=0).points
        else:
            points = geometry.points[:: max(geometry.n // 4000, 1)]
        up: str | None = self.up
        turn = math.fmod(self.turn, 360)
        if up is None:
            if (facing := _facing(points)) is not None:
                return _turned(facing, facing[1], turn)
            stands = {axis: _stands_on(points, "xyz".index(axis)) for axis in ("y", "z")}
            up = "z" if stands["z"] > max(stands["y"], _STANDS) else "y"
            if stands[up] < _STANDS:
                below, above = _support(points, "xyz".index(up))
                turned_over = _stands_on(-points, "xyz".index(up)) >= _STANDS
                if above > below * (1 if turned_over else _RATHER):
                    up = "-z" if up == "z" else "-y"
        axis, size = "xyz".index(up[-1]), np.ptp(points, axis=0)
        vertical = np.eye(3)[axis] * (-1 if up.startswith("-") else 1)
        flat = size[axis] < 0.12 * np.delete(size, axis).min()
        elevation = _STEEP if flat else _ELEVATION
        views = [_rotation(vertical, azimuth, elevation) for azimuth in _AZIMUTHS]
        head = _head(points, vertical)
        views = [view for view in views if head is None or view[2] @ head > 0]
        shown = [_coverage(points @ view.T) for view in views]
        best = 0
        for i in range(1, len(views)):
            best = i if shown[i] > _CLEARLY * shown[best] else best
        return _turned(views[best], vertical, turn)


def _turned(view: Floats, axis: Floats, degrees: float) -> Floats:
    """The view of a geometry that has been turned about an axis (3,), against the clock."""
    return np.asarray(view @ Rotation.from_rotvec(degrees * axis, degrees=True).as_matrix())


def _facing(points: Floats) -> Floats | None:
    """The view straight onto the plane of all points, x to the right if it can be; else None."""
    _, spread, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    if len(points) < 3 or not spread[2] < _PLANE * spread[1]:
        return None
    normal = axes[2] * (np.sign(axes[2][np.abs(axes[2]).argmax()]))
    across = np.eye(3)[int(np.abs(normal[0]) > np.abs(normal[1:]).max())]
    right = across - (across @ normal) * normal
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(normal, right), normal])


def _stands_on(points: Floats, axis: int) -> float:
    """Part of the footprint that the lowest layer spans; 0 if the centre is not above it."""
    height, flat = points[:, axis], np.delete(points, axis, axis=1)
    layer = flat[height <= height.min() + 0.04 * np.ptp(height)]
    low, high = layer.min(axis=0), layer.max(axis=0)
    centre = flat.mean(axis=0)
    if (centre < low).any() or (centre > high).any():
        return 0.0
    return float(np.prod(high - low) / max(np.prod(np.ptp(flat, axis=0)), 1e-300))


def _support(points: Floats, axis: int) -> tuple[float, float]:
    """Area of what a geometry could stand on, below and above: level faces of its hull."""
    try:
        hull = ConvexHull(points)
    except QhullError:  # on a plane, or a line
        return 0.0, 0.0
    a, b, c = points[hull.simplices].transpose(1, 0, 2)
    level = hull.equations[:, axis]
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) * np.abs(level) / 2
    return float(area[level < -_TILT].sum()), float(area[level > _TILT].sum())


def _head(points: Floats, vertical: Floats) -> Floats | None:
    """The level direction in which what is highest lies, if it lies at an end; else None."""
    height = points @ vertical
    flat = points - points.mean(axis=0)
    flat -= (flat @ vertical)[:, None] * vertical
    away = flat[height >= height.max() - _TOP * np.ptp(height)].mean(axis=0)
    width = float(np.ptp(flat, axis=0).max())
    return away if np.linalg.norm(away) > _AT_AN_END * width else None


def _rotation(vertical: Floats, azimuth: float, elevation: float) -> Floats:
    """Look down by `elevation` at a geometry turned by `azimuth` around the axis `vertical`."""
    # Facing the viewer at azimuth 0: +z for y-up (the habit of scans and games), -y for z-up (CAD).
    front, side = (((0, 0, 1), (0, 1, 0)), ((0, 0, 1), (1, 0, 0)), ((0, -1, 0), (1, 0, 0)))[
        int(np.abs(vertical).argmax())
    ]
    level = np.cos(azimuth) * np.array(front) + np.sin(azimuth) * np.array(side)
    towards = np.cos(elevation) * level + np.sin(elevation) * vertical
    right = np.cross(vertical, level)
    return np.stack([right, np.cross(towards, right), towards])


def _coverage(seen: Floats) -> float:
    """Area that the points cover in the picture plane, in cells relative to their extent."""
    flat = seen[:, :2] - seen[:, :2].min(axis=0)
    cell = max(float(np.ptp(seen, axis=0).max()) / _GRID, 1e-300)
    cells = np.unique((flat / cell).astype(np.int64), axis=0)
    return len(cells) * cell**2


def fitting_size(
    geometry: Geometry, rotation: Floats, widest: float, tallest: float
) -> tuple[float, float]:
    """Width and height at which a picture of a geometry just fits into that room."""
    across, up = np.maximum(np.ptp(geometry.points @ rotation.T, axis=0)[:2], 1e-300)
    width = float(max(min(widest, tallest * across / up), 0.3))
    return width, min(width * float(up / across), tallest)
