"""What the local server shows: functions on copies of one geometry under one camera, and numbers.

The scene is kept by PyVista and never rendered here, so the server needs no OpenGL.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal

import numpy as np

from spectra_kit._types import Floats
from spectra_kit.explorer.display import for_display, functions_of
from spectra_kit.geometry.shapes import Geometry, TriangleMesh
from spectra_kit.metrics import Comparison
from spectra_kit.spectra import Spectrum
from spectra_kit.viz.camera import choose_view
from spectra_kit.viz.colours import diverging_colours
from spectra_kit.viz.pen import short

_PERCENTILE = 99.0  # a lone spike must not bleach the rest
_FAINT = 1e-4  # differences below this part of the mode stay white
_ASPECT = 0.85  # width of a panel by its height, or more
_BALL = 6.0  # pixels, of the points of a cloud
# Colours must stay what they are.
_LIGHT: dict[str, Any] = {"ambient": 0.4, "diffuse": 0.65, "specular": 0.0}


class Modes:
    """The functions to show, column by column, and what is known of each mode."""

    def __init__(
        self,
        exact: Spectrum,
        predicted: Spectrum | None,
        comparison: Comparison | None,
        names: tuple[str, str],
    ) -> None:
        self.exact, self.predicted, self.comparison = exact, predicted, comparison
        self.heads, self.functions = [names[0]], functions_of(exact, predicted, comparison)
        self.k = self.functions[0].shape[1]
        if predicted is not None:
            self.heads += [names[1], "difference"]
            self.functions.append(self.functions[1] - self.functions[0])

    def table(self, mode: int, limits: list[float]) -> list[list[str]]:
        """Rows of what is known of a mode: the name of a number, and one for each column."""
        spectra = [(self.exact, mode)]
        if self.predicted is not None and self.comparison is not None:
            spectra.append((self.predicted, int(self.comparison.match[mode])))
        rows = [
            ["", *self.heads],
            ["eigenvalue", *(f"{s.eigenvalues[i]:.6g}" for s, i in spectra)],
            ["relative residual", *(_residual(s, i) for s, i in spectra)],
        ]
        if (errors := self.comparison) is not None:
            rows.append(["error of the mode", "", short(errors.vector_error[mode])])
            rows.append(["error of its cluster", "", short(errors.cluster_error[mode])])
            rows.append(["outside the span", "", short(errors.span_error[mode])])
        return [*rows, ["colours end at \N{PLUS-MINUS SIGN}", *(short(limit) for limit in limits)]]


def _residual(spectrum: Spectrum, mode: int) -> str:
    if spectrum.certificate is None:
        return "not certified"
    return short(spectrum.certificate.relative_residuals[mode])


class Scene:
    """The geometry once for each function, side by side under one camera."""

    def __init__(
        self,
        geometry: Geometry,
        functions: list[Floats],
        max_points: int,
        up: Literal["x", "y", "z"] | None,
    ) -> None:
        pv: Any = importlib.import_module("pyvista")

        display = for_display(geometry, max_points)
        self._functions = [np.asarray(display.carry @ f) for f in functions]
        with _without_display():
            self.plotter: Any = pv.Plotter(
                off_screen=True, shape=(1, len(functions)), border=False, lighting="none"
            )
        self.plotter.set_background("white")
        self.surfaces = []
        points = display.geometry.points - display.geometry.points.mean(axis=0)
        points = points / (np.ptp(points, axis=0).max() or 1.0)
        for column in range(len(functions)):
            self.plotter.subplot(0, column)
            surface = _surface(points, display.geometry)
            surface["colours"] = np.full((surface.n_points, 3), 255, dtype=np.uint8)
            actor = self.plotter.add_mesh(
                surface,
                scalars="colours",
                rgb=True,
                point_size=_BALL,
                lighting=isinstance(geometry, TriangleMesh),
                **_LIGHT,
            )
            actor.prop.interpolation = "Phong"  # PyVista's smooth shading would draw a copy
            self.surfaces.append(surface)
        self._look(choose_view(geometry, up=up), points)
        self.plotter.link_views()

    def _look(self, rotation: Floats, points: Floats) -> None:
        self.plotter.subplot(0, 0)
        _, upwards, towards = rotation
        seen = points @ rotation.T
        middle = rotation.T @ ((seen.min(axis=0) + seen.max(axis=0)) / 2)
        camera = self.plotter.camera
        camera.focal_point, camera.position = middle, middle + 3 * towards
        camera.up = upwards
        camera.parallel_projection = True
        across, upright, _ = np.ptp(seen, axis=0) / 2
        camera.parallel_scale = 1.08 * max(across / _ASPECT, upright)

    def camera(self) -> dict[str, Any]:
        """Return the first view, as the browser takes it."""
        camera = self.plotter.camera
        return {
            "position": camera.position,
            "focalPoint": camera.focal_point,
            "viewUp": camera.up,
            "parallelProjection": 1,
            "parallelScale": camera.parallel_scale,
        }

    def show(self, mode: int) -> list[float]:
        """Colour the surfaces by a mode; return the value at which the colours of each end."""
        values = [f[:, mode] for f in self._functions]
        own = [float(np.percentile(np.abs(v), _PERCENTILE)) for v in values]
        shared = max(own[:2]) or 1.0
        limits = [shared, shared, max(own[-1], _FAINT * shared)][: len(values)]
        for surface, function, limit in zip(self.surfaces, values, limits, strict=True):
            surface["colours"] = diverging_colours(function / limit)
        return limits


@contextmanager
def _without_display() -> Iterator[None]:
    """Keep VTK from looking for an X server, of which it would complain: nothing is drawn here."""
    name = "VTK_DEFAULT_OPENGL_WINDOW"
    before = os.environ.get(name)
    os.environ[name] = before or "vtkEGLRenderWindow"
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]


def _surface(points: Floats, geometry: Geometry) -> Any:
    pv: Any = importlib.import_module("pyvista")

    if not isinstance(geometry, TriangleMesh):
        return pv.PolyData(points)
    surface: Any = pv.PolyData.from_regular_faces(points, geometry.faces)
    return surface.compute_normals(
        cell_normals=False, split_vertices=False, consistent_normals=False
    )
