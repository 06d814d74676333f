"""Pictures of maps and of classes: colours that travel, errors, matrices and curves."""

import numpy as np
import pytest
from conftest import refused
from drawing import can_draw, draw, grey, page  # noqa: F401

from spectra_kit.geometry import creature_pair, sphere
from spectra_kit.maps import Truth, map_errors
from spectra_kit.show import (
    MatchedPair,
    Page,
    Thumbnail,
    View,
    plot_correspondence,
    plot_functional_map,
    plot_thumbnails,
)
from spectra_kit.show.colours import UNKNOWN, error_colours, position_colours, refined
from spectra_kit.show.thumbnails import _palette, _scene

BOX = np.zeros(3), np.ones(3)
BALL = sphere(subdivisions=2).geometry
PAIR = creature_pair(600, poses=(0, 1))


def test_positions_are_told_apart_in_every_direction():
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    colours = position_colours(corners, *BOX, squares=False).astype(int)
    distance = np.abs(colours[:, None] - colours).sum(axis=2) + 1000 * np.eye(8, dtype=int)
    assert distance.min() > 60
    left, right = colours[corners[:, 0] == 0], colours[corners[:, 0] == 1]
    assert (left[:, 2] - left[:, 1] > right[:, 2] - right[:, 1] + 50).all()  # bluer
    far, near = colours[corners[:, 2] == 0], colours[corners[:, 2] == 1]
    assert (near[:, 0] - near[:, 1] > far[:, 0] - far[:, 1] + 50).all()  # redder
    low, high = colours[corners[:, 1] == 0], colours[corners[:, 1] == 1]
    assert (grey(high) > grey(low) + 40).all()


def test_colours_are_gradual_but_for_the_squares():
    line = np.column_stack([np.linspace(0, 1, 1001), np.full(1001, 0.5), np.full(1001, 0.5)])
    plain, pattern = (position_colours(line, *BOX, squares=s).astype(int) for s in (False, True))
    assert np.abs(np.diff(plain, axis=0)).max() <= 2
    jumps = (np.abs(np.diff(pattern, axis=0)).max(axis=1) > 8).sum()
    assert jumps == 16  # squares between 16 cells, and the last point opens another


def test_errors_darken_and_unknown_ones_are_grey():
    colours = error_colours(np.array([0.0, 0.5, 1.0, 2.0, 9.0, np.nan, np.inf]), 2.0)
    shades = grey(colours)
    assert shades[0] > shades[1] > shades[2] > shades[3] == shades[4] == shades[6]
    assert tuple(colours[5]) == UNKNOWN


def test_refining_interpolates_linearly():
    fine, values, normals = refined(BALL, 2 * BALL.points, 10_000)
    assert 10_000 <= fine.n < 41_000
    assert fine.area == pytest.approx(BALL.area)
    np.testing.assert_allclose(values, 2 * fine.points, atol=1e-12)
    radial = fine.points / np.linalg.norm(fine.points, axis=1, keepdims=True)
    assert (np.sum(normals * radial, axis=1) > 0.99).all()
    cloud = BALL.as_cloud()
    assert refined(cloud, BALL.points, 10_000)[0] is cloud


def test_behind_is_the_same_outline_mirrored():
    mesh, style = PAIR[0], {"width": 90, "behind": True, "colours": None}
    red = np.full((mesh.n, 3), [200, 80, 40], np.uint8)
    front, behind = draw(mesh, [red], rotation=View("z").rotation(mesh), **style)
    assert (front < 250).any()
    differing = (front < 250).any(axis=2) != (behind[:, ::-1] < 250).any(axis=2)
    assert differing.mean() < 0.01


@pytest.mark.parametrize("as_cloud", [False, True])
def test_the_identity_gives_the_target_the_colours_of_the_source(tmp_path, as_cloud):
    mesh = PAIR[0].as_cloud() if as_cloud else PAIR[0]
    plot_correspondence(
        mesh, mesh, range(mesh.n), path=tmp_path / "map.png", names=("x", "x"), page=Page(dpi=40)
    )
    picture = page(tmp_path / "map.png")[20:]  # below the names
    hue = np.ptp(picture, axis=2) > 12
    assert (np.diff(np.flatnonzero(hue.any(axis=1))) > 3).sum() == 1  # one side, and the other
    columns = np.flatnonzero(hue.any(axis=0))
    gap = columns[np.argmax(np.diff(columns))]
    left, right = picture[:, columns[0] : gap + 1], picture[:, gap + 1 :]
    right = right[:, np.flatnonzero((np.ptp(right, axis=2) > 12).any(axis=0))[0] :]
    np.testing.assert_array_equal(left, right[:, : left.shape[1]])


def test_errors_are_drawn_where_they_are_whatever_the_order_of_the_truth():
    """As many truths as points, in an order of their own: once drawn as noise."""
    source, target, truth = PAIR
    wrong = np.roll(truth, 7)
    order = np.random.default_rng(0).permutation(target.n)
    drawn = [
        MatchedPair(source=source, target=target, point_map=wrong, errors=errors).checked_errors()
        for errors in (
            map_errors(source, wrong, Truth.of_map(truth)),
            map_errors(source, wrong, Truth(truth[order], order)),
        )
    ]
    np.testing.assert_array_equal(*drawn)
    some = map_errors(source, wrong, Truth(truth[[5, 3, 5]], [5, 3, 5])).at_points(target.n)
    assert np.flatnonzero(~np.isnan(some)).tolist() == [3, 5]
    np.testing.assert_array_equal(some[[3, 5]], drawn[0][[3, 5]])


@pytest.mark.parametrize("transfer", ["colours", "texture"])
def test_what_is_not_covered_is_grey(tmp_path, transfer):
    mesh = PAIR[0]
    same, nothing = range(mesh.n), np.zeros(mesh.n, dtype=bool)
    style = {"transfer": transfer, "names": ("x", "x"), "page": Page(dpi=40)}
    plot_correspondence(mesh, mesh, same, path=tmp_path / "map.png", covered=nothing, **style)
    picture = page(tmp_path / "map.png")[20:]
    columns = np.flatnonzero((np.ptp(picture, axis=2) > 12).any(axis=0))
    assert columns.max() < picture.shape[1] / 2  # of the source alone
    assert (picture[:, picture.shape[1] // 2 :] < 210).all(axis=2).mean() > 0.05
    refused("covered", "have shape", plot_correspondence, mesh, mesh, same, covered=nothing[1:])


def test_a_functional_map_is_dark_where_it_is_large(tmp_path):
    plot_functional_map(np.eye(20)[:15], path=tmp_path / "c.png", page=Page(dpi=50))
    matrix = page(tmp_path / "c.png")
    assert (matrix[..., 0] - matrix[..., 2] > 60).sum() > 100  # the diagonal is dark red


# --- classes of points ---


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


def test_there_must_be_one():
    refused("thumbnails", "hold at least one", plot_thumbnails, [])
