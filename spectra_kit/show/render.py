"""Pictures of functions on geometries, drawn by PyVista in a process of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from spectra_kit._core.types import Bytes, Floats, Ints
from spectra_kit.geometry.reference import sphere
from spectra_kit.geometry.shapes import Geometry, PointCloud, TriangleMesh
from spectra_kit.show.contours import triangles_of
from spectra_kit.show.drawer import draw_requests

_MARGIN = 4  # pixels around the geometry
_LARGEST_BALL = 0.12  # of the longest side


@dataclass(frozen=True, eq=False, kw_only=True)
class Scene:
    """A geometry seen from one side, or two, once for each function on it.

    A cloud is drawn as balls, and behind them the triangles between: no gap shows the far side.
    """

    geometry: Geometry
    functions: Sequence[Floats] | Sequence[Bytes]  # (n,) in [-1, 1]; or (n, 3), without `colours`
    rotation: Floats  # rows: to the right, up, and towards the viewer
    width: int  # of a picture, in pixels; the height follows the geometry
    colours: Bytes | None = None  # (c, 3), from -1 to 1
    normals: Floats | None = None  # (n, 3), to light by; else those of the faces, where not sharp
    behind: bool = False  # draw all functions again from the other side
    shifts: Sequence[Floats] | None = None  # (n, 3): how far each function moves the points
    # Each function is drawn once for each of these, multiplied by it like its shift; all pictures
    # have the same camera, with room for the largest shift.
    swings: Sequence[float] = (1.0,)
    lines: Sequence[Floats] | None = None  # (s, 2, 3) of each function, lifted a little
    line_width: float | Floats = 2.0  # in pixels, whatever way they run; or (s,) of all of them
    diameter: float | None = None  # of the balls of a cloud; by default `ball_diameter`

    @property
    def n_pictures(self) -> int:
        """How many pictures it makes."""
        return len(self.functions) * len(self.swings) * (2 if self.behind else 1)


def render(
    scenes: Sequence[Scene], *, progress: Callable[[int, int], None] | None = None
) -> list[Bytes]:
    """Return the pictures (p, height, width, 3) of each scene, on white, and tell `progress`."""
    total = sum(scene.n_pictures for scene in scenes)
    requests = [_request(scene) for scene in scenes]
    pictures = iter(draw_requests(requests, lambda done: progress and progress(done, total)))
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

    At the twelfth neighbour few gaps show the far side; balls of few points stay apart.
    """
    if isinstance(geometry, TriangleMesh):
        return 0.0
    distances, _ = cKDTree(geometry.points).query(geometry.points, k=min(13, geometry.n))
    longest = float(np.ptp(geometry.points, axis=0).max())
    return min(float(np.median(np.atleast_2d(distances.T)[-1])), _LARGEST_BALL * longest)


def with_balls(geometry: Geometry, centres: Floats, radius: float) -> tuple[Geometry, Ints]:
    """Add balls around `centres` (b, 3), and tell whose ball each point is of, -1 for its own."""
    ball = sphere(subdivisions=3 if isinstance(geometry, TriangleMesh) else 2).geometry
    owner = np.append(np.full(geometry.n, -1), np.repeat(np.arange(len(centres)), ball.n))
    points = np.vstack([geometry.points, *(radius * ball.points + centre for centre in centres)])
    if not isinstance(geometry, TriangleMesh):
        return PointCloud(points), owner
    faces = [ball.faces + geometry.n + i * ball.n for i in range(len(centres))]
    return TriangleMesh(points, np.vstack([geometry.faces, *faces])), owner
