"""The explorer as a local server: Python keeps the scene, the browser draws it."""

from __future__ import annotations

import importlib.util
import itertools
import secrets
import webbrowser
from collections.abc import Callable
from typing import Any, Literal

from spectra_kit._validate import check_count
from spectra_kit.errors import InvalidInputError, MissingDependencyError
from spectra_kit.explorer.scene import Modes, Scene
from spectra_kit.geometry.shapes import Geometry
from spectra_kit.metrics import Comparison, compare_spectra
from spectra_kit.spectra import Spectrum

_HOST = "127.0.0.1"
_NAMES = itertools.count()  # trame keeps its servers by name
_STYLE = """
:root { color-scheme: light dark; --ink: #1b1f24; --paper: #ffffff; --faint: #6a737d; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e6e8eb; --paper: #14171a; --faint: #98a1ab; } }
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
    modes = Modes(exact, predicted, comparison, names)
    first = min(exact.n_zero_modes, modes.k - 1)
    scene = Scene(geometry, modes.functions, max_points, up)
    _run(scene, modes, first, title, port, open_browser, ready)


def _only_this_server() -> Any:
    """Return a middleware of aiohttp that answers to nothing but pages of this server.

    A page from elsewhere may have its name resolved to this machine, and then counts as one of
    this server to the browser: but its requests name it. To a websocket any page may connect.
    """
    from aiohttp import web

    @web.middleware
    async def check(request: web.Request, handler: Any) -> Any:
        assert request.transport is not None
        port = request.transport.get_extra_info("sockname")[1]
        hosts = {f"{name}:{port}" for name in (_HOST, "localhost")}
        if port == 80:  # which browsers leave out
            hosts |= {_HOST, "localhost"}
        host, origin = request.headers.get("Host", ""), request.headers.get("Origin")
        if host.lower() not in hosts:
            raise web.HTTPForbidden(text=f"open http://{_HOST}:{port}/, got host {host!r}")
        if origin is not None and origin.lower() not in {f"http://{name}" for name in hosts}:
            raise web.HTTPForbidden(text=f"only pages of this server connect, got {origin!r}")
        return await handler(request)

    return check


def _run(
    scene: Scene,
    modes: Modes,
    first: int,
    title: str,
    port: int,
    open_browser: bool,
    ready: Callable[[str], None] | None,
) -> None:
    """Build the page and serve it until it is interrupted."""
    from aiohttp import web
    from trame.app import get_server
    from trame.ui.html import DivLayout
    from trame.widgets import client, html
    from trame.widgets import vtk as widgets

    server: Any = get_server(f"spectra_kit {next(_NAMES)}", client_type="vue3")
    server.cli.set_defaults(authKey=secrets.token_hex(16))
    options = server.cli.parse_known_args()[0]  # trame obeys the command line, and TRAME_ARGS
    if options.host not in ("localhost", _HOST):
        raise InvalidInputError(
            f"the explorer is served to this machine alone, got --host {options.host}; leave it out"
        )
    state = server.state
    state.trame__title = title or "Spectrum explorer"
    state.heads, state.mode, state.last = modes.heads, first, modes.k - 1

    with DivLayout(server, classes="page"):
        client.Style(_STYLE)
        html.H1(title or "Spectrum explorer")
        with html.Div(classes="heads"):
            html.Div("{{ head }}", v_for="head in heads", key="head")
        with html.Div(classes="scene"):
            view = widgets.VtkLocalView(
                scene.plotter.render_window,
                ref="scene",
                style="height: 100%",
                on_ready=lambda **_: _look_once(),
            )
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
        state.table = modes.table(int(mode), scene.show(int(mode)))
        view.update()

    def _ready(**_: Any) -> None:
        url = f"http://{_HOST}:{server.port}/"
        if ready is not None:
            ready(url)
        if open_browser:
            webbrowser.open(url)

    fresh = set[str]()  # "view" while a page has not been given its first view

    def _look_once() -> None:
        # The browser fits a ball around the geometry, which leaves much room; later views are the
        # visitor's own.
        if fresh:
            fresh.clear()
            server.js_call("scene", "setCamera", scene.camera())

    def _bind(wslink: Any) -> None:
        wslink.app.middlewares.append(_only_this_server())

        # The page asks for the way to its data.
        async def answer(_: web.Request) -> web.Response:
            return web.json_response({"sessionURL": "ws://USE_HOST/ws", "secret": options.authKey})

        wslink.app.router.add_post("/paraview/", answer)

    server.controller.on_client_connected.add(lambda **_: fresh.add("view"))
    server.controller.on_server_bind.add(_bind)
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
