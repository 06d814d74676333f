"""The process that draws: reads requests, answers with pictures, and may crash alone.

Run by path from `spectra_kit.show.render`, never imported. VTK ends the whole process where it
finds no OpenGL, and talks to stderr about every driver it tries; in a process of its own both are
contained. It needs NumPy and PyVista only. On stdin come lists of requests, pickled; on stdout goes
each picture, and after the last of a list None, or the error that came instead.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
import traceback
from collections.abc import Callable
from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

IDLE = 60.0  # seconds without a request, after which it ends
OVERSAMPLE = 2  # samples per pixel side: smooth edges whatever the driver can do
LINE = (48, 48, 54)
# Widths (and balls) that a line lies before the surface: not cut off where it turns away.
BEFORE = 1.5
# Degrees; edges that bend more are drawn sharp. A tight saddle of few triangles bends up to 70.
SHARP = 75.0
LIGHTS = (((-0.5, 0.75, 1.0), 0.52), ((0.9, 0.1, 0.8), 0.24))  # (direction, strength)

Request = dict[str, Any]


def main() -> None:
    """Answer until nobody asks any more, or not for a while."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for who waits, and ends this process
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what VTK may print is no answer

    def tell(answer: object) -> None:
        pickle.dump(answer, answers, protocol=5)
        answers.flush()

    while (requests := _asked()) is not None:
        try:
            for request in requests:
                draw(request, tell)
            tell(None)
        except Exception as error:  # noqa: BLE001  # whatever it is: it is told
            tell(_portable(error))


def _asked() -> list[Request] | None:
    """Return the next requests; None where there will be none."""
    idle = threading.Timer(IDLE, os._exit, [0])
    idle.daemon = True
    idle.start()
    try:
        requests: list[Request] = pickle.load(sys.stdin.buffer)
    except EOFError:
        return None
    finally:
        idle.cancel()
    return requests


def _portable(error: Exception) -> Exception:
    """The error with its traceback; of another package's, which may not unpickle, what it says."""
    if type(error).__module__ != "builtins":
        kind = MemoryError if isinstance(error, MemoryError) else RuntimeError
        error = kind(repr(error))
    error.add_note(f"It was raised in the process that draws:\n{traceback.format_exc()}")
    return error


def draw(request: Request, tell: Callable[[NDArray[np.uint8]], object]) -> None:
    """Draw every function of a request with one plotter, and tell each picture."""
    columns, rows = request["size"]
    plotter = pv.Plotter(
        off_screen=True, window_size=[columns * OVERSAMPLE, rows * OVERSAMPLE], lighting="none"
    )
    plotter.background_color = pv.Color("white")
    if len(request["swings"]) > 1:  # a film: VTK's own samples on top of these would take longest
        window: Any = plotter.render_window
        window.SetMultiSamples(0)
    for direction, strength in LIGHTS:
        plotter.add_light(  # in the coordinates of the camera
            pv.Light(position=direction, intensity=strength, light_type="camera light")
        )
    surfaces, owner = _surfaces(request)
    for surface in surfaces:
        surface["values"] = request["values"][0][owner]
    style: dict[str, Any] = {"rgb": True}
    if n := len(request["colours"]):
        shades = [f"#{r:02x}{g:02x}{b:02x}" for r, g, b in request["colours"]]
        style = {"cmap": shades, "n_colors": n, "clim": [-1.0, 1.0]}
    style |= {"ambient": 0.46, "diffuse": 0.85, "specular": 0.08, "specular_power": 30}
    style |= {"show_scalar_bar": False, "reset_camera": False}
    style["smooth_shading"] = not request["balls"]
    as_balls: dict[str, Any] = {"style": "points", "render_points_as_spheres": True}
    as_balls["point_size"] = request["diameter"] * OVERSAMPLE
    for surface in surfaces:
        form = {} if surface.n_faces_strict else as_balls
        plotter.add_mesh(surface, scalars="values", **style, **form)
    drawn = _add_lines(plotter, request)
    widths = request["line_widths"]
    lift = BEFORE * ((float(np.median(widths)) if len(widths) else 0.0) + request["diameter"])
    for side in request["sides"]:
        _place_camera(plotter, request["box"], request["half_height"], side)
        for lines in drawn.values():
            lines.position = (0.0, 0.0, side * lift)
        for i, values in enumerate(request["values"]):
            for j, lines in drawn.items():
                lines.visibility = j == i
            for swing in request["swings"]:
                moved = request["points"]
                if len(request["shifts"]):
                    moved = moved + swing * request["shifts"][i]
                for surface in surfaces:
                    surface["values"] = values[owner] if swing == 1 else (swing * values)[owner]
                    if len(request["shifts"]):
                        _move(surface, moved[owner])
                plotter.render()
                picture = plotter.screenshot(return_img=True)
                assert picture is not None  # it was asked for
                tell(_shrink(np.asarray(picture)))
    plotter.close()


def _surfaces(request: Request) -> tuple[list[pv.PolyData], NDArray[np.int64]]:
    """What to draw of the geometry, and which point each vertex was.

    A mesh with vertices doubled along sharp edges; or the balls of a cloud, and triangles.
    """
    points, faces, normals = (request[name] for name in ("points", "faces", "normals"))
    own = np.arange(len(points))
    if request["balls"]:
        between = [pv.PolyData.from_regular_faces(points, faces)] if len(faces) else []
        return [pv.PolyData(points), *between], own
    mesh = pv.PolyData.from_regular_faces(points, faces)
    if len(normals):
        mesh.point_data.active_normals = normals
        return [mesh], own
    mesh["owner"] = own
    mesh = mesh.compute_normals(
        cell_normals=False, split_vertices=True, feature_angle=SHARP, consistent_normals=False
    )
    return [mesh], np.asarray(mesh["owner"]).astype(np.int64)


def _add_lines(plotter: pv.Plotter, request: Request) -> dict[int, pv.Actor]:
    """The lines of each function that has any, as flat bands that face the viewer."""
    every, widths = (
        np.split(request[name], request["line_ends"])[:-1] for name in ("segments", "line_widths")
    )
    return {
        i: plotter.add_mesh(_bands(*lines), color=LINE, lighting=False, reset_camera=False)
        for i, lines in enumerate(zip(every, widths, strict=True))
        if len(lines[0])
    }


def _bands(segments: NDArray[np.float64], widths: NDArray[np.float64]) -> pv.PolyData:
    """Segments (s, 2, 3) as rectangles in the picture plane, a little longer to close the bends.

    Not where they run into the depth: at the outline they would stick out.
    """
    step = segments[:, 1] - segments[:, 0]
    seen = np.linalg.norm(step[:, :2], axis=1, keepdims=True)
    along = np.where(seen > 0, step[:, :2] / np.maximum(seen, 1e-12), [1.0, 0.0])
    along *= widths[:, None] / 2
    longer = along * 0.5 * seen / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-12)
    across = np.column_stack([-along[:, 1], along[:, 0]])
    start, stop = segments[:, 0].copy(), segments[:, 1].copy()
    start[:, :2] -= longer
    stop[:, :2] += longer
    aside = np.pad(across, ((0, 0), (0, 1)))
    corners = np.stack([start - aside, stop - aside, stop + aside, start + aside], axis=1)
    faces = np.arange(4 * len(segments)).reshape(-1, 4)
    return pv.PolyData(corners.reshape(-1, 3), np.insert(faces, 0, 4, axis=1).ravel())


def _move(surface: pv.PolyData, points: NDArray[np.float64]) -> None:
    """Put the vertices elsewhere, and light them by where their faces look to now."""
    surface.points = points
    if surface.n_faces_strict:
        moved = surface.compute_normals(
            cell_normals=False, split_vertices=False, consistent_normals=False
        )
        surface.point_data.active_normals = moved.point_data.active_normals


def _place_camera(
    plotter: pv.Plotter, box: NDArray[np.float64], half_height: float, side: int
) -> None:
    """Look along the z axis, down it for side 1; the picture is 2 * half_height high."""
    centre = (box[0] + box[1]) / 2
    reach = float(np.ptp(box, axis=0).max()) or 1.0
    camera = plotter.camera
    camera.focal_point = centre
    camera.position = centre + [0.0, 0.0, side * 4 * reach]
    camera.up = (0.0, 1.0, 0.0)
    camera.parallel_projection = True
    camera.parallel_scale = half_height
    camera.clipping_range = (2 * reach, 6 * reach)


def _shrink(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Average the samples of each pixel."""
    sums = sum(
        picture[i::OVERSAMPLE, j::OVERSAMPLE].astype(np.uint16)
        for i in range(OVERSAMPLE)
        for j in range(OVERSAMPLE)
    )
    return np.asarray((sums + OVERSAMPLE**2 // 2) // OVERSAMPLE**2, dtype=np.uint8)


if __name__ == "__main__":
    main()
