"""The canonical frame must not see rigid motions, sizes or point order."""

import numpy as np
import pytest
from conftest import refused

from spectra_kit.eigen.subspaces.frame import POSES, canonical_frame


@pytest.fixture
def cloud():
    """A generic cloud: distinct variances, clear third moments, uneven masses."""
    rng = np.random.default_rng(0)
    points = rng.gamma(1.5, [3.0, 2.0, 1.0], size=(500, 3))
    return points, rng.uniform(0.5, 2.0, 500)


@pytest.mark.parametrize("size", [1e-3, 1e6])
def test_rigid_motion_scale_and_order_leave_the_pose(cloud, size):
    points, mass = cloud
    rng = np.random.default_rng(1)
    posed = canonical_frame(points, mass).pose(points)
    for _ in range(5):
        Q = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        Q[:, 0] *= np.linalg.det(Q)
        order = rng.permutation(len(points))
        moved = size * (points[order] @ Q.T + rng.standard_normal(3) * 10)
        frame = canonical_frame(moved, 3.0 * mass[order])
        np.testing.assert_allclose(frame.pose(moved), posed[order], atol=1e-9)
        np.testing.assert_allclose(np.linalg.det(frame.rotation), 1.0)


def test_pose_is_centred_decorrelated_and_fits_the_cube(cloud):
    points, mass = cloud
    posed = canonical_frame(points, mass).pose(points)
    weights = mass / mass.sum()
    np.testing.assert_allclose(weights @ posed, 0, atol=1e-12)
    covariance = posed.T @ (weights[:, None] * posed)
    np.testing.assert_allclose(covariance, np.diag(np.diag(covariance)), atol=1e-12)
    assert (np.diff(np.diag(covariance)) < 0).all()
    assert np.abs(posed).max() == pytest.approx(1.0, abs=1e-14)
    # A point that is split with its mass changes nothing.
    halves = np.r_[mass[:100] / 2, mass[100:], mass[:100] / 2]
    one, other = canonical_frame(points, mass), canonical_frame(np.r_[points, points[:100]], halves)
    np.testing.assert_allclose(one.rotation, other.rotation, atol=1e-12)


def test_poses_are_the_four_proper_flips():
    assert len(np.unique(POSES, axis=0)) == 4
    np.testing.assert_array_equal(POSES.prod(axis=1), 1.0)
    np.testing.assert_array_equal(np.abs(POSES), 1.0)


def test_symmetric_clouds_get_a_proper_frame_twice_the_same():
    corners = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(-1, 3)
    line = np.outer([0.0, 1.0, 5.0], [1.0, 2.0, 2.0])
    for points in (corners, line):
        first, second = (canonical_frame(points, np.ones(len(points))) for _ in range(2))
        np.testing.assert_array_equal(first.rotation, second.rotation)
        np.testing.assert_allclose(first.rotation @ first.rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(first.rotation) == pytest.approx(1.0)
    posed = first.pose(line)  # lies on the first axis
    np.testing.assert_allclose(posed[:, 1:], 0, atol=1e-12)
    assert posed[:, 0].max() == pytest.approx(1.0)


@pytest.mark.parametrize("points", [[[1.0, 2.0, 3.0]], [[1e6, 0.0, 0.0]] * 7, [[0.0, 0.0, 0.0]]])
def test_a_single_location_is_refused(points):
    refused("points", "not share one location", canonical_frame, points, np.ones(len(points)))
