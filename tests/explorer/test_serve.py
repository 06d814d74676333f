"""The local server, in a real browser."""

import io
import json
import shutil
import signal
import socket
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from spectra_kit import AmbientFourier, RayleighRitz, eigensolve, robust_laplacian
from spectra_kit.errors import InvalidInputError, MissingDependencyError
from spectra_kit.explorer.scene import Modes, Scene
from spectra_kit.explorer.serve import serve
from spectra_kit.geometry import PointCloud, rectangle
from spectra_kit.metrics import compare_spectra

pytest.importorskip("trame_vtk", reason="trame is not installed: pip install 'spectra_kit[serve]'")

COMMAND = [
    *(sys.executable, "-m", "spectra_kit", "explore", "demo", "--points", "600", "-k", "8"),
    *("--solver", "fourier", "--serve", "--no-browser", "--json"),
]


@pytest.fixture(scope="module")
def sheet():
    mesh = rectangle(n=200).geometry
    laplacian = robust_laplacian(mesh)
    guess = eigensolve(laplacian, 6, RayleighRitz(subspace=AmbientFourier(m=60, bandwidth=4.0)))
    return mesh, eigensolve(laplacian, 6), guess


@pytest.fixture(scope="module")
def server():
    """A server in a process of its own, and what it said when it was ready; the last test ends it.

    To start it takes longer than to use it.
    """
    process = subprocess.Popen(COMMAND, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        lines = iter(process.stdout.readline, "")
        text = ""
        for line in lines:
            text += line
            if line == "}\n":
                break
        assert text, process.stderr.read()
        yield process, json.loads(text)
    finally:
        process.kill()
        process.communicate()


@pytest.fixture
def page():
    """A page in a headless browser that keeps what it complains of and whom it asks."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if not (chromium := shutil.which("chromium")):
        pytest.skip("there is no chromium on this machine")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=chromium,
            args=["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
        )
        page = browser.new_page(viewport={"width": 900, "height": 560})
        page.complaints, page.asked = [], set()
        page.on("pageerror", lambda error: page.complaints.append(str(error)))
        page.on(
            "console",
            lambda m: m.type in ("error", "warning") and page.complaints.append(m.text),
        )
        page.on("request", lambda request: page.asked.add(request.url))
        yield page
        browser.close()


def picture(page):
    """The three panels, as arrays (height, width, 3)."""
    png = page.locator(".scene").screenshot()
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)
    return np.array_split(pixels, 3, axis=1)


def shares(panel):
    """Shares of the pixels that are clearly red, and clearly blue."""
    red, _, blue = np.moveaxis(panel, 2, 0)
    return (red - blue > 60).mean(), (blue - red > 60).mean()


def settled(page, before):
    """Wait until the picture is another than before and no longer changes."""
    last = before
    for _ in range(100):
        page.wait_for_timeout(100)
        now = picture(page)
        changed = before is None or any((a != b).any() for a, b in zip(now, before, strict=True))
        resting = last is not None and all(map(np.array_equal, now, last))
        if changed and resting and min(shares(now[0])) > 0:
            return now
        last = now
    raise AssertionError("the picture did not come, or did not come to rest")


def test_a_browser_shows_the_modes_and_the_slider_changes_them(server, page):
    _, told = server
    page.goto(told["url"])
    page.wait_for_selector(".scene canvas")
    first = settled(page, None)
    for panel in first[:2]:  # the first mode has two signs, exact and predicted
        assert min(shares(panel)) > 0.01
    np.testing.assert_allclose(shares(first[0]), shares(first[1]), rtol=0.1)
    assert page.locator(".heads div").all_inner_texts() == [
        "exact (arpack)",
        "predicted (fourier)",
        "difference",
    ]

    slider = page.locator("#mode")
    assert (slider.get_attribute("min"), slider.get_attribute("max")) == ("0", "7")
    slider.focus()
    page.keyboard.press("ArrowRight")
    second = settled(page, first)
    assert page.locator("output").inner_text() == "2 of 7"
    row = page.locator("tr", has_text="eigenvalue").locator("td").all_inner_texts()
    values = [told[name]["eigenvalues"][2] for name in ("reference", "predicted")]
    np.testing.assert_allclose([float(cell) for cell in row], values, rtol=1e-5)

    box = page.locator(".scene").bounding_box()  # turn the first: the others turn with it
    page.mouse.move(box["x"] + box["width"] / 6, box["y"] + box["height"] / 2)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] / 6 + 60, box["y"] + box["height"] / 2 + 20, steps=4)
    page.mouse.up()
    turned = settled(page, second)
    outlines = [(panel < 250).any(axis=2) for panel in turned]
    assert (outlines[0] != (second[0] < 250).any(axis=2)).mean() > 0.02
    width = min(outline.shape[1] for outline in outlines)
    assert (outlines[0][:, :width] != outlines[1][:, :width]).mean() < 0.02

    page.keyboard.press("ArrowRight")  # another mode, seen from where the visitor stands
    third = settled(page, turned)
    assert ((third[0] < 250).any(axis=2) != outlines[0]).mean() < 0.02

    assert page.complaints == []
    assert {url.split("/")[2] for url in page.asked if url.startswith(("http", "ws"))} == {
        told["url"].split("/")[2]
    }


def status(port, request, **headers):
    """The status line and the body that come back over a socket."""
    lines = [f"{request} HTTP/1.1", *(f"{name}: {value}" for name, value in headers.items())]
    with socket.create_connection(("127.0.0.1", port), timeout=5) as connection:
        connection.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
        answer = connection.recv(65536).decode(errors="replace")
    return int(answer.split()[1]), answer


HANDSHAKE = {
    "Connection": "Upgrade",
    "Upgrade": "websocket",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
}


def test_pages_from_elsewhere_get_nothing(server):
    _, told = server
    port = int(told["url"].rsplit(":", 1)[1].strip("/"))
    here = f"127.0.0.1:{port}"
    ask = {"Content-Length": 0}
    for host in (here, f"localhost:{port}", f"LOCALHOST:{port}"):
        code, answer = status(port, "POST /paraview/", Host=host, Origin=f"http://{host}", **ask)
        assert (code, "secret" in answer) == (200, True)
    assert status(port, "GET /ws", Host=here, Origin=f"http://{here}", **HANDSHAKE)[0] == 101
    # A name of elsewhere that leads to this machine, another port, and no name at all.
    for host in ("evil.example", f"evil.example:{port}", "127.0.0.1", f"127.0.0.1:{port - 1}", ""):
        for request in ("POST /paraview/", "GET /", "GET /index.html", "GET /no.such"):
            code, answer = status(port, request, Host=host, **ask)
            assert (code, "secret" in answer) == (403, False)
        assert status(port, "GET /ws", Host=host, Origin=f"http://{host}", **HANDSHAKE)[0] == 403
    # A page of elsewhere that asks this machine by its name.
    for origin in (
        "http://evil.example",
        f"https://{here}",
        f"http://127.0.0.1:{port - 1}",
        "null",
    ):
        code, answer = status(port, "POST /paraview/", Host=here, Origin=origin, **ask)
        assert (code, "secret" in answer) == (403, False)
        assert status(port, "GET /ws", Host=here, Origin=origin, **HANDSHAKE)[0] == 403


def test_it_listens_to_this_machine_alone_and_ends_by_ctrl_c(server):
    process, told = server
    port = int(told["url"].rsplit(":", 1)[1].strip("/"))
    socket.create_connection(("127.0.0.1", port), timeout=5).close()
    if sys.platform.startswith("linux"):  # where all of 127/8 is this machine
        with pytest.raises(OSError, match="refused"):
            socket.create_connection(("127.0.0.2", port), timeout=5)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=20)
    assert (process.returncode, err) == (0, "")
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(("127.0.0.1", port), timeout=5)


def test_colours_and_numbers_of_a_mode(sheet):
    mesh, exact, guess = sheet
    modes = Modes(exact, guess, compare_spectra(exact, guess), ("exact", "guess"))
    np.testing.assert_allclose(modes.functions[0] + modes.functions[2], modes.functions[1])
    scene = Scene(mesh, modes.functions, 50_000, None)
    limits = scene.show(1)
    left, right, _ = (np.asarray(surface["colours"]).astype(int) for surface in scene.surfaces)
    for function, colours in zip(modes.functions, (left, right), strict=False):
        high, low = np.argmax(function[:, 1]), np.argmin(function[:, 1])
        assert colours[high, 0] - colours[high, 2] > 90  # red where it is highest
        assert colours[low, 2] - colours[low, 0] > 90
        zero = np.argmin(np.abs(function[:, 1]))
        assert colours[zero].min() > 225
    assert 1.4 < limits[0] == limits[1] < 2  # a cosine reaches the root of two, the guess more
    table = modes.table(1, limits)
    assert table[0] == ["", "exact", "guess", "difference"]
    assert float(table[1][1]) == pytest.approx(exact.eigenvalues[1], rel=1e-5)
    assert [row[0] for row in table[2:]] == [
        "relative residual", "error of the mode", "error of its cluster", "outside the span",
        "colours end at ±",
    ]  # fmt: skip
    alone = Modes(exact, None, None, ("exact", ""))
    assert len(Scene(mesh.as_cloud(), alone.functions, 50_000, None).show(2)) == 1
    assert len(alone.table(2, [1.0])) == 4


def test_the_view_holds_all_of_the_geometry(sheet):
    mesh, exact, _ = sheet
    scene = Scene(mesh, [exact.eigenvectors], 50_000, None)
    camera = scene.camera()
    up = np.array(camera["viewUp"])
    towards = np.array(camera["position"]) - np.array(camera["focalPoint"])
    assert up @ towards == pytest.approx(0, abs=1e-9)
    heights = (scene.surfaces[0].points - camera["focalPoint"]) @ up
    assert np.abs(heights).max() < camera["parallelScale"]


def test_what_cannot_be_served_is_refused(sheet, monkeypatch):
    mesh, exact, _ = sheet
    with pytest.raises(InvalidInputError, match=r"`port` must be in \[0, 65535\], got 70000"):
        serve(mesh, exact, port=70000)
    with pytest.raises(InvalidInputError, match="must have the 198 points of the spectrum, got 10"):
        serve(PointCloud(mesh.points[:10]), exact)
    with monkeypatch.context() as patched:
        patched.setenv("TRAME_ARGS", "--host 0.0.0.0")
        with pytest.raises(InvalidInputError, match=r"alone, got --host 0\.0\.0\.0; leave it out"):
            serve(mesh, exact)
    monkeypatch.setitem(sys.modules, "trame_vtk", None)  # as if it were not installed
    with pytest.raises(MissingDependencyError, match=r"trame_vtk: pip install 'spectra_kit\[serve"):
        serve(mesh, exact)
