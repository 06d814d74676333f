"""Confidences against how often they were right."""

import numpy as np
import pytest
from conftest import refused
from studies.matching.calibration import doubted_shares, draw_calibration, reliability


@pytest.fixture(scope="module")
def drawn():
    """Twenty thousand maps, each as likely right as its confidence says."""
    rng = np.random.default_rng(0)
    confidences = rng.random(20_000)
    return confidences, rng.random(20_000) < confidences


def test_calibrated_confidences_lie_on_the_diagonal(drawn):
    found = reliability(*drawn)
    assert found.count.sum() == 20_000
    spread = np.sqrt(found.confidence * (1 - found.confidence) / found.count)
    assert (np.abs(found.right - found.confidence) < 4 * spread).all()
    assert found.error < 4 * np.sqrt(0.25 / 2000)


def test_boldness_is_measured(drawn):
    confidences, right = drawn
    bold = np.sqrt(confidences)  # the mean of sqrt(p) - p over p in [0, 1] is 1/6
    assert reliability(bold, right).error == pytest.approx(1 / 6, abs=0.01)
    assert reliability([1.0, 1.0], [False, False]).error == 1
    assert reliability([1.0, 0.0], [True, False]).error == 0


def test_doubted_shares_follow_from_the_density(drawn):
    # Of right maps, of density 2p, a quarter has p < 1/2; of wrong ones, of 2(1 - p), 3/4.
    assert doubted_shares(*drawn) == pytest.approx((0.75, 0.25), abs=0.02)
    wrong, right = doubted_shares([0.2, 0.5], [True, True])
    assert np.isnan(wrong)
    assert right == 0.5  # one half is no doubt


def test_bins_without_maps_are_empty():
    found = reliability([0.05, 0.95, 1.0], [False, True, False], bins=4)
    np.testing.assert_array_equal(found.count, [1, 0, 0, 2])
    np.testing.assert_allclose(found.right, [0, np.nan, np.nan, 0.5])
    np.testing.assert_allclose(found.confidence, [0.05, np.nan, np.nan, 0.975])


def test_it_is_drawn(drawn, tmp_path):
    path = draw_calibration(tmp_path / "all.png", *(x[:200] for x in drawn), title="maps")
    assert path.stat().st_size > 10_000
    sure = draw_calibration(tmp_path / "sure.png", [1.0, 0.9], [True, True])  # none is wrong
    assert sure.stat().st_size > 10_000


def test_bad_confidences():
    for argument, expected, *given in (
        ("confidences", "be at least one number in [0, 1]", [], []),
        ("confidences", "be at least one number in [0, 1]", [1.2], [True]),
        ("confidences", "be at least one number in [0, 1]", [np.nan], [True]),
        ("right", "have the shape (1,)", [0.5], [True, False]),
    ):
        refused(argument, expected, reliability, *given)
