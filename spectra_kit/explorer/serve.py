"""The explorer as a local server: the scene lives in Python, the browser draws it, trame links them.

The scene is kept by PyVista and never rendered here, so the server needs no OpenGL.
"""

from __future__ import annotations

import importlib.util
import itertools
import os
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from spectra_kit._validate import check_count
from spectra_kit.errors import InvalidInputError, MissingDependencyError
from spectra_kit.explorer.display import for_display
from spectra_kit.geometry.shapes import Geometry, TriangleMesh
from spectra_kit.metrics import Comparison, align_modes, compare_spectra
from spectra_kit.spectrum import Spectrum
from spectra_kit.viz.camera import choose_view
from spectra_kit.viz.colours import diverging_colours
from spectra_kit.viz.pen import short

if TYPE_CHECKING:
    import pyvista as pv

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]

_HOST = "127.0.0.1"
_PERCENTILE = 99.0  # a lone spike must not bleach the rest
_FAINT = 1e-4  # differences below this part of the mode stay white
_BALL = 6.0  # pixels, of the points of a cloud
_LIGHT = {"ambient": 0.4, "diffuse": 0.65, "specular": 0.0}  # colours must stay what they are
_NAMES = itertools.count()  # trame keeps its servers by name
_STYLE = """
:root { color-scheme: light dark; --ink: #1b1f24; --paper: #ffffff; --faint: #6a737d; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e8eb; --paper: #14171a; --faint: #98a1ab; } }
html, body, #app { margin: 0; height: 100%; background: var(--paper); color: var(--ink);
  font: 15px/1.4 system-ui, sans-serif; }
.page { display: flex; flex-direction: column; height: 100vh; box-sizing: border-box;
  padding: 12px 18px; gap: 8px; }
.page h1 { font-size: 18px; font-weight: 600; margin: 0; }
.heads { display: flex; } .heads div { flex: 1; text-align: center; font-weight: 600; }
.scene { flex: 1; min-height: 0; border-radius: 6px; overflow: hidden; background: #ffffff; }
.bar { display: flex; align-items: center; gap: 14px; }
.bar input { flex: 1; accent-color: #0072b2; } .bar output { min-width: 8em; font-weight: 600; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; align-self: center; }
td { padding: 1px 14px; text-align: right; }
th, tr:first-child td { font-weight: 400; color: var(--faint); } th { text-align: left; }
"""


def serve(
    geometry: Geometry,
    exact: Spectrum,
    predicted: Spectrum | None = None,
    *,
    comparison: Comparison | None = None,
    names: tuple[str, str] = ("exact", "predicted"),
    title: str = "",
    max_points: int = 50_000,
    up: Literal["x", "y", "z"] | None = None,
    port: int = 0,
    open_browser: bool = True,
    ready: Callable[[str], None] | None = None,
) -> None:
    """Show modes in the browser of this machine, until Ctrl-C.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        The n points that the spectra live on.
    exact : Spectrum
        Shown alone, or beside `predicted` and their difference, seen by one camera.
    predicted : Spectrum, optional
        Another spectrum on the same points.
    comparison : Comparison, optional
        Of these two; by default ``compare_spectra(exact, predicted)``. Its k modes are shown.
    names : tuple of str, default ("exact", "predicted")
        What to call the two.
    title : str, optional
        At the head of the page.
    max_points : int, default 50000
        A geometry with more points is drawn with at most about as many.
    up : {"x", "y", "z"}, optional
        The axis that points up; by default as `viz` chooses it.
    port : int, default 0
        Where to listen, on 127.0.0.1 alone; 0 for any free port.
    open_browser : bool, default True
        Open the page in the browser.
    ready : callable, optional
        Called with the address once it can be opened.

    Raises
    ------
    InvalidInputError
        If sizes disagree or an option is out of range.
    MissingDependencyError
        If trame is not installed.
    """
    check_count("port", port, low=0, high=65535)
    check_count("max_points", max_points, low=4)
    if geometry.n != exact.n:
        raise InvalidInputError(
            f"`geometry` must have the {exact.n} points of the spectrum, got {geometry.n}"
        )
    missing = [name for name in ("trame", "trame_vtk") if importlib.util.find_spec(name) is None]
    if missing:
        raise MissingDependencyError(
            f"the local server needs {' and '.join(missing)}: pip install 'spectra_kit[serve]';"
            " a page that needs nothing is written by write_explorer"
        )
    if predicted is not None and comparison is None:
        comparison = compare_spectra(exact, predicted)
    modes = _Modes(exact, predicted, comparison, names)
    first = min(exact.n_zero_modes, modes.k - 1)
    scene = _Scene(geometry, modes.functions, max_points, up)
    _run(scene, modes, first, title, port, open_browser, ready)


class _Modes:
    """The functions to show, column by column, and what is known of each mode."""

    def __init__(
        self,
        exact: Spectrum,
        predicted: Spectrum | None,
        comparison: Comparison | None,
        names: tuple[str, str],
    ) -> None:
        self.exact, self.predicted, self.comparison = exact, predicted, comparison
        root = np.sqrt(exact.area)  # the constant mode is 1, and colours know no units
        self.k = exact.k if comparison is None else comparison.k
        self.heads, self.functions = [names[0]], [root * exact.eigenvectors[:, : self.k]]
        if predicted is not None:
            aligned = root * align_modes(exact, predicted, comparison)
            self.heads += [names[1], "difference"]
            self.functions += [aligned, aligned - self.functions[0]]

    def table(self, mode: int) -> list[list[str]]:
        """Rows of what is known of a mode: the name of a number, and one for each spectrum."""
        spectra = [(self.exact, mode)]
        if self.predicted is not None and self.comparison is not None:
            spectra.append((self.predicted, int(self.comparison.match[mode])))
        rows = [
            ["", *self.heads[:2]],
            ["eigenvalue", *(f"{s.eigenvalues[i]:.6g}" for s, i in spectra)],
            ["relative residual", *(_residual(s, i) for s, i in spectra)],
        ]
        if self.comparison is not None:
            rows.append(["error of the mode", "", short(self.comparison.vector_error[mode])])
            rows.append(["of its cluster", "", short(self.comparison.cluster_error[mode])])
            rows.append(["outside the span", "", short(self.comparison.span_error[mode])])
        return rows


def _residual(spectrum: Spectrum, mode: int) -> str:
    if spectrum.certificate is None:
        return "not certified"
    return short(spectrum.certificate.relative_residuals[mode])


class _Scene:
    """The geometry once for each function, side by side under one camera."""

    def __init__(
        self,
        geometry: Geometry,
        functions: list[Floats],
        max_points: int,
        up: Literal["x", "y", "z"] | None,
    ) -> None:
        import pyvista as pv

        display = for_display(geometry, max_points)
        self._functions = [np.asarray(display.carry @ f) for f in functions]
        with _without_display():
            self.plotter = pv.Plotter(
                off_screen=True, shape=(1, len(functions)), border=False, lighting="none"
            )
        self.plotter.set_background("white")
        self._surfaces = []
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
            self._surfaces.append(surface)
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
        camera.parallel_scale = 0.3 * np.ptp(seen, axis=0)[:2].max()

    def show(self, mode: int) -> None:
        """Colour the surfaces by a mode; all but the difference share their limit."""
        values = [f[:, mode] for f in self._functions]
        limits = [float(np.percentile(np.abs(v), _PERCENTILE)) for v in values]
        limit = max(limits[:2]) or 1.0
        for i, (surface, function) in enumerate(zip(self._surfaces, values, strict=True)):
            scale = max(limits[i], _FAINT * limit) if i == 2 else limit
            surface["colours"] = diverging_colours(function / scale)


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


def _surface(points: Floats, geometry: Geometry) -> pv.PolyData:
    import pyvista as pv

    if not isinstance(geometry, TriangleMesh):
        return pv.PolyData(points)
    surface = pv.PolyData.from_regular_faces(points, geometry.faces)
    return surface.compute_normals(cell_normals=False, split_vertices=False, consistent_normals=False)


def _run(
    scene: _Scene,
    modes: _Modes,
    first: int,
    title: str,
    port: int,
    open_browser: bool,
    ready: Callable[[str], None] | None,
) -> None:
    """Build the page and serve it until it is interrupted."""
    from trame.app import get_server
    from trame.ui.html import DivLayout
    from trame.widgets import client, html
    from trame.widgets import vtk as widgets

    server: Any = get_server(f"spectra_kit {next(_NAMES)}", client_type="vue3")
    host = server.cli.parse_known_args()[0].host  # trame would obey the command line, or TRAME_ARGS
    if host not in ("localhost", _HOST):
        raise InvalidInputError(f"the explorer is served to this machine alone, got --host {host}")
    state = server.state
    state.trame__title = title or "Spectrum explorer"
    state.heads, state.mode, state.last = modes.heads, first, modes.k - 1

    with DivLayout(server, classes="page"):
        client.Style(_STYLE)
        html.H1(title or "Spectrum explorer")
        with html.Div(classes="heads"):
            html.Div("{{ head }}", v_for="head in heads", key="head")
        with html.Div(classes="scene"):
            view = widgets.VtkLocalView(scene.plotter.render_window, style="height: 100%")
        with html.Div(classes="bar"):
            html.Label("mode", for_="mode")
            html.Input(
                id="mode",
                type="range",
                min=0,
                max=("last",),
                v_model_number=("mode",),
            )
            html.Output("{{ mode }} of {{ last }}")
        with html.Table(), html.Tbody(), html.Tr(v_for="(row, i) in table", key="i"):
            html.Th("{{ row[0] }}")
            html.Td("{{ cell }}", v_for="(cell, j) in row.slice(1)", key="j")

    @state.change("mode")  # type: ignore[untyped-decorator]
    def _show(mode: int, **_: Any) -> None:
        scene.show(int(mode))
        state.table = modes.table(int(mode))
        view.update()

    def _ready(**_: Any) -> None:
        url = f"http://{_HOST}:{server.port}/"
        if ready is not None:
            ready(url)
        if open_browser:
            webbrowser.open(url)

    server.controller.on_server_ready.add(_ready)
    try:
        server.start(
            port=port,
            host=_HOST,
            open_browser=False,
            show_connection_info=False,
            timeout=0,  # wait for ever
        )
    except KeyboardInterrupt:  # how one leaves
        return
