"""Pictures of functions on geometries, drawn by PyVista in a process of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from spectra_kit._types import Bytes, Floats
from spectra_kit.geometry.shapes import Geometry, TriangleMesh
from spectra_kit.viz.contours import triangles_of
from spectra_kit.viz.drawer import draw_requests

_MARGIN = 4  # pixels around the geometry
_LARGEST_BALL = 0.12  # of the longest side


@dataclass(frozen=True, eq=False, kw_only=True)
class Scene:
    """A geometry seen from one side, or two, once for each function on it.

    Attributes
    ----------
    geometry : TriangleMesh or PointCloud
        A cloud is drawn as balls, and behind them the triangles between: no gap shows the far side.
    functions : sequence of ndarray of shape (n,)
        Values in [-1, 1]; what lies outside takes the colour of the end. Without `colours`: the
        colour of each point, shape (n, 3), uint8.
    rotation : ndarray of shape (3, 3)
        Rows: to the right, up, and towards the viewer.
    width : int
        Of a picture, in pixels; the height follows the geometry.
    colours : ndarray of shape (c, 3), uint8, optional
        From -1 to 1.
    normals : ndarray of shape (n, 3), optional
        Of a mesh, to light it by; by default those of its faces, averaged where it is not sharp.
    behind : bool, default False
        Draw all functions again from the other side.
    shifts : sequence of ndarray of shape (n, 3), optional
        For each function, how far it moves the points.
    swings : sequence of float, default (1,)
        Each function is drawn once for each of these, multiplied by it like its shift. All
        pictures have the same camera, with room for the largest shift.
    lines : sequence of ndarray of shape (s, 2, 3), optional
        For each function, segments to draw in dark grey a little before the surface.
    line_width : float or ndarray of shape (s,), default 2
        Of these, or of each of them all, in pixels: the same wherever they are, whatever way they
        run.
    diameter : float, optional
        Of the balls of a cloud; by default `ball_diameter`.
    """

    geometry: Geometry
    functions: Sequence[Floats] | Sequence[Bytes]
    rotation: Floats
    width: int
    colours: Bytes | None = None
    normals: Floats | None = None
    behind: bool = False
    shifts: Sequence[Floats] | None = None
    swings: Sequence[float] = (1.0,)
    lines: Sequence[Floats] | None = None
    line_width: float | Floats = 2.0
    diameter: float | None = None

    @property
    def n_pictures(self) -> int:
        """How many pictures it makes."""
        return len(self.functions) * len(self.swings) * (2 if self.behind else 1)


def render(
    scenes: Sequence[Scene], *, progress: Callable[[int, int], None] | None = None
) -> list[Bytes]:
    """Return the pictures (p, height, width, 3) of each scene, on white, drawn one by one.

    `progress` is called after each with the number of those drawn, and of all.
    """
    total = sum(scene.n_pictures for scene in scenes)
    pictures = iter(
        draw_requests(
            [_request(scene) for scene in scenes], lambda done: progress and progress(done, total)
        )
    )
    return [np.stack(list(islice(pictures, scene.n_pictures))) for scene in scenes]


def _request(scene: Scene) -> dict[str, Any]:
    """What the worker reads: everything in pixels, as single precision inside VTK wants it."""
    geometry, colours, normals = scene.geometry, scene.colours, scene.normals
    diameter = ball_diameter(geometry) if scene.diameter is None else scene.diameter
    seen = geometry.points @ scene.rotation.T
    shifts = np.stack(scene.shifts or [np.zeros((1, 3))]) @ scene.rotation.T
    # Points move on straight lines: the two farthest swings hold all between.
    ends = min(scene.swings), max(scene.swings)
    reached = np.vstack([seen + end * shift for shift in shifts for end in ends])
    box = np.stack([reached.min(axis=0), reached.max(axis=0)])
    lines = np.concatenate([np.empty((0, 2, 3)), *(scene.lines or ())])
    extent = np.ptp(box, axis=0)[:2] + diameter
    unit = max(float(extent[0]), float(extent[1]) / 8, 1e-300) / max(scene.width - 2 * _MARGIN, 1)
    height = int(np.ceil(extent[1] / unit)) + 2 * _MARGIN
    return {
        "points": seen / unit,
        "faces": triangles_of(geometry),
        "balls": not isinstance(geometry, TriangleMesh),
        "values": np.stack(scene.functions).astype(np.uint8 if colours is None else np.float32),
        "size": [scene.width, height],
        "half_height": height / 2,
        "diameter": diameter / unit,
        "colours": np.empty((0, 3), np.uint8) if colours is None else colours,
        "normals": np.empty((0, 3)) if normals is None else normals @ scene.rotation.T,
        "sides": [1, -1] if scene.behind else [1],
        "box": box / unit,
        "shifts": (shifts / unit if scene.shifts else shifts[:0]).astype(np.float32),
        "segments": lines @ scene.rotation.T / unit,
        "line_ends": np.cumsum([len(segments) for segments in scene.lines or ()], dtype=np.int64),
        "line_widths": np.broadcast_to(scene.line_width, len(lines)),
        "swings": np.asarray(scene.swings, dtype=np.float32),
    }


def ball_diameter(geometry: Geometry) -> float:
    """Diameter of a cloud's balls; of a mesh, 0.

    At the twelfth neighbour, few gaps show the far side; of few points this is half the cloud, and
    balls stay small enough to be told apart.
    """
    if isinstance(geometry, TriangleMesh):
        return 0.0
    distances, _ = cKDTree(geometry.points).query(geometry.points, k=min(13, geometry.n))
    longest = float(np.ptp(geometry.points, axis=0).max())
    return min(float(np.median(np.atleast_2d(distances.T)[-1])), _LARGEST_BALL * longest)
