"""Time against error: every dot lies where the numbers are."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.transforms import Bbox
from studies.plots import ParetoPoint, pareto_front, plot_pareto

from spectra_kit.show import Page

RUNS = [
    ParetoPoint(name=name, group=group, seconds=seconds, error=error)
    for name, group, seconds, error in (
        ("guess", "ours", 0.1, 1e-1),
        ("slow guess", "ours", 0.4, 2e-1),
        ("good", "theirs", 1.0, 1e-4),
        ("the same", "theirs", 1.0, 2e-4),
        ("exact", "theirs", 8.0, 1e-15),
        ("slower", "ours", 9.0, 1e-16),
    )
]


def drawn(points):
    return plot_pareto.__wrapped__(points, page=Page(dpi=60))


def test_the_front_is_what_nothing_beats():
    assert [p.name for p in pareto_front(RUNS)] == ["guess", "good", "exact"]


def test_dots_lie_at_time_and_error_and_the_front_steps_down():
    panel = drawn(RUNS).axes[0]
    front, ours, theirs, hollow = panel.lines
    assert panel.get_xscale() == panel.get_yscale() == "log"
    np.testing.assert_array_equal(ours.get_xydata(), [(0.1, 0.1), (0.4, 0.2), (9, 1e-12)])
    np.testing.assert_array_equal(theirs.get_ydata(), [1e-4, 2e-4, 1e-12])
    np.testing.assert_array_equal(hollow.get_xydata(), [(8, 1e-12), (9, 1e-12)])
    assert hollow.get_color() == "white"
    assert hollow.get_markersize() < ours.get_markersize()
    assert ours.get_color() != theirs.get_color()
    end = panel.get_xlim()[1]
    np.testing.assert_array_equal(
        front.get_xydata(),
        [(0.1, 0.1), (1, 0.1), (1, 1e-4), (8, 1e-4), (8, 1e-12), (end, 1e-12)],
    )
    told = [text.get_text() for text in panel.figure.legends[0].get_texts()]
    rounding = "hollow: 1e-12 or less, rounding"
    assert told == ["ours", "theirs", rounding, "nothing is both faster and better"]


def test_each_league_has_its_own_front():
    runs = [replace(run, league=run.group) for run in RUNS]
    fronts = drawn(runs).axes[0].lines[:2]
    assert [line.get_ydata()[-1] for line in fronts] == [1e-12, 1e-12]
    assert [line.get_xdata()[0] for line in fronts] == [0.1, 1.0]


def test_bars_lead_from_means_to_the_worst_and_the_page_holds_them():
    runs = [replace(RUNS[0], worst=(30.0, 5.0)), *RUNS[1:]]
    panel = drawn(runs).axes[0]
    (bars,) = panel.containers
    time, error = (collection.get_segments() for collection in bars.lines[2])
    np.testing.assert_allclose(time[0], [(0.1, 0.1), (30, 0.1)])
    np.testing.assert_allclose(error[0], [(0.1, 0.1), (0.1, 5)])
    assert panel.get_xlim()[1] > 30
    assert panel.get_ylim()[1] > 5
    assert not drawn(RUNS).axes[0].containers
    assert pareto_front(runs)[0] == runs[0]


def test_names_cover_neither_each_other_nor_a_dot():
    rng = np.random.default_rng(3)
    crowd = [
        ParetoPoint(name=f"method {i}", group="", seconds=s, error=e)
        for i, (s, e) in enumerate(10 ** rng.uniform(-1, 1, (24, 2)))
    ]
    figure = drawn(crowd)
    panel = figure.axes[0]
    boxes = [text.get_window_extent() for text in panel.texts if text.get_text()]
    assert len(boxes) == 24
    for i, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[:i])
        assert Bbox.intersection(box, panel.bbox).bounds == pytest.approx(box.bounds)
        for run in crowd:
            x, y = panel.transData.transform((run.seconds, run.error))
            assert not box.contains(x, y)
