"""The explorer's page in a real browser: what it shows, what it reacts to, and its silence."""

import io
import json
import re
import shutil

import numpy as np
import pytest
from PIL import Image

from spectra_kit import Spectrum
from spectra_kit.eigen import Certificate
from spectra_kit.geometry import sphere
from spectra_kit.show import View
from spectra_kit.show.explorer import write_explorer

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium is installed")

FLAGS = [
    *("--headless=new", "--no-sandbox", "--disable-background-networking", "--disable-sync"),
    *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--disable-component-update", "--no-first-run"),
]
NAMES = ("exact <b>", "guess & “co”")


@pytest.fixture(scope="module")
def ball():
    return sphere(subdivisions=4).geometry  # 2562 points


def spectrum(ball, *functions, certified=True):
    """Functions as if they were modes, 0, 1, 2, … their eigenvalues."""
    vectors, _ = np.linalg.qr(np.column_stack(functions))
    signs = np.sign(np.sum(vectors * np.column_stack(functions), axis=0))
    k = len(functions)
    certificate = Certificate(
        residuals=np.full(k, 0.1),
        relative_residuals=np.full(k, 0.1),
        orthonormality_error=0.0,
        n_zero_modes=1,
        kernel_dimension=1,
        n_components=1,
    )
    mass = np.ones(ball.n)
    return Spectrum(np.arange(float(k)), vectors * signs, mass, certificate if certified else None)


@pytest.fixture(scope="module")
def pages(ball, tmp_path_factory):
    """A comparison whose mode 1 is the height in both, and whose mode 2 differs; and a cloud."""
    folder = tmp_path_factory.mktemp("pages")
    x, y, z = ball.points.T
    one = np.ones(ball.n)
    height = z + 0.02 * z**2  # a little more above: its larger end is shown in red
    exact = spectrum(ball, one, height, x, y, x * y)
    guess = spectrum(ball, one, height, x + 0.3 * y * z, y, x * y, certified=False)
    style = {"names": NAMES, "title": "<i>Ball</i> & more", "view": View("z")}
    write_explorer(folder / "pair.html", ball, exact, guess, **style)
    write_explorer(folder / "cloud.html", ball.as_cloud(), exact, view=View("z"), max_points=1500)
    fine = sphere(subdivisions=5).geometry
    write_explorer(folder / "many.html", fine, spectrum(fine, fine.points[:, 2]))
    return folder


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as tools:
        chromium = tools.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield chromium
        chromium.close()


class Visit:
    """An open page, and everything that it said and asked for."""

    def __init__(self, browser, path, *, width=920, height=640, **options):
        context = browser.new_context(viewport={"width": width, "height": height}, **options)
        self.page = context.new_page()
        self.said, self.asked = [], []
        self.page.on("console", lambda message: self.said.append(message.text))
        self.page.on("pageerror", lambda error: self.said.append(str(error)))
        context.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(path.as_uri())
        self.ready = "body.ready, body.failed"
        self.page.wait_for_selector(self.ready)
        self.settle()

    def settle(self):
        """Wait until what was asked for is drawn, and nothing glides any more."""
        self.page.evaluate("""async () => {
            const pause = (time) => new Promise((done) => setTimeout(done, time));
            const busy = () => !explorer.stage.fine || explorer.stage.asked !== undefined;
            do await pause(30); while (busy());
        }""")

    def mode(self):
        return self.page.eval_on_selector("#slider", "slider => slider.valueAsNumber")

    def text(self, selector):
        return self.page.inner_text(selector)

    def view(self, name):
        """Pixels of a view below its caption, (rows, columns, 3)."""
        box = self.page.locator(f"#view-{name} .pane").bounding_box()
        shot = self.page.screenshot(clip=box)
        return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB")).astype(int)

    def assert_silent(self):
        """It must not ask for anything but itself, nor complain."""
        assert all(url.startswith(("file://", "data:")) for url in self.asked), self.asked
        assert self.said == []


@pytest.fixture(scope="module")
def pair(browser, pages):
    """One visit for most tests: a page takes a second to open."""
    visit = Visit(browser, pages / "pair.html", color_scheme="light")
    yield visit
    visit.page.context.close()


@pytest.fixture
def visit(pair):
    """The page as it was opened, on mode 1, seen from the side."""
    for button, state in {"difference": "true", "wave": "false", "theme": "false"}.items():
        if pair.page.get_attribute(f"#{button}", "aria-pressed") != state:
            pair.page.click(f"#{button}")
    pair.page.evaluate("explorer.choose(1); explorer.stage.look([1, 0, 0]); scrollTo(0, 0)")
    pair.settle()
    yield pair
    pair.assert_silent()


def at(pixels, across, down):
    """Mean colour around a place given in shares of the width and height."""
    rows, columns, _ = pixels.shape
    row, column = int(down * rows), int(across * columns)
    return pixels[row - 3 : row + 4, column - 3 : column + 4].mean(axis=(0, 1))


def is_red(colour):
    return colour[0] > colour[2] + 40


def is_blue(colour):
    return colour[2] > colour[0] + 40


def is_grey(colour):
    return np.ptp(colour) < 14


def test_the_height_of_a_ball_is_red_above_and_blue_below(visit):
    exact, guess, difference = (visit.view(name) for name in ("exact", "predicted", "difference"))
    assert is_red(at(exact, 0.5, 0.15))
    assert is_blue(at(exact, 0.5, 0.85))
    assert np.abs(exact - guess).mean() < 1  # edges may fall between pixels
    # Nothing to see in the difference, and the page says so; the ball itself is there.
    assert all(is_grey(at(difference, 0.5, down)) for down in (0.2, 0.5, 0.8))
    assert at(difference, 0.5, 0.75).mean() < at(difference, 0.03, 0.03).mean() - 15
    assert "below what this page can show" in visit.text("#view-difference")


def test_nodal_lines_are_dark_where_the_function_vanishes(visit):
    def darkest():
        pixels = visit.view("exact")
        rows, columns, _ = pixels.shape
        return pixels[rows // 3 : -rows // 3, columns // 2].mean(axis=1).min()

    lit = darkest()
    visit.page.click("#nodal")
    visit.settle()
    assert lit < darkest() - 60
    visit.page.evaluate("explorer.choose(0)")
    visit.settle()
    without = visit.view("exact")
    visit.page.click("#nodal")
    visit.settle()
    assert np.abs(visit.view("exact") - without).max() <= 2  # the constant mode has none


def test_everything_follows_the_slider(visit):
    before = visit.view("exact")
    visit.page.focus("#slider")
    visit.page.keyboard.press("ArrowRight")
    visit.settle()
    assert visit.mode() == 2
    assert np.abs(visit.view("exact") - before).max() > 60
    assert visit.text("#view-exact .first") == "λ = 2.0000"
    assert visit.page.input_value("#number") == "2"
    assert visit.page.get_attribute("#table tr[aria-current]", "data-mode") == "2"
    assert "mode 2" in visit.page.get_attribute("#slider", "aria-valuetext")
    # Where the two differ: y z, so there is colour in the difference now.
    assert np.ptp(visit.view("difference").reshape(-1, 3), axis=1).max() > 60
    visit.page.keyboard.press("End")
    assert visit.mode() == 4
    assert visit.page.is_disabled("#next")
    visit.page.keyboard.press("Home")
    assert visit.mode() == 0
    visit.page.evaluate("document.activeElement.blur()")
    visit.page.keyboard.press("ArrowRight")  # anywhere on the page
    assert visit.mode() == 1
    visit.page.fill("#number", "3")
    assert visit.mode() == 3
    visit.page.eval_on_selector(
        "#slider", "s => { s.value = 2; s.dispatchEvent(new Event('input')); }"
    )
    assert visit.text("#view-exact .first") == "λ = 2.0000"


def test_a_click_on_the_plot_or_the_table_chooses_the_mode(visit):
    dot = visit.page.locator("#plot .dots.exact circle").nth(3).bounding_box()
    visit.page.mouse.move(dot["x"] + 2, dot["y"] + 2)
    assert re.match(r"mode 3\s", visit.text("#plot .tip"))
    visit.page.mouse.click(dot["x"] + 2, dot["y"] + 2)
    assert visit.mode() == 3
    row = visit.page.locator("#table tbody tr").nth(2)
    assert row.inner_text().split("\t")[:4] == ["2", "2.0000", "2.0000", "equal"]
    row.click()
    assert visit.mode() == 2
    # Errors of rounding alone are 0 for a reader, as differences of eigenvalues are equal.
    facts = json.loads(visit.page.text_content("#facts"))["comparison"]
    errors = np.array([facts["cluster_error"], facts["span_error"]], dtype=float).T
    assert ((errors > 0) & (errors < 1e-20)).any()
    cells = [
        row.split("\t")[-2:] for row in visit.page.locator("#table tbody tr").all_inner_texts()
    ]
    assert ((np.array(cells) == "0") == (errors < 1e-15)).all()
    # Held and drawn along the plot, the mode follows.
    first = visit.page.locator("#plot .dots.exact circle").nth(0).bounding_box()
    visit.page.mouse.move(dot["x"], dot["y"])
    visit.page.mouse.down()
    visit.page.mouse.move(first["x"] + 1, first["y"])
    visit.page.mouse.up()
    assert visit.mode() == 0


def test_the_plot_shows_both_spectra_weyls_law_and_bars(visit):
    assert visit.page.locator("#plot .dots.exact circle").count() == 5
    assert visit.page.locator("#plot .dots.predicted circle").count() == 5
    assert visit.page.get_attribute("#plot .bars.exact", "d").count("V") == 5
    assert visit.page.locator("#plot .bars.predicted").get_attribute("d") in (None, "")
    assert "s law, λ = 4πj / area" in visit.text("#legend")
    # Of this law: through zero and as high at the last mode as 4 pi 4 / area.
    law = np.array(re.findall(r"[\d.]+", visit.page.get_attribute("#plot .weyl", "d")), dtype=float)
    (x, y), dots = law.reshape(-1, 2).T, visit.page.locator("#plot .dots.exact circle")
    cx, cy = ([float(dots.nth(i).get_attribute(at)) for i in (0, 4)] for at in ("cx", "cy"))
    assert (x[0], y[0], x[-1]) == (cx[0], cy[0], cx[1])
    assert (y[0] - y[-1]) / (cy[0] - cy[1]) == pytest.approx(4 * np.pi / 2562, abs=0.01)
    np.testing.assert_allclose(y, np.linspace(y[0], y[-1], len(y)), atol=0.1)


def test_a_drag_turns_every_view_and_a_double_click_turns_back(visit):
    visit.page.keyboard.press("r")
    visit.page.evaluate("explorer.choose(2)")  # x, seen from the side
    visit.settle()
    before = visit.view("exact"), visit.view("predicted")
    box = visit.page.locator("#view-difference .pane").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    visit.page.mouse.move(x, y)
    visit.page.mouse.down()
    visit.page.mouse.move(x + 120, y, steps=2)
    visit.page.mouse.up()
    after = visit.view("exact"), visit.view("predicted")
    assert all(np.abs(a - b).max() > 60 for a, b in zip(after, before, strict=True))
    visit.page.mouse.dblclick(x, y)  # while it glides on
    visit.settle()
    assert np.abs(visit.view("exact") - before[0]).mean() < 1


def test_light_and_dark(visit):
    assert at(visit.view("exact"), 0.02, 0.02).min() > 240
    visit.page.emulate_media(color_scheme="dark")  # as the system says
    visit.page.wait_for_selector("html[data-theme=dark]")
    visit.page.emulate_media(color_scheme="light")
    visit.page.wait_for_selector("html[data-theme=light]")
    visit.page.click("#theme")  # as the button says
    visit.settle()
    view = visit.view("exact")
    assert at(view, 0.02, 0.02).max() < 60
    assert is_red(at(view, 0.5, 0.15))
    assert at(visit.view("difference"), 0.5, 0.4).mean() > 150  # white reads on the dark page
    assert visit.page.get_attribute("#theme", "aria-pressed") == "true"


def test_the_difference_can_be_put_away_and_the_mode_swings(visit):
    wide = visit.page.locator("#view-exact").bounding_box()["width"]
    visit.page.click("#difference")
    visit.settle()
    assert not visit.page.is_visible("#view-difference")
    assert visit.page.locator("#view-exact").bounding_box()["width"] > 1.3 * wide
    assert is_red(at(visit.view("exact"), 0.5, 0.15))
    visit.page.click("#wave")
    visit.page.click("#play")  # pause
    visit.page.evaluate("explorer.stage.phase = Math.PI; explorer.stage.invalidate()")
    visit.settle()
    swung = visit.view("exact")
    assert is_blue(at(swung, 0.5, 0.15))  # the other way round
    assert is_red(at(swung, 0.5, 0.85))
    assert visit.page.get_attribute("#play", "aria-label") == "Play the wave"


def test_a_slow_machine_draws_coarsely_what_moves_and_everything_at_rest(browser, pages):
    many = Visit(browser, pages / "many.html", width=500, height=400)
    assert many.text("#legend").split("\n")[0] == "exact"
    many.page.evaluate("explorer.stage.look([1, 0, 0]); explorer.stage.slow = true")
    many.settle()
    fine = many.view("exact")
    drawn = "explorer.stage.renderer.info.render.triangles"
    everything = many.page.evaluate(drawn)
    # Drawn at once, before the moment of rest: fewer triangles, and no fewer pixels than half.
    few = many.page.evaluate(f"(explorer.stage.draw(0), {drawn})")
    assert 2000 < few < everything / 1.5
    assert 0.5 <= many.page.evaluate("explorer.stage.renderer.getPixelRatio()") <= 1
    many.page.evaluate("explorer.stage.invalidate()")
    many.settle()
    assert many.page.evaluate(drawn) == everything
    assert np.abs(many.view("exact") - fine).max() <= 2
    # 40 ms at one pixel for each of the page, 10 of them for what does not depend on pixels.
    for quick, ratio in ((50, 1), (20, (10 / 30) ** 0.5), (5, 0.5)):
        found = many.page.evaluate(f"explorer.ratioFor({quick}, 40, {10 + 30 / 4})")
        assert found == pytest.approx(ratio)
    many.assert_silent()
    many.page.context.close()


def test_nothing_is_covered(visit):
    for width, height in ((1200, 700), (900, 800)):
        visit.page.set_viewport_size({"width": width, "height": height})
        visit.settle()
        bottoms = visit.page.evaluate("""[".lower", ".card", "#table"].map(
            (name) => document.querySelector(name).getBoundingClientRect().bottom)""")
        assert visit.page.locator("#note").bounding_box()["y"] >= max(bottoms)
        hidden = visit.page.eval_on_selector("#table", "e => e.scrollWidth - e.clientWidth")
        assert (hidden > 0) == (width == 900)  # then it scrolls
    visit.page.set_viewport_size({"width": 920, "height": 640})


def test_names_are_shown_as_they_are(visit):
    assert visit.text("#title") == "<i>Ball</i> & more"
    assert visit.page.title() == "<i>Ball</i> & more"
    assert visit.text("#view-exact h2").strip() == NAMES[0]
    assert visit.text("#view-predicted h2").strip() == NAMES[1]
    assert visit.text("#view-predicted .second") == "not certified"
    assert visit.page.locator("#title i").count() == 0


@pytest.fixture(scope="module")
def phone(browser, pages):
    """A cloud, on a small screen."""
    small = {"width": 390, "height": 640, "has_touch": True, "is_mobile": True}
    visit = Visit(browser, pages / "cloud.html", **small)
    yield visit
    visit.assert_silent()
    visit.page.context.close()


def test_a_thinned_cloud_alone_on_a_phone(phone):
    assert not phone.page.is_visible("#view-predicted")
    assert "Nodal lines run over triangles between neighbouring points" in phone.text("#note")
    assert re.match(r"shown: 1,\d{3} of 2,562 points", phone.text("#subtitle"))
    assert "are those of all" in phone.text("#note")
    assert "not counted: modes may be missing between these" in phone.text("#note")
    phone.page.evaluate("explorer.stage.look([1, 0, 0])")
    phone.settle()
    pixels = phone.view("exact")
    assert is_red(at(pixels, 0.5, 0.3))
    assert is_blue(at(pixels, 0.5, 0.7))
    assert phone.page.evaluate("document.documentElement.scrollWidth") <= 390
    phone.page.tap("#next")
    assert phone.mode() == 2


def test_a_cloud_has_nodal_lines_where_the_function_vanishes(phone):
    visit = phone
    visit.page.evaluate("explorer.choose(1); explorer.stage.look([1, 0, 0])")
    visit.settle()

    def darkest(across):
        pixels = visit.view("exact")
        rows, columns, _ = pixels.shape
        column = int(across * columns)
        return pixels[rows // 3 : -rows // 3, column].max(axis=1).min()

    lines = """() => { const { buffer, thing } = explorer.stage.surface.zeros[0];
        return [...buffer.array.slice(0, 7 * thing.geometry.instanceCount)]; }"""
    segments = np.reshape(visit.page.evaluate(lines), (-1, 7))[:, :6].reshape(-1, 2, 3)
    # Mode 1 is z + 0.02 z^2: its zeros are one whole circle, at the radius 1/2 of a box of side 1.
    assert np.abs(segments[..., 2]).max() < 0.005
    np.testing.assert_allclose(np.linalg.norm(segments, axis=2), 0.5, atol=0.005)
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum()
    assert length == pytest.approx(np.pi, rel=0.02)
    # Drawn over the points, and nowhere else.
    assert max(darkest(0.5), darkest(0.35)) < 120
    visit.page.click("#nodal")
    visit.settle()
    assert darkest(0.5) > 150
    visit.page.click("#nodal")
    # The constant mode has none; while the surface swings, lines stay where they are.
    visit.page.evaluate("explorer.choose(0)")
    visit.settle()
    assert visit.page.evaluate(lines) == []
    visit.page.evaluate("explorer.choose(1)")
    visit.page.click("#wave")
    visit.page.click("#play")
    visit.settle()
    assert darkest(0.5) < 120


def test_an_old_browser_is_told_what_it_lacks(browser, pages):
    page = browser.new_page()
    for lack, reason in (
        ("HTMLCanvasElement.prototype.getContext = () => null", "WebGL 2 is missing"),
        ("delete window.DecompressionStream", "has no DecompressionStream"),
    ):
        page.add_init_script(lack)
        page.goto((pages / "pair.html").as_uri())
        page.wait_for_selector("body.failed")
        assert reason in page.inner_text("#notice")
    page.close()
