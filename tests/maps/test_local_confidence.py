"""Confidence at each point: what a whole map hides is seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import creature
from test_match import QUICK, prepared

from spectra_kit import spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import permuted
from spectra_kit.maps import Match, Prepared, local_confidence, match, prepare

N = 1500


@pytest.fixture(scope="module")
def source() -> Prepared:
    return prepared(creature(N), 60)


@pytest.fixture(scope="module")
def found(source) -> Match:
    return match(source, source, mirrored=False, options=QUICK)


def test_a_limb_that_is_turned_about_its_own_axis_is_seen(source, found) -> None:
    """Such a map keeps all lengths along the limb, and the rest of the animal."""
    points = source.surface.points
    limb = np.flatnonzero(points[:, 2] < np.quantile(points[:, 2], 0.12))  # feet
    between = np.linalg.norm(points[limb][:, None] - points[limb], axis=2)
    centres = np.array([points[limb][row < 0.12].mean(axis=0) for row in between])
    opposite = 2 * centres - points[limb]
    opposite[:, 2] = points[limb, 2]
    turned = found.point_map.copy()
    turned[limb] = limb[np.linalg.norm(opposite[:, None] - points[limb], axis=2).argmin(axis=1)]
    moved = np.linalg.norm(points[turned] - points, axis=1) > 0.05
    assert moved.sum() > 30
    wrong, right = (
        local_confidence(replace(found, point_map=p), source, source)
        for p in (turned, found.point_map)
    )
    assert (wrong[moved][:, None] < wrong[~moved]).mean() > 0.95
    assert (wrong[moved] < right[moved]).all()


def test_confidence_follows_the_numbers_of_the_points(source, found) -> None:
    mesh, order = permuted(creature(N), seed=3)
    again = replace(found, point_map=found.point_map[order])
    sure = local_confidence(found, source, source)[order]
    np.testing.assert_allclose(local_confidence(again, source, prepared(mesh, 60)), sure, atol=1e-6)


def test_dense_surfaces_have_it_at_all_points(found) -> None:
    mesh = creature(2500)
    dense = prepare(spectrum(mesh, 60), mesh, n_points=1000)
    whole = replace(found, point_map=np.roll(np.arange(2500), 40))
    sure = local_confidence(whole, dense, dense)
    assert sure.shape == (2500,)
    assert 1 < len(np.unique(sure)) <= dense.spectrum.n < 2500


def test_what_it_cannot_know_is_refused(source, found) -> None:
    bare = prepare(source.spectrum)
    with pytest.raises(InvalidInputError, match="`target` must come with its geometry"):
        local_confidence(found, source, bare)
    part = replace(found, covered=np.ones(N, dtype=bool))
    with pytest.raises(InvalidInputError, match="`found` must map wholes, got a part"):
        local_confidence(part, source, source)
    other = prepared(creature(700), 60)
    with pytest.raises(InvalidInputError, match="found"):
        local_confidence(found, source, other)
