"""Pictures of distances and of convergence: evenly spaced lines, true curves and bars."""

import numpy as np
import pytest
from PIL import Image

from spectra_kit.errors import InvalidInputError, MissingDependencyError
from spectra_kit.geometry import PointCloud, TriangleMesh, sphere
from spectra_kit.viz import SolverRun, plot_convergence, plot_distance
from spectra_kit.viz.colours import UNKNOWN
from spectra_kit.viz.convergence import _page
from spectra_kit.viz.distance_scale import (
    LINE,
    MARK,
    distance_colours,
    distance_scale,
    round_number,
)
from spectra_kit.viz.isolines import _torn
from spectra_kit.viz.render import Scene, render

# Two triangles, whatever the number of lines.
SQUARE = TriangleMesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])


def drawn(geometry, distance, **options):
    """The pixels of a geometry seen from above, in the colours of its distances."""
    scale = distance_scale(distance, inch=1.0, dpi=400, **options)
    scene = Scene(
        geometry=geometry,
        functions=[scale.values(distance)],
        rotation=np.eye(3),
        width=400,
        colours=scale.table,
    )
    try:
        return scale, render([scene])[0][0].astype(int)
    except MissingDependencyError as error:
        pytest.skip(f"no picture can be drawn here: {error}")


def grey(colours):
    return np.asarray(colours, float) @ [0.299, 0.587, 0.114]


def dark_runs(values, reach):
    """Centres of the runs that are clearly darker than what lies around them, up to `reach`."""
    windows = (values[max(i - reach, 0) : i + reach + 1] for i in range(len(values)))
    around = np.array([np.median(window) for window in windows])
    dark = np.flatnonzero(values < around - 25)
    return np.array([run.mean() for run in np.split(dark, np.flatnonzero(np.diff(dark) > 1) + 1)])


def page(path):
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB")).astype(int)


def test_numbers_are_round():
    assert [round_number(v) for v in (0.9, 1.6, 0.0023, 41, 0.0069)] == [1, 2, 0.0025, 50, 0.005]


def test_lines_are_even_and_no_more_than_asked_for():
    scale = distance_scale(np.array([0.0, 2.63]), inch=0.5)
    assert scale.spacing == 0.1
    centres = dark_runs(grey(scale.ramp), 70) / len(scale.ramp) * 2.63
    np.testing.assert_allclose(centres, 0.1 * np.arange(1, 27), atol=0.002)


def test_colours_fall_evenly_in_lightness():
    near_to_far = grey(distance_colours(np.linspace(0, 1, 50)))
    assert (np.diff(near_to_far) < 0).all()
    assert near_to_far[0] - near_to_far[-1] > 100
    assert near_to_far[-1] > grey(LINE) + 50  # lines are seen to the end


def test_infinity_is_grey_and_changes_no_other_colour():
    distance = np.array([0.0, 1.0, 3.0])
    beyond = np.append(distance, np.inf)
    np.testing.assert_array_equal(distance_colours(beyond)[:3], distance_colours(distance))
    np.testing.assert_array_equal(distance_colours(beyond)[3], UNKNOWN)
    scale = distance_scale(beyond, inch=1.0)
    at = np.round((scale.values(beyond) + 1) / 2 * (len(scale.table) - 1)).astype(int)
    np.testing.assert_array_equal(scale.table[at[3]], UNKNOWN)
    np.testing.assert_array_equal(scale.table[round((scale.mark + 1) / 2 * 3999)], MARK)
    np.testing.assert_allclose(scale.table[at[0]], distance_colours(distance)[0], atol=1)


def test_lines_are_sharp_inside_a_triangle():
    distance = 2 * SQUARE.points[:, 0]
    scale, picture = drawn(SQUARE, distance, spacing=0.2)
    assert scale.limit == 2
    row = picture[200, 4:-4]  # inside the margin
    centres = dark_runs(grey(row), 12) / len(row) * 2
    np.testing.assert_allclose(centres, 0.2 * np.arange(1, len(centres) + 1), atol=0.012)
    assert len(centres) in (9, 10)  # the last is the edge
    assert np.ptp(picture[50:350], axis=0)[4:-4].max() <= 12  # the same in every row: straight


def test_both_sides_of_a_line_are_of_their_own_colours():
    _, picture = drawn(SQUARE, SQUARE.points[:, 0], spacing=0.5)
    row = picture[200, 4:-4]
    middle = len(row) // 2
    assert grey(row[middle]) < grey(row[[middle - 10, middle + 10]]).min() - 40
    assert grey(row[middle - 10]) > grey(row[middle + 10])
    flat = distance_colours(np.array([0.0, 0.25, 0.75, 1.0]))
    for x, colour in ((0.25, flat[1]), (0.75, flat[2])):  # of one hue, whatever the light
        seen = row[round(x * len(row))]
        np.testing.assert_allclose(seen / seen.sum(), colour / colour.sum(), atol=0.02)


def test_nothing_is_drawn_between_a_number_and_infinity():
    distance = np.array([0.0, 1.0, 2.0, np.inf])
    torn, where = _torn(SQUARE, np.isfinite(distance))
    assert torn.n == 6  # the diagonal is there twice
    np.testing.assert_array_equal(torn.points[torn.faces[1]], SQUARE.points[[0, 2, 3]])
    values = distance[where]
    assert np.isfinite(values[torn.faces[0]]).all()
    assert np.isinf(values[torn.faces[1]]).all()
    _, picture = drawn(torn, values)
    lower, upper = picture[300, 250], picture[100, 150]
    assert np.ptp(lower) > 30  # a hue
    assert np.ptp(upper) <= 3
    whole, same = _torn(SQUARE, np.ones(4, bool))
    assert whole is SQUARE
    np.testing.assert_array_equal(same, np.arange(4))


def test_a_cloud_has_bands():
    line = np.linspace(0, 1, 400)
    scale = distance_scale(line, inch=1.0, spacing=0.1, lines=False)
    shade = grey(scale.ramp) / grey(distance_colours(np.linspace(0, 1, len(scale.ramp))))
    jumps = np.flatnonzero(np.abs(np.diff(shade)) > 0.1)
    np.testing.assert_allclose(jumps / len(shade), 0.1 * np.arange(1, 10), atol=0.001)


@pytest.mark.parametrize("kind", [TriangleMesh, PointCloud])
def test_a_page_shows_two_sides_with_their_sources(kind, tmp_path):
    ball = sphere(subdivisions=4).geometry
    distance = np.arccos(np.clip(ball.points @ [0.0, 0.0, 1.0], -1, 1))
    geometry = ball if kind is TriangleMesh else ball.as_cloud()
    top = ball.points[[ball.points[:, 2].argmax()]]
    pages = []
    for name, sources in (("with", top), ("without", None)):
        path = tmp_path / f"{name}.png"
        try:
            plot_distance(path, geometry, distance, sources=sources, up="z", dpi=60)
        except MissingDependencyError as error:
            pytest.skip(f"no picture can be drawn here: {error}")
        pages.append(page(path))
    assert pages[0].shape[1] == pytest.approx(60 * (2 * 4.6 + 0.6), abs=2)
    pixels = pages[0][20:270]
    half = pixels.shape[1] // 2
    for side in (pixels[:, :half], pixels[:, half:]):
        coloured = np.ptp(side, axis=2) > 20
        assert 0.4 < coloured.mean() < 0.9
        middle = side[:, side.shape[1] // 2]
        high, low = middle[40:70].mean(axis=0), middle[200:230].mean(axis=0)
        assert grey(high) > grey(low)  # the source is above
        assert high[2] / high[0] < low[2] / low[0] - 0.2  # and warmer
    black = [(grey(p[16:36]) < 50).sum() for p in pages]  # at the top, where lines are thin
    assert black[0] > black[1] + 15


def test_distances_that_cannot_be_drawn_are_refused(tmp_path):
    good = np.arange(4.0)
    for distance, message in (
        (good[:3], r"shape \(4,\).* got shape \(3,\)"),
        ([0, 1, 2, np.nan], "1 NaN and 0 negative"),
        ([0, 1, -2, -1], "0 NaN and 2 negative"),
    ):
        with pytest.raises(InvalidInputError, match=message):
            plot_distance(tmp_path / "a.png", SQUARE, distance)
    for options, message in (
        ({"spacing": 0.001}, r"`spacing` must be at least 0.015, .* got 0.001"),
        ({"spacing": -1.0}, "`spacing` must be positive"),
        ({"up": "w"}, "`up` must be 'x', 'y', 'z' or None"),
        ({"sources": [1, 2, 3]}, "`sources` must have shape"),
    ):
        with pytest.raises(InvalidInputError, match=message):
            plot_distance(tmp_path / "a.png", SQUARE, good, **options)
    with pytest.raises(InvalidInputError, match=r"must end in .png"):
        plot_distance(tmp_path / "a.eps", SQUARE, good)
    with pytest.raises(InvalidInputError, match="does not exist"):
        plot_distance(tmp_path / "no" / "a.png", SQUARE, good)
    assert not list(tmp_path.iterdir())


CG = SolverRun(
    name="CG",
    stages={"triangulation": 0.3, "setup": 0.2},
    spectrum_seconds=2.0,
    times=[0.1, 0.2, 0.4],
    residuals=[1.0, 1e-5, 1e-9],
)
DIRECT = SolverRun(name="direct", stages={"factor": 1.0}, times=[0.05], residuals=[1e-14])
PEER = SolverRun(name="peer", stages={"build": 3.0, "first solve": 0.5})


def test_a_run_knows_its_seconds():
    assert (CG.start, CG.solve_seconds, CG.iterations) == (0.5, 0.4, 2)
    assert CG.seconds == pytest.approx(0.9)
    assert (DIRECT.seconds, DIRECT.iterations) == (1.05, None)
    assert (PEER.seconds, PEER.solve_seconds, PEER.iterations) == (3.5, 0.0, None)


def test_curves_start_after_their_stages_and_bars_add_up():
    figure = _page([CG, DIRECT, PEER], 1e-8, "Poisson step", "", "", 100)
    iterations, _, clock, bars, counted, counted_bars = figure.axes
    np.testing.assert_array_equal(iterations.lines[0].get_ydata(), CG.residuals)
    for panel, spectrum in ((clock, 0.0), (counted, 2.0)):
        flat, curve, point, wall, *_ = panel.lines
        np.testing.assert_allclose(curve.get_xdata(), spectrum + 0.5 + np.array([0.1, 0.2, 0.4]))
        np.testing.assert_array_equal(curve.get_ydata(), CG.residuals)
        np.testing.assert_allclose(flat.get_xdata(), [0, spectrum + 0.6])
        np.testing.assert_allclose(point.get_xydata(), [[1.05, 1e-14]])
        np.testing.assert_allclose(wall.get_xdata(), [3.5, 3.5])
    for panel, totals in ((bars, [0.9, 1.05, 3.5]), (counted_bars, [2.9, 1.05, 3.5])):
        ends = [0.0, 0.0, 0.0]
        for bar in panel.patches:
            row = round(bar.get_y() + bar.get_height() / 2)
            assert bar.get_x() == pytest.approx(ends[row])
            ends[row] += bar.get_width()
        assert ends == pytest.approx(totals)
    assert bars.get_xlim() == clock.get_xlim()
    key = [text.get_text() for text in figure.legends[0].get_texts()]
    assert key[:3] == ["spectrum", "triangulation", "setup"]
    plain = _page([DIRECT], 1e-8, "solve", "", "", 100).legends[0].get_texts()
    assert [text.get_text() for text in plain] == ["factor", "solve (colour of the line)"]


def test_convergence_is_drawn_whole_or_refused(tmp_path):
    path = tmp_path / "convergence.png"
    plot_convergence(path, [CG, DIRECT, PEER], title="Three", subtitle="of them", dpi=50)
    assert page(path).shape[1] == 600
    with pytest.raises(InvalidInputError, match="at least one SolverRun"):
        plot_convergence(path, [])
    with pytest.raises(InvalidInputError, match=r"must end in .png"):
        plot_convergence(tmp_path / "a.eps", [CG])
    with pytest.raises(InvalidInputError, match="`rtol` must be positive"):
        plot_convergence(path, [CG], rtol=0.0)
    with pytest.raises(InvalidInputError, match=r"got shapes \(2,\) and \(1,\)"):
        SolverRun(name="bad", stages={}, times=[0, 1], residuals=[1.0])
    with pytest.raises(InvalidInputError, match="`times` must be ascending"):
        SolverRun(name="bad", stages={}, times=[1, 0], residuals=[1.0, 0.5])
