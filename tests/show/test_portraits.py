"""Thumbnails: classes keep their colours, and what cannot be drawn is refused."""

import numpy as np
import pytest

from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import sphere
from spectra_kit.show import Thumbnail, plot_thumbnails
from spectra_kit.show.camera import View
from spectra_kit.show.thumbnails import _palette, _scene

BALL = sphere(subdivisions=2).geometry


def test_every_vertex_has_the_colour_of_its_class_and_triangles_change_halfway():
    labels = (BALL.points[:, 2] > 0).astype(int) * 2
    scene = _scene(Thumbnail(geometry=BALL, labels=labels), View(), 30)
    (colours,) = scene.functions
    palette = _palette(3)
    np.testing.assert_array_equal(colours[: BALL.n], palette[labels])
    assert {tuple(c) for c in colours} == {tuple(palette[0]), tuple(palette[2])}
    height = scene.geometry.points[:, 2]
    share = (colours == palette[2]).all(axis=1)
    assert height[share].min() > height[~share].max() - 0.4


def test_first_colours_are_apart():
    colours = _palette(8).astype(int)
    gaps = np.abs(colours[:, None] - colours[None]).sum(axis=2) + 999 * np.eye(8, dtype=int)
    assert gaps.min() > 45


def test_many_classes_take_no_more_room_than_there_are_and_later_ones_are_paler():
    _scene(Thumbnail(geometry=BALL, labels=np.full(162, 60_000)), View(), 30)
    colours = _palette(24).astype(int)
    assert len({tuple(c) for c in colours}) == 24


@pytest.mark.parametrize(
    ("labels", "message"),
    [
        (np.zeros(5, dtype=int), r"`labels` must have shape \(162,\)"),
        (np.full(162, -1), r"`labels` must be in \[0"),
        (np.zeros(162), "hold integers"),
    ],
)
def test_labels_that_are_none(labels, message):
    with pytest.raises(InvalidInputError, match=message):
        Thumbnail(geometry=BALL, labels=labels)


def test_there_must_be_one():
    with pytest.raises(InvalidInputError, match="`thumbnails` must hold at least one"):
        plot_thumbnails([])
