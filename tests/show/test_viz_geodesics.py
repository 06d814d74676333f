"""Pictures of distances and of convergence: evenly spaced lines, true curves and bars."""

import numpy as np
import pytest
from drawing import SQUARE, can_draw, grey, page  # noqa: F401

from spectra_kit.geometry import PointCloud, TriangleMesh, sphere
from spectra_kit.show import Page, SolverRun, View, plot_convergence, plot_distance
from spectra_kit.show.colours import UNKNOWN, distance_colours
from spectra_kit.show.contours import distance_levels, round_number
from spectra_kit.show.isolines import distance_lines


def test_numbers_are_round():
    assert [round_number(v) for v in (0.9, 1.6, 0.0023, 41, 0.0069)] == [1, 2, 0.0025, 50, 0.005]


def test_levels_are_even_and_leave_room_on_the_page():
    distance = np.array([0.0, 2.63, np.inf])
    np.testing.assert_allclose(distance_levels(distance, None, inch=0.5), 0.1 * np.arange(1, 27))
    assert len(distance_levels(distance, None, inch=10.0)) == 2
    np.testing.assert_allclose(distance_levels(distance, 1.2, inch=0.5), [1.2, 2.4])


def test_colours_fall_evenly_in_lightness_and_infinity_is_grey():
    distance = np.append(np.linspace(0, 3, 50), np.inf)
    colours = distance_colours(distance)
    np.testing.assert_array_equal(colours[:-1], distance_colours(distance[:-1]))
    np.testing.assert_array_equal(colours[-1], UNKNOWN)
    near_to_far = grey(colours[:-1])
    assert (np.diff(near_to_far) < 0).all()
    assert near_to_far[0] - near_to_far[-1] > 100
    assert near_to_far[-1] > grey((48, 48, 54)) + 30  # lines are seen to the end


def test_lines_are_where_the_distance_is_and_every_fifth_is_thicker():
    levels = 0.1 * np.arange(1, 11)
    lines, widths = distance_lines(SQUARE, SQUARE.points[:, 0], levels - 0.05)
    np.testing.assert_allclose(lines[:, 0, 0], lines[:, 1, 0])
    thin, thick = (
        np.unique(lines[widths == width][:, 0, 0].round(6)) for width in np.unique(widths)
    )
    np.testing.assert_allclose(thick, [0.45, 0.95])
    np.testing.assert_allclose(thin, [0.05, 0.15, 0.25, 0.35, 0.55, 0.65, 0.75, 0.85])


def test_nothing_is_drawn_between_a_number_and_infinity():
    lines, _ = distance_lines(SQUARE, np.array([0.0, 1.0, 2.0, np.inf]), np.array([0.5, 1.5]))
    assert len(lines) == 2
    assert (lines[..., 1] <= lines[..., 0]).all()  # in the lower triangle


@pytest.mark.parametrize("kind", [TriangleMesh, PointCloud])
def test_a_page_shows_two_sides_with_their_sources(kind, tmp_path):
    ball = sphere(subdivisions=3).geometry
    distance = np.arccos(np.clip(ball.points @ [0.0, 0.0, 1.0], -1, 1))
    geometry = ball if kind is TriangleMesh else ball.as_cloud()
    top = ball.points[[ball.points[:, 2].argmax()]]
    pages = []
    style = {"view": View("z"), "page": Page(dpi=60)}
    for name, sources in (("with", top), ("without", None)):
        path = tmp_path / f"{name}.png"
        plot_distance(geometry, distance, path=path, sources=sources, **style)
        pages.append(page(path))
    assert pages[0].shape[1] == pytest.approx(60 * (2 * 4.6 + 0.48), abs=2)
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
    figure = plot_convergence.__wrapped__([CG, DIRECT, PEER])
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
    plain = plot_convergence.__wrapped__([DIRECT], solve_name="step").legends[0].get_texts()
    assert [text.get_text() for text in plain] == ["factor", "step (colour of the line)"]
