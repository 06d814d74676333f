"""Regions: what is cut out is the surface that remains, and values find their way back."""

import numpy as np
import pytest

from spectra_kit import Dense, cotan_laplacian, eigensolve
from spectra_kit.errors import InvalidInputError, SpectraKitWarning
from spectra_kit.geometry import PointCloud, TriangleMesh, rectangle, restrict, sphere

BALL = sphere(subdivisions=3).geometry
CAP = BALL.points[:, 2] > -1e-9


def test_half_of_a_square_has_the_modes_of_a_free_boundary():
    """π² (4 a² + b²) of half a unit square, at a rate of h²."""
    exact = np.pi**2 * np.array([1, 4, 4, 5, 8])
    sizes, errors = [12, 24, 48], []
    for n in sizes:
        x, y = (axis.ravel() for axis in np.mgrid[: n + 1, : n + 1] / n)
        i = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
        a, b, c, d = (part.ravel() for part in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
        square = TriangleMesh(np.c_[x, y, 0 * x], np.r_[np.c_[a, b, c], np.c_[a, c, d]])
        region = restrict(square, x <= 0.5)
        assert region.geometry.area == pytest.approx(0.5)
        values = eigensolve(cotan_laplacian(region.geometry), 6, Dense()).eigenvalues
        errors.append(np.abs(values[1:] / exact - 1).max())
    rate = -np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert rate == pytest.approx(2, abs=0.1)


def test_indices_lead_both_ways():
    region = restrict(BALL, CAP)
    n = region.geometry.n
    np.testing.assert_array_equal(region.geometry.points, BALL.points[region.vertex_index])
    np.testing.assert_array_equal(region.new_index[region.vertex_index], np.arange(n))
    np.testing.assert_array_equal(region.new_index < 0, ~CAP)
    kept = BALL.faces[CAP[BALL.faces].all(axis=1)]
    np.testing.assert_array_equal(region.vertex_index[region.geometry.faces], kept)
    values = np.random.default_rng(0).normal(size=(BALL.n, 3))
    back = region.restore(values[region.vertex_index])
    np.testing.assert_array_equal(back[CAP], values[CAP])
    assert np.isnan(back[~CAP]).all()
    assert region.report.masked_points == (~CAP).sum() == BALL.n - n
    assert region.report.unreferenced_vertices == 0


def test_everything_is_itself_and_told_of():
    with pytest.warns(SpectraKitWarning, match="`keep` leaves out none of 642 points; of labels"):
        region = restrict(BALL, np.ones(BALL.n, bool))
    np.testing.assert_array_equal(region.geometry.faces, BALL.faces)
    np.testing.assert_array_equal(region.vertex_index, np.arange(BALL.n))


def test_points_without_a_face_go_too():
    sheet = rectangle(n=200).geometry
    corner = int(np.argmax(sheet.points[:, 0] + sheet.points[:, 1]))
    keep = sheet.points[:, 0] < 0.5
    keep[corner] = True  # alone
    region = restrict(sheet, keep)
    assert region.new_index[corner] == -1
    assert region.report.unreferenced_vertices == 1
    assert np.isnan(region.restore(np.ones(region.geometry.n))[corner])
    assert len(region.geometry.referenced_vertices) == region.geometry.n


def test_clouds_and_open_edges():
    cloud = restrict(BALL.as_cloud(), CAP)
    assert isinstance(cloud.geometry, PointCloud)
    np.testing.assert_array_equal(cloud.geometry.points, BALL.points[CAP])
    book = TriangleMesh(np.eye(5)[:, :3], [[0, 1, 2], [0, 1, 3], [0, 1, 4]])  # three pages
    two = restrict(book, [True, True, True, True, False])
    np.testing.assert_array_equal(two.geometry.faces, [[0, 1, 2], [0, 1, 3]])


@pytest.mark.parametrize(
    ("keep", "problem"),
    [
        (
            np.arange(9),
            r"True or False of each of 642 points, got shape \(9,\) of int64; of indices",
        ),
        (CAP.astype(int), "of int64"),
        (CAP[:-1], r"shape \(641,\)"),
        (CAP[:, None], r"shape \(642, 1\)"),
        (np.zeros(642, bool), "leave a face"),
        (np.arange(642) == 5, "leave a face"),
    ],
)
def test_masks_that_are_none(keep, problem):
    with pytest.raises(InvalidInputError, match=problem):
        restrict(BALL, keep)


def test_what_the_refusal_of_indices_advises_works():
    indices = np.flatnonzero(CAP)
    region = restrict(BALL, np.isin(np.arange(BALL.n), indices))
    np.testing.assert_array_equal(region.vertex_index, indices)
    with pytest.raises(InvalidInputError, match="leave a point"):
        restrict(PointCloud(BALL.points), np.zeros(BALL.n, bool))
