"""Pictures of functions on geometries, drawn by PyVista in a process of its own.

That is kept for the next pictures: to start it takes longer than to draw.
"""

from __future__ import annotations

import atexit
import os
import pickle
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from spectra_kit._core.files import cleaned
from spectra_kit._core.types import Bytes, Floats, Ints
from spectra_kit.errors import MissingDependencyError
from spectra_kit.geometry.reference import sphere
from spectra_kit.geometry.shapes import Geometry, PointCloud, TriangleMesh
from spectra_kit.show.contours import triangles_of

_WORKER = Path(__file__).with_name("worker.py")
_PATIENCE = 10.0  # seconds for a worker to end by itself
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


def draw_requests(
    requests: Sequence[Mapping[str, Any]], drawn: Callable[[int], None]
) -> list[Bytes]:
    """Return the pictures of all requests as `worker.draw` takes them; count those `drawn`.

    What the process that draws raises is raised here, with its traceback as a note.
    """
    mine, reason = _of_this_process(), ""
    with mine.turn:
        for renderer in mine.renderers():
            mine.renderer = None
            answer = renderer.draw(requests, drawn)
            if isinstance(answer, str):
                reason = answer
                continue
            mine.renderer = renderer
            if isinstance(answer, Exception):
                raise answer
            return answer
    raise MissingDependencyError(
        f"PyVista could not draw ({reason}); it needs an OpenGL library but no display,"
        " on Debian or Ubuntu: apt-get install libegl1 libgl1"
    )


class _Renderer:
    """A running worker. It ends with this process, or when it has nothing to draw for a while."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._complaints = tempfile.TemporaryFile("w+", errors="replace")  # noqa: SIM115  # as long as the process
        self._process = subprocess.Popen(
            # -P: the folder of the worker must not shadow other modules.
            [sys.executable, "-P", str(_WORKER)],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._complaints,
        )

    def draw(
        self, requests: Sequence[Mapping[str, Any]], drawn: Callable[[int], None]
    ) -> list[Bytes] | Exception | str:
        """Ask for pictures; return them, or the error that came instead, or why it has ended."""
        asked, told = self._process.stdin, self._process.stdout
        assert asked is not None  # they are pipes
        assert told is not None
        pictures: list[Bytes] = []
        waiting = True
        # Also on Ctrl-C: nobody waits for the pictures any more.
        with cleaned(lambda: self._kill() if waiting else None):
            try:
                pickle.dump(requests, asked, protocol=5)
                asked.flush()
                while isinstance(answer := pickle.load(told), np.ndarray):
                    pictures.append(answer)
                    drawn(len(pictures))
            except (BrokenPipeError, EOFError):
                answer = self.end()
            waiting = False
        return pictures if answer is None else answer

    def _kill(self) -> None:
        self._process.kill()
        self.end()

    def end(self) -> str:
        """Let it end, and say why it did."""
        busy = RuntimeError  # a signal has come while this process writes or reads
        with suppress(BrokenPipeError, busy):
            self._process.stdin.close()  # type: ignore[union-attr]  # a pipe
        try:
            code = self._process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = self._process.wait()
        with suppress(busy):
            self._process.stdout.close()  # type: ignore[union-attr]
        with self._complaints:
            self._complaints.seek(0)
            # What is not there cannot be imported; VTK without a window dies by a signal.
            told = self._complaints.read().strip().split("\n")[-1]
        return told if code == 1 else "it crashed"


class _Mine:
    """The worker of one process, and whose turn it is to draw."""

    def __init__(self) -> None:
        self.turn = threading.Lock()
        self.renderer: _Renderer | None = None

    def renderers(self) -> Iterator[_Renderer]:
        """Yield the one that has drawn before, then new ones with all there is to try."""
        if self.renderer is not None:
            yield self.renderer
        # On Linux first a context without a display, then whatever VTK prefers.
        own = dict(os.environ)
        own.pop("MPLBACKEND", None)  # PyVista imports Matplotlib, and draws by VTK
        if sys.platform.startswith("linux") and "VTK_DEFAULT_OPENGL_WINDOW" not in own:
            yield _Renderer(own | {"VTK_DEFAULT_OPENGL_WINDOW": "vtkEGLRenderWindow"})
        yield _Renderer(own)


_by_process: dict[int, _Mine] = {}  # a fork must not share the worker of its parent


def _of_this_process() -> _Mine:
    return _by_process.setdefault(os.getpid(), _Mine())


@atexit.register
def end_drawing() -> None:
    """End the process that draws, if there is one; the next picture starts another."""
    mine = _of_this_process()
    if mine.renderer is not None:
        mine.renderer.end()
        mine.renderer = None
