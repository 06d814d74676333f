"""Galleries of fields and modes: colours, nodal lines, formats, and what notebooks show."""

import re
from base64 import b64decode
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from drawing import BALL, SPECTRUM, SQUARE, can_draw, page  # noqa: F401
from matplotlib.figure import Figure
from PIL import Image

from spectra_kit import eigensolve, robust_laplacian
from spectra_kit.eigen.metrics import compare_spectra
from spectra_kit.geometry import PointCloud, TriangleMesh, rectangle
from spectra_kit.show import (
    MatchedPair,
    Page,
    Picture,
    View,
    plot_comparison,
    plot_correspondences,
    plot_fields,
    plot_functional_map,
    plot_modes,
)
from spectra_kit.show.colours import (
    SQUARES,
    diverging_colours,
    named_squares,
    sequential_colours,
    texture_colours,
)
from spectra_kit.show.contours import level_lines, triangles_of
from spectra_kit.show.fields import Panel, _panel, symmetric_limit
from spectra_kit.show.modes import _panel as mode_panel
from spectra_kit.show.modes import _panels as mode_panels
from spectra_kit.show.modes import display_signs
from spectra_kit.show.render import Scene, render

LEVELS = np.array([-0.5, 0.0, 0.5])
WHITE = np.full((2, 3), 255, np.uint8)

# What people without green or blue cones see, of linear sRGB: G. Machado, M. Oliveira and
# L. Fernandes, A physiologically-based model for simulation of color vision deficiency, 2009.
SEEN = {
    "all": np.eye(3),
    "deuteranopia": np.array(
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ]
    ),
    "tritanopia": np.array(
        [
            [1.255528, -0.076749, -0.178779],
            [-0.078411, 0.930809, 0.147602],
            [0.004733, 0.691367, 0.303900],
        ]
    ),
}


def seen(colours, matrix):
    """Colours as linear sRGB in the eyes of somebody."""
    c = np.asarray(colours, float) / 255
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    return np.clip(linear @ matrix.T, 0, 1)


def lightness(colours, matrix=SEEN["all"]):
    return np.cbrt(seen(colours, matrix) @ [0.2126, 0.7152, 0.0722])


def drawn(*scenes, width, line_width=4.0):
    """Draw white geometries with nothing but the nodal lines of values, seen by a rotation."""
    made = [
        Scene(
            geometry=geometry,
            functions=[np.zeros(geometry.n)],
            rotation=rotation,
            width=width,
            colours=WHITE,
            lines=[level_lines(geometry.points, triangles_of(geometry), values)],
            line_width=line_width,
        )
        for geometry, values, rotation in scenes
    ]
    return [pictures[0].mean(axis=2) for pictures in render(made)]


def lengths(segments):
    return np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)


def test_diverging_colours_are_equally_light_on_both_sides():
    at = np.linspace(0, 1, 101)
    red, blue = diverging_colours(at), diverging_colours(-at)
    np.testing.assert_array_equal(red[0], [255, 255, 255])
    for side in (red, blue):
        assert (np.diff(lightness(side)) < 0).all()
        steps = np.diff(lightness(side)[::10])
        assert steps.min() > 1.6 * steps.max()  # no step of the value leaps out
    np.testing.assert_allclose(lightness(red), lightness(blue), rtol=0.06)
    assert (red[1:, 0] > red[1:, 2]).all()


@pytest.mark.parametrize("matrix", SEEN.values(), ids=SEEN)
def test_colours_can_be_told_by_the_colour_blind(matrix):
    at = np.linspace(0.3, 1, 20)
    red, blue = (seen(diverging_colours(side), matrix) for side in (at, -at))
    hues = [side / side.sum(axis=1, keepdims=True) for side in (red, blue)]
    assert (np.linalg.norm(hues[0] - hues[1], axis=1) > 0.1).all()  # not by lightness
    assert (np.diff(lightness(sequential_colours(np.linspace(0, 1, 40)), matrix)) > 0).all()


def test_the_zeros_of_a_height_are_the_equator():
    turned = BALL.points @ np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    lines = level_lines(turned, BALL.faces, turned[:, 2])
    assert np.abs(lines[..., 2]).max() < 1e-12
    assert lengths(lines).sum() == pytest.approx(2 * np.pi, rel=0.01)
    several = level_lines(turned, BALL.faces, turned[:, 2], LEVELS)
    assert lengths(several).sum() == pytest.approx(2 * np.pi * (1 + np.sqrt(3)), rel=0.01)
    cloud = PointCloud(turned)
    near = level_lines(turned, triangles_of(cloud), turned[:, 2])
    assert lengths(near).sum() == pytest.approx(2 * np.pi, rel=0.02)  # nor drawn twice
    assert np.abs(near[..., 2]).max() < 1e-12
    angles = np.sort(np.arctan2(near[..., 1], near[..., 0]).ravel())
    assert np.diff(angles).max() < 0.15  # nowhere broken


def test_zeros_at_vertices_make_one_line():
    middle = TriangleMesh(
        [[x, y, 0] for y in (0, 1) for x in (-1, 0, 1)],
        [[0, 1, 3], [1, 4, 3], [1, 2, 4], [2, 5, 4]],
    )
    for sign in (1, -1):
        lines = level_lines(middle.points, middle.faces, sign * middle.points[:, 0])
        assert lengths(lines).sum() == pytest.approx(1)
        assert np.abs(lines[lengths(lines) > 0][..., 0]).max() == 0


def test_rounding_and_plateaus_make_no_line():
    noise = 1e-9 * np.random.default_rng(0).normal(size=BALL.n)
    bump = np.maximum(BALL.points[:, 2] - 0.5, 0)
    wide = np.clip(np.abs(BALL.points[:, 2]) - 0.5, 0, None) * np.sign(BALL.points[:, 2])
    for values in (1 + noise, 0 * noise, noise + bump, noise - bump, noise + wide):
        assert len(level_lines(BALL.points, BALL.faces, values)) == 0


@pytest.mark.parametrize("offset", [1e9, -1e6, None])
def test_levels_are_relative_to_the_range_of_values(offset):
    height = BALL.points[:, 2] + (offset or 0.0)
    if offset is None:
        height[height.argmax()] = 1e8  # a spike
    lines = level_lines(BALL.points, BALL.faces, height, LEVELS + (offset or 0.0))
    assert lengths(lines).sum() == pytest.approx(2 * np.pi * (1 + np.sqrt(3)), rel=0.01)


def panel_of(values):
    return _panel("", values, [values], None, "levels")


def test_a_spike_neither_widens_the_colours_nor_adds_levels():
    spiked = 1e-3 * np.abs(BALL.points[:, 2])
    spiked[0] = 1e3
    panel = panel_of(spiked)
    assert panel.limit < 1.1e-3
    assert 8 <= len(panel.levels) <= 20
    assert panel.low <= min(panel.levels) < max(panel.levels) <= panel.limit


def test_ends_of_colours_hold_the_values_and_can_be_told_apart():
    spike, zero = np.zeros(BALL.n), np.zeros(BALL.n)
    spike[7] = 1.0
    delta = panel_of(spike)
    assert (delta.low, delta.limit, delta.ends()) == (0.0, 1.0, ("0", "1.0"))
    assert symmetric_limit(-5 * spike) == 5.0
    for value, text in ((zero, "0"), (zero + 3, "3.0"), (zero + 3 + 1e-14 * spike, "3.0")):
        panel = panel_of(value)
        assert (panel.ends(), panel.levels) == (("", text), ())
        assert (panel.scaled() == 0).all()
        assert (panel.colours(5) == sequential_colours(np.array([0.5]))).all()
    low, high = (float(end) for end in panel_of(1e9 + BALL.points[:, 2]).ends())
    assert high - low == pytest.approx(2, rel=0.05)
    assert Panel(values=zero, low=0.518, limit=0.523).ends() == ("0.518", "0.523")


def test_lines_have_one_width_whatever_their_direction():
    assert (drawn((SQUARE, np.ones(4), np.eye(3)), width=20)[0] > 150).all()  # a constant has none
    directions = np.array([[1, 0], [0, 1], [1, 1], [1, -2]])
    normals = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    values = (SQUARE.points[:, :2] - 0.5) @ normals.T
    pictures = drawn(*((SQUARE, f, np.eye(3)) for f in values.T), width=208)
    for normal, picture in zip(normals, pictures, strict=True):  # 200 pixels without the margins
        length, white = 200 / np.abs(normal).max(), np.median(picture)
        ink = (white - picture[4:-4, 4:-4]) / (white - 50)
        assert ink.sum() == pytest.approx(4 * length, rel=0.05)


def test_lines_reach_round_a_surface_and_hide_behind_it():
    tilt = np.deg2rad(30)
    rotation = np.array(
        [[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]]
    )
    height = BALL.points[:, 1]
    for picture in drawn((BALL, height, rotation), (BALL.as_cloud(), height, rotation), width=200):
        dark = picture < 90
        columns = np.flatnonzero(dark.any(axis=0))
        assert np.ptp(columns) > 165
        assert dark[:, columns[0] : columns[-1] + 1].any(axis=0).mean() > 0.98
        rows = np.flatnonzero(dark[:, 100])  # the front of the ellipse, not its back
        middle = dark.shape[0] / 2
        assert (rows < middle).all() or (rows > middle).all()
        assert np.abs(rows - middle).mean() == pytest.approx(92 * np.sin(tilt), abs=6)


def test_fields_share_a_view_and_limits(tmp_path, monkeypatch, capfd):
    monkeypatch.delenv("DISPLAY", raising=False)
    fields = {"whole": BALL.points[:, 2], "half": BALL.points[:, 2] / 2}
    style = {"columns": 2, "view": View("z"), "page": Page(dpi=40)}
    own = plot_fields(BALL, fields, path=tmp_path / "own.png", **style)
    one = plot_fields(
        BALL.as_cloud(), fields, path=tmp_path / "one.png", share_limits=True, **style
    )
    for picture in (own, one):  # no more than the margin stays empty at the foot
        inked = np.flatnonzero((page(picture.path) < 240).any(axis=(1, 2)))
        assert 5 <= len(page(picture.path)) - inked[-1] <= 10
    own, one = page(own.path)[30:180], page(one.path)[30:180]
    half = own.shape[1] // 2
    left, right = own[:, :half], own[:, own.shape[1] - half :]
    starts = [np.flatnonzero((np.ptp(p, axis=2) > 40).any(axis=0))[0] for p in (left, right)]
    np.testing.assert_array_equal(left, np.roll(right, starts[0] - starts[1], axis=1))
    assert 0.25 < (np.ptp(left, axis=2) > 40).mean() < 0.7
    strong = [np.ptp(p, axis=2).max() for p in (one[:, :half], one[:, half:])]
    assert strong[1] < 0.85 * strong[0]
    assert capfd.readouterr() == ("", "")


def test_colours_are_symmetric_where_values_are_negative_or_it_is_asked_for():
    def content(values, **options):
        return plot_fields(BALL, {"f": values}, page=Page(dpi=20), **options).content

    height = BALL.points[:, 2]
    assert content(height) == content(height, symmetric=True) != content(height, symmetric=False)
    square = height**2
    assert content(square) == content(square, symmetric=False) != content(square, symmetric=True)


def embedded(svg):
    """The pictures in an SVG that are more than a bar."""
    found = re.findall(r"data:image/png;base64,\s*([A-Za-z0-9+/=\s]+)", svg)
    images = [np.asarray(Image.open(BytesIO(b64decode(text))).convert("RGB")) for text in found]
    return [image.astype(int) for image in images if len(image) > 20]


def test_vector_pages_hold_text_and_pictures_of_their_resolution(tmp_path):
    def draw(name, modes):
        page = Page("T & λ", dpi=90)
        return plot_modes(BALL, SPECTRUM, path=tmp_path / name, modes=modes, page=page).path

    svg = draw("modes.svg", [0, 4]).read_text()
    sheet = rectangle(n=200).geometry  # galleries leave constants out
    found = eigensolve(robust_laplacian(sheet), 3)
    first = plot_modes(sheet, found, path=tmp_path / "m.svg", page=Page(dpi=20)).path.read_text()
    assert re.findall(r">mode (\d)", first) == ["1", "2"]
    texts = re.findall(r">([^<>]+)</text>", svg)
    assert texts[0] == "T &amp; λ"
    assert any(text.startswith("mode 4 ") and "λ = " in text for text in texts)
    assert sum("relative residual " in text for text in texts) == 2
    assert svg.count("<image") == 4  # two pictures, two bars
    constant, mode = embedded(svg)
    assert constant.shape == mode.shape
    assert constant.shape[1] == 4.5 * 90
    inked = [((p.max(axis=2) < 90) & (np.ptp(p, axis=2) < 25)).sum() for p in (constant, mode)]
    assert inked[0] == 0
    assert inked[1] > 60  # its nodal lines
    pdf = draw("modes.pdf", [4]).read_bytes()
    assert pdf.startswith(b"%PDF")
    assert max(int(n) for n in re.findall(rb"/Width (\d+)", pdf)) == 4.5 * 90


@pytest.mark.parametrize("name", ["a.svg", "a.pdf"])
def test_the_same_page_has_the_same_bytes(tmp_path, name):
    style = {"page": Page("C", dpi=30)}
    plots = (plot_functional_map(np.eye(4), path=tmp_path / name, **style) for _ in range(2))
    assert len({plot.path.read_bytes() for plot in plots}) == 1


def test_a_page_that_cannot_be_written_whole_leaves_the_last_one(tmp_path, monkeypatch):
    def fails(figure, path, **_):
        Path(path).write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Figure, "savefig", fails)
    (path := tmp_path / "x.png").write_text("the last one")
    with pytest.raises(OSError, match="No space"):
        plot_functional_map(np.eye(3), path=path)
    assert [(x.name, x.read_text()) for x in tmp_path.iterdir()] == [("x.png", "the last one")]


def test_comparisons_draw_zeros_of_modes_alone(tmp_path):
    comparison = compare_spectra(SPECTRUM, SPECTRUM)
    with_lines, without = (
        page(
            plot_comparison(
                *(BALL, SPECTRUM, SPECTRUM, comparison),
                path=tmp_path / "c.png",
                modes=[2],
                nodal_lines=lines,
                page=Page(dpi=60),
            ).path
        )
        for lines in (True, False)
    )
    darker = without.sum(axis=2) - with_lines.sum(axis=2) > 100
    along = int(darker.shape[1] > darker.shape[0])  # the three stand beside or below each other
    *modes, difference = (part.sum() for part in np.array_split(darker, 3, axis=along))
    assert min(modes) > 50 > difference == 0


def test_squares_are_named_light_and_dark():
    chart = named_squares(3, 2).astype(int)
    corners = chart[5::96, 5::96].sum(axis=2)
    assert (corners[0, [0, 2]] < corners[0, 1] - 150).all()  # A2 and C2 are dark, A1 and B2 light
    assert corners[1, 0] > corners[0, 0] + 150
    inked = [np.ptp(chart[:96, i * 96 : i * 96 + 96].sum(axis=2)) for i in range(3)]
    assert min(inked) > 250
    box = np.zeros(3), np.array([1.0, 0.5, 1.0])
    cells = (np.arange(SQUARES) + 0.06) / SQUARES
    row = texture_colours(np.column_stack([cells, 0 * cells + 0.005, cells]), *box).astype(int)
    assert (np.abs(np.diff(row.sum(axis=1))) > 120).all()


def test_a_texture_travels_with_the_map(tmp_path):
    pairs = [
        MatchedPair(source=BALL, target=BALL, point_map=np.arange(BALL.n)),
        MatchedPair(source=BALL, target=BALL, point_map=np.zeros(BALL.n, dtype=int)),
    ]
    svg = plot_correspondences(
        pairs, path=tmp_path / "t.svg", transfer="texture", view=View("z"), page=Page(dpi=40)
    )
    source, same, _, constant = embedded(svg.path.read_text())
    np.testing.assert_array_equal(source, same)
    hues = [
        (part / part.sum(axis=1, keepdims=True)).std(axis=0).max()
        for part in (p[p.min(axis=2) < 240] for p in (source, constant))
    ]
    assert hues[1] < 0.6 * hues[0]  # one colour, and the light on it


def test_notebooks_show_pictures_with_a_file_and_without(tmp_path):
    (tmp_path / "x.svg").write_text("<svg/>")
    (tmp_path / "x.pdf").write_bytes(b"%PDF")
    picture = plot_functional_map(np.eye(3), path=tmp_path / "x.png", page=Page(dpi=20))
    content = (tmp_path / "x.png").read_bytes()
    shown = plot_functional_map(np.eye(3), page=Page(dpi=20))
    assert (shown.path, shown.content) == (None, content)
    for kept in (picture, shown, plot_functional_map(np.eye(3), page=Page(dpi=20))):
        assert b64decode(kept._repr_mimebundle_()["image/png"]) == content
    assert Picture(tmp_path / "x.svg")._repr_mimebundle_() == {"image/svg+xml": "<svg/>"}
    assert list(Picture(content=b"GIF89a")._repr_mimebundle_()) == ["image/gif"]
    for nothing in (Picture(tmp_path / "x.pdf"), Picture(tmp_path / "missing.png"), Picture()):
        assert nothing._repr_mimebundle_() == {}


def test_the_largest_entry_decides_then_the_cubes_then_the_first():
    columns = np.array([[1, -3, 0], [-2, 2, 2, -1.5], [2, -2, 1, 0], [0, 0, 0], [-5]], dtype=object)
    signs = [float(display_signs(np.array(c, dtype=float)[:, None])[0]) for c in columns]
    assert signs == [-1.0, 1.0, 1.0, 1.0, -1.0]


def test_rounding_does_not_turn_a_tie():
    rng = np.random.default_rng(0)
    odd = np.concatenate([[1.0, -1.0], rng.uniform(-0.9, 0.9, 40)])
    skewed = odd.copy()
    skewed[2:] = np.abs(skewed[2:])
    antisymmetric = np.concatenate([odd, -odd])
    for v in (skewed, antisymmetric):
        noisy = v[:, None] + 1e-9 * rng.normal(size=(len(v), 50))
        assert (display_signs(noisy) == display_signs(v[:, None])).all()
        assert (display_signs(-noisy) == -display_signs(v[:, None])).all()
    assert display_signs(skewed[:, None]) == 1.0


def test_modes_look_the_same_in_galleries_and_comparisons():
    ball = BALL.with_points(BALL.points * [1.5, 1.2, 1.0])
    found = eigensolve(robust_laplacian(ball), 5)
    turned = type(found)(found.eigenvalues, -found.eigenvectors, found.mass)
    comparison = compare_spectra(turned, found)
    for mode in range(found.k):
        shown = mode_panel(turned, mode, ()).values
        np.testing.assert_allclose(shown, mode_panel(found, mode, ()).values)
        aligned = turned.eigenvectors[:, mode]
        left, right, _ = mode_panels(turned, found, aligned, comparison, mode, ())
        for side in (left, right):
            np.testing.assert_allclose(side.values, shown)
        assert shown.max() > (1 - 1e-5) * -shown.min()


def test_lines_end_where_a_function_is_not_known():
    """Cut off at z = 0, the zeros of x lie on the upper half alone, where they were."""
    x, z = BALL.points[:, 0], BALL.points[:, 2]
    whole = level_lines(BALL.points, BALL.faces, x)
    half = level_lines(BALL.points, BALL.faces, np.where(z < 0, np.nan, x))
    assert np.isfinite(half).all()
    assert (half[..., 2] >= 0).all()
    length = [np.linalg.norm(line[:, 0] - line[:, 1], axis=1).sum() for line in (whole, half)]
    assert 0.35 < length[1] / length[0] <= 0.5


def test_what_is_not_known_is_grey(tmp_path):
    """The left half of a sheet has no values; the right one has the colours it had."""
    sheet = rectangle(n=900).geometry
    right = sheet.points[:, 0] > np.median(sheet.points[:, 0])
    pictures = []
    for values in (sheet.points[:, 1] - 0.5, np.where(right, sheet.points[:, 1] - 0.5, np.nan)):
        plot_fields(sheet, {"y": values}, path=tmp_path / "y.png", view=View("z"))
        pictures.append(page(tmp_path / "y.png"))
    whole, half = pictures
    changed = np.abs(half - whole).max(axis=2) > 20
    assert changed.sum() / (half.min(axis=2) < 250).sum() == pytest.approx(0.5, abs=0.06)
    assert np.percentile(np.ptp(half, axis=2)[changed], 95) == 0
