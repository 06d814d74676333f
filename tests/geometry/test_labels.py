"""Surfaces of label images: areas and volumes of balls, boxes and cells that touch."""

import numpy as np
import pytest

from spectra_kit.errors import InvalidInputError, SplitSurfaceWarning
from spectra_kit.geometry import TriangleMesh, from_labels


def ball(radius, centre=(0.23, 0.34, 0.06)):
    """A ball of ones, its radius and centre in voxels."""
    n = int(radius) + 3
    x, y, z = np.mgrid[-n : n + 1, -n : n + 1, -n : n + 1] - np.reshape(centre, (3, 1, 1, 1))
    return (x**2 + y**2 + z**2 < radius**2).astype(np.int32)


def enclosed(mesh):
    """The volume that it encloses, positive where it faces outwards."""
    return np.linalg.det((mesh.points - mesh.points.mean(axis=0))[mesh.faces]).sum() / 6


def is_closed(mesh):
    """Whether each edge is passed once in each direction, or as often."""
    sides = mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    forth, back = (np.unique(rows, axis=0, return_counts=True) for rows in (sides, sides[:, ::-1]))
    return all(np.array_equal(one, other) for one, other in zip(forth, back, strict=True))


@pytest.mark.parametrize(("radius", "of_area"), [(3, 0.03), (6, 0.01), (12, 0.01), (24, 0.005)])
def test_a_ball(radius, of_area):
    (found,) = from_labels(ball(radius), spacing=2 / radius)
    assert (found.label, found.is_smooth, is_closed(found.geometry)) == (1, True, True)
    assert abs(found.area / (16 * np.pi) - 1) < of_area
    assert abs(enclosed(found.geometry) / found.volume - 1) < 0.002
    assert found.volume == pytest.approx(32 / 3 * np.pi, rel=0.1 / radius)
    points = found.geometry.points
    distances = np.linalg.norm(points - points.mean(axis=0), axis=1)
    assert np.ptp(distances) < 2 / radius  # a voxel


@pytest.mark.parametrize("spacing", [(2, 1, 1), (1, 2.5, 1), (5, 1, 1), (4, 2, 1), (10, 1, 1)])
@pytest.mark.parametrize(("radius", "of_area"), [(3, 0.03), (6, 0.01), (8, 0.01)])
def test_a_ball_of_long_voxels_has_no_terraces(spacing, radius, of_area):
    """The radius is counted in voxels of the coarsest axis."""
    size = radius * max(spacing)
    x, y, z = np.meshgrid(*(np.arange(-size - s, size + s, s) + 0.3 * s for s in spacing))
    labels = np.moveaxis((x**2 + y**2 + z**2 < size**2).astype(int), 0, 1)
    (found,) = from_labels(labels, spacing=spacing)
    assert found.is_smooth
    of_its_volume = 4 * np.pi * (3 * found.volume / (4 * np.pi)) ** (2 / 3)
    assert abs(found.area / of_its_volume - 1) < of_area
    assert abs(enclosed(found.geometry) / found.volume - 1) < 2 * of_area


def test_cells_at_the_border_and_in_pieces_tell():
    labels = np.zeros((30, 20, 20), int)
    labels[:8, 5:15, 5:15] = 4  # at the border
    labels[10:18, 5:15, 5:15] = 7
    labels[20:28, 5:15, 5:15] = 9
    labels[22, 2, 2] = labels[19, 4, 4] = 9  # both loose: corners alone touch
    with pytest.warns(SplitSurfaceWarning, match="1 of 3 labels, such as 9 of 3 pieces"):
        found = from_labels(labels)
    assert [one.touches_border for one in found] == [True, False, False]
    assert [one.n_pieces for one in found] == [1, 1, 3]
    labels[12:15, 8:12, 8:12] = 0  # a cave is no piece
    (found,) = from_labels(labels, labels=[7])
    assert found.n_pieces == 1


def test_a_box_loses_its_edges_alone():
    sizes = np.array([8, 16, 32, 64])
    errors = []
    for n in sizes:
        (found,) = from_labels(np.ones((n, n, n), bool), spacing=1 / n)
        assert found.volume == pytest.approx(1)
        assert enclosed(found.geometry) == pytest.approx(1, rel=0.01)
        assert is_closed(found.geometry)  # though it fills the image
        errors.append(abs(found.area / 6 - 1))
    rate = -np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert rate == pytest.approx(1, abs=0.05)


@pytest.mark.parametrize("scale", [1e-150, 1e-9, 1.0, 1e9])
def test_units_scale(scale):
    labels = ball(5)
    (one,), (other,) = from_labels(labels), from_labels(labels, spacing=scale)
    np.testing.assert_allclose(other.geometry.points, one.geometry.points * scale)
    assert other.area / scale == pytest.approx(one.area * scale)
    if scale > 1e-100:
        assert other.volume == pytest.approx(one.volume * scale**3)


def test_cells_that_touch_share_their_border():
    whole = ball(8)
    x = np.arange(whole.shape[0])[:, None, None]
    cells = whole * np.where(x < 11, -3, 200)  # any numbers
    (left, right) = from_labels(cells)
    assert (left.label, right.label) == (-3, 200)
    for cell in (left, right):
        assert is_closed(cell.geometry)
        assert enclosed(cell.geometry) == pytest.approx(cell.volume, rel=0.005)
    shared = {*map(tuple, left.geometry.points)} & {*map(tuple, right.geometry.points)}
    assert len(shared) > 150  # about that many voxels are in a section
    (alone,) = from_labels(cells, labels=[200])
    assert alone.volume == right.volume
    assert alone.volume + left.volume == whole.sum()


def test_all_parts_stay_and_caves_too():
    labels = np.zeros((40, 20, 20), int)
    labels[2:18, 2:18, 2:18] = labels[22:38, 2:18, 2:18] = 4
    labels[7:13, 7:13, 7:13] = 0
    with pytest.warns(SplitSurfaceWarning, match="1 of 1 label, such as 4 of 2 pieces"):
        (found,) = from_labels(labels)
    assert len(np.unique(found.geometry.component_labels)) == 3
    assert is_closed(found.geometry)
    assert enclosed(found.geometry) == pytest.approx(2 * 16**3 - 6**3, rel=0.01)


def test_spacing_along_each_axis_and_where_it_lies():
    (found,) = from_labels(np.pad(np.ones((30, 20, 10), int), 3), spacing=(0.5, 1, 2))
    low, high = found.geometry.points.min(axis=0), found.geometry.points.max(axis=0)
    # From half a voxel before the third, within another that smoothing may move corners.
    assert (np.abs(low - [1.25, 2.5, 5]) < [0.5, 1, 2]).all()
    assert (np.abs(high - low - [15, 20, 20]) < [1, 2, 4]).all()
    assert found.volume == pytest.approx(6000)


@pytest.mark.parametrize("mirror", [1, -1])
def test_images_of_nibabel(mirror):
    nibabel = pytest.importorskip("nibabel")
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    affine = np.eye(4)
    affine[:3, :3] = turn * np.sign(np.linalg.det(turn)) @ np.diag([mirror, 2, 0.5])
    affine[:3, 3] = 7, -20, 90
    image = nibabel.Nifti1Image(ball(6), affine)
    (found,), (plain,) = from_labels(image), from_labels(ball(6), spacing=(1, 2, 0.5))
    moved = affine[:3, :3] / [1, 2, 0.5]
    np.testing.assert_allclose(
        found.geometry.points, plain.geometry.points @ moved.T + affine[:3, 3], atol=1e-9
    )
    assert found.volume == pytest.approx(plain.volume)
    assert enclosed(found.geometry) == pytest.approx(enclosed(plain.geometry))
    with pytest.raises(InvalidInputError, match="`spacing` must be left out"):
        from_labels(image, spacing=2)
    grey = nibabel.Nifti1Image(ball(6).astype("f4"), affine)
    with pytest.raises(
        InvalidInputError, match=r"hold integers.* nibabel\.Nifti1Image.* has integers"
    ):
        from_labels(grey)
    again = nibabel.Nifti1Image(grey.get_fdata().astype("i4"), grey.affine)  # as it advises
    np.testing.assert_array_equal(from_labels(again)[0].geometry.points, found.geometry.points)


@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 1, 1), (2, 2, 2), (1, 30, 1)])
def test_a_few_voxels_keep_their_stairs(shape):
    (found,) = from_labels(np.ones(shape, np.uint8), spacing=3)
    a, b, c = shape
    assert not found.is_smooth
    assert is_closed(found.geometry)
    assert found.volume == 27 * a * b * c == pytest.approx(enclosed(found.geometry))
    assert found.area == pytest.approx(18 * (a * b + b * c + c * a))


def test_noise_of_many_labels_is_closed():
    labels = np.random.default_rng(1).integers(0, 5, (9, 10, 11))
    with pytest.warns(SplitSurfaceWarning, match="4 of 4 labels"):
        found = from_labels(labels)
    assert [one.label for one in found] == [1, 2, 3, 4]
    for one in found:
        assert isinstance(one.geometry, TriangleMesh)
        assert is_closed(one.geometry)
        assert one.volume == (labels == one.label).sum()
        assert abs(enclosed(one.geometry) / one.volume - 1) <= 0.1


GREY = ball(3) * 0.5
HOLES = np.where(ball(3), 1.0, np.nan)


@pytest.mark.parametrize(
    ("image", "options", "problem"),
    [
        (GREY, {}, r"hold integers.*dtype float64; if its numbers are whole, image\.astype\(int\)"),
        (HOLES, {}, "hold integers"),
        (ball(3)[0], {}, r"have three axes.*got shape \(13, 13\)"),
        (ball(3)[None], {}, r"got shape \(1, 13, 13, 13\); of a series"),
        (0 * ball(3), {}, "hold a label, got nothing but 0"),
        (np.empty((0, 3, 3), int), {}, "voxels along each"),
        (ball(3), {"spacing": 0}, "`spacing` must be positive"),
        (ball(3), {"spacing": (1, 2)}, "`spacing` must be a number, or three"),
        (ball(3), {"spacing": (1, np.nan, 1)}, "`spacing` must be finite"),
        (ball(3), {"labels": [2]}, "be in the image, and not 0, got 2"),
        (ball(3), {"labels": [0]}, "be in the image, and not 0, got 0"),
    ],
)
def test_what_holds_no_labels(image, options, problem):
    with pytest.raises(InvalidInputError, match=problem):
        from_labels(image, **options)
