"""The process that draws: reads requests, writes the pictures, and may crash alone.

Run by path from `spectra_kit.viz.drawer`, never imported. VTK ends the whole process where it finds
no OpenGL, and talks to stderr about every driver it tries; in a process of its own both are
contained. It needs NumPy and PyVista only. On stdin come lines, ``[folder, count]``; on stdout a
line for each picture, and "done" or "error" after the last.
"""

from __future__ import annotations

import json
import os
import pickle
import signal
import sys
import threading
import traceback
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

IDLE = 60.0  # seconds without a request, after which it ends
OVERSAMPLE = 2  # samples per pixel side: smooth edges whatever the driver can do
LINE = (48, 48, 54)
BEFORE = (
    1.5  # widths (and balls) that a line lies before the surface: not cut off where it turns away
)
# Degrees; edges that bend more are drawn sharp. A tight saddle of few triangles bends up to 70.
SHARP = 75.0
LIGHTS = (((-0.5, 0.75, 1.0), 0.52), ((0.9, 0.1, 0.8), 0.24))  # (direction, strength)


def main() -> None:
    """Answer until nobody asks any more, or not for a while."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for who waits, and ends this process
    while line := _asked():
        folder, count = json.loads(line)
        _tell(_answer(Path(folder), count))


def _asked() -> str:
    """Return the next line; nothing where there will be none."""
    idle = threading.Timer(IDLE, os._exit, [0])
    idle.daemon = True
    idle.start()
    line = sys.stdin.readline()
    idle.cancel()
    return line


def _answer(folder: Path, count: int) -> str:
    """Draw every request in the folder; leave an error of Python's there for who waits."""
    try:
        for i in range(count):
            with np.load(folder / f"request{i}.npz") as file:
                request = {name: file[name] for name in file.files}
            np.save(folder / f"pictures{i}.npy", draw(request))
    except Exception as error:  # noqa: BLE001  # whatever it is: it is told
        traceback.print_exc()
        (folder / "error.pickle").write_bytes(_portable(error))
        return "error"
    return "done"


def _tell(word: str) -> None:
    sys.stdout.write(f"{word}\n")
    sys.stdout.flush()


def _portable(error: Exception) -> bytes:
    """Pickle an error, or what it says of itself where it cannot be unpickled."""
    try:
        pickle.loads(told := pickle.dumps(error))
    except Exception:  # noqa: BLE001  # whatever it is, it must not hide the one that is told
        told = pickle.dumps(RuntimeError(repr(error)))
    return told


def draw(request: dict[str, NDArray[Any]]) -> NDArray[np.uint8]:
    """Draw every function of a request with one plotter."""
    columns, rows = (int(side) for side in request["size"])
    plotter = pv.Plotter(
        off_screen=True, window_size=[columns * OVERSAMPLE, rows * OVERSAMPLE], lighting="none"
    )
    plotter.background_color = pv.Color("white")
    for direction, strength in LIGHTS:
        plotter.add_light(  # in the coordinates of the camera
            pv.Light(position=direction, intensity=strength, light_type="camera light")
        )
    surfaces, owner = _surfaces(request)
    for surface in surfaces:
        surface["values"] = request["values"][0][owner]
    style: dict[str, Any] = {}
    if len(request["colours"]):
        style |= {
            "cmap": [f"#{r:02x}{g:02x}{b:02x}" for r, g, b in request["colours"]],
            "n_colors": len(request["colours"]),
            "clim": [-1.0, 1.0],
        }
    else:
        style["rgb"] = True
    as_balls: dict[str, Any] = {
        "style": "points",
        "render_points_as_spheres": True,
        "point_size": float(request["diameter"]) * OVERSAMPLE,
    }
    for surface in surfaces:
        plotter.add_mesh(
            surface,
            scalars="values",
            show_scalar_bar=False,
            ambient=0.46,
            diffuse=0.85,
            specular=0.08,
            specular_power=30,
            reset_camera=False,
            smooth_shading=not request["balls"],
            **style,
            **({} if surface.n_faces_strict else as_balls),
        )
    drawn = _add_lines(plotter, request)
    lift = BEFORE * (float(request["line_width"]) + float(request["diameter"]))
    pictures = []
    for side in request["sides"]:
        _place_camera(plotter, request["box"], float(request["half_height"]), int(side))
        for lines in drawn.values():
            lines.position = (0.0, 0.0, int(side) * lift)
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
                pictures.append(_shrink(np.asarray(picture)))
                _tell("picture")  # who waits counts them
    plotter.close()
    return np.stack(pictures)


def _surfaces(request: dict[str, NDArray[Any]]) -> tuple[list[pv.PolyData], NDArray[np.int64]]:
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
        cell_normals=False,
        split_vertices=True,
        feature_angle=SHARP,
        consistent_normals=False,
    )
    return [mesh], np.asarray(mesh["owner"]).astype(np.int64)


def _add_lines(plotter: pv.Plotter, request: dict[str, NDArray[Any]]) -> dict[int, pv.Actor]:
    """The lines of each function that has any, as flat bands that face the viewer."""
    every = np.split(request["segments"], request["line_ends"])[:-1]
    width = float(request["line_width"])
    return {
        i: plotter.add_mesh(_bands(lines, width), color=LINE, lighting=False, reset_camera=False)
        for i, lines in enumerate(every)
        if len(lines)
    }


def _bands(segments: NDArray[np.float64], width: float) -> pv.PolyData:
    """Segments (s, 2, 3) as rectangles in the picture plane, a little longer to close the bends.

    Not where they run into the depth: at the outline they would stick out.
    """
    step = segments[:, 1] - segments[:, 0]
    seen = np.linalg.norm(step[:, :2], axis=1, keepdims=True)
    along = np.where(seen > 0, step[:, :2] / np.maximum(seen, 1e-12), [1.0, 0.0]) * width / 2
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
    rows, columns = (side // OVERSAMPLE for side in picture.shape[:2])
    blocks = picture.reshape(rows, OVERSAMPLE, columns, OVERSAMPLE, 3).astype(np.float32)
    mean: NDArray[np.float32] = blocks.mean(axis=(1, 3))
    return np.round(mean).astype(np.uint8)


if __name__ == "__main__":
    main()
