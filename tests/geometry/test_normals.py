"""Normals of point clouds, and the signs under them."""

import numpy as np
import pytest
from conftest import ball, creature
from scipy import sparse
from scipy.spatial.transform import Rotation

from spectra_kit import PointCloud
from spectra_kit.geometry import estimate_normals, orient_normals, torus
from spectra_kit.geometry.normals import (
    agree_on_signs,
    symmetric_votes,
    turn_outwards,
)


def oriented(points: np.ndarray) -> np.ndarray:
    """Normals estimated, turned at random, and then outwards."""
    cloud = PointCloud(points)
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (len(points), 1))
    return orient_normals(cloud, estimate_normals(cloud) * signs)


# --- normals ----------------------------------------------------------------------------------


def test_on_a_plane_they_are_exact_and_in_any_direction() -> None:
    flat = np.c_[np.random.default_rng(0).random((50, 2)), np.zeros(50)]
    turn = Rotation.random(rng=np.random.default_rng(1)).as_matrix()
    normals = estimate_normals(PointCloud(flat @ turn.T + 3))
    assert np.allclose(np.abs(normals @ turn[:, 2]), 1, atol=1e-12)


def test_the_error_on_a_sphere_falls_with_the_spacing() -> None:
    error = [
        np.sqrt(1 - np.sum(estimate_normals(PointCloud(p)) * p, axis=1) ** 2).mean()
        for p in (ball(500), ball(4000))
    ]
    assert error[0] < 0.06
    assert error[1] < error[0] / 2  # a third of the spacing


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_bodies_are_oriented_outwards_wherever_they_are(mirror: float) -> None:
    one = ball(500) * [1, 2, 3 * mirror] * 50
    two = 0.5 * ball(200, 1)
    normals = oriented(np.vstack([one + [1e3, 0, 0], two]))
    assert (np.sum(normals * np.vstack([one, two]), axis=1) > 0).all()


def test_a_torus_and_an_animal_are_oriented_like_their_meshes() -> None:
    for mesh, right in ((torus(n=900).geometry, 1.0), (creature(1500), 0.98)):
        truth = np.zeros((mesh.n, 3))
        corners = mesh.points[mesh.faces]
        face_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        np.add.at(truth, mesh.faces, face_normals[:, None])
        assert (np.sum(oriented(mesh.points) * truth, axis=1) > 0).mean() >= right


def test_two_sheets_farther_apart_than_their_points_are_told_apart() -> None:
    rng, gap = np.random.default_rng(0), 0.1
    top, bottom = rng.random((2, 900, 2))  # a spacing of about 0.033
    points = np.vstack([np.c_[top, np.full(900, gap)], np.c_[bottom, np.zeros(900)]])
    up = np.sign(points[:, 2] - gap / 2)
    assert (oriented(points)[:, 2] * up > 0).mean() >= 0.97


# --- signs ------------------------------------------------------------------------------------


def test_groups_vote_together_against_one_loud_edge() -> None:
    # Two rings of points; six quiet votes between them outweigh a loud one, which a spanning tree
    # would follow.
    ring = np.arange(6)
    i = np.r_[ring, ring + 6, ring, 0]
    j = np.r_[(ring + 1) % 6, (ring + 1) % 6 + 6, ring + 6, 9]
    votes = symmetric_votes(12, i, j, np.r_[np.full(12, 5.0), np.full(6, 0.5), -2.0])
    signs, labels = agree_on_signs(votes)
    assert (labels == 0).all()
    assert len(np.unique(signs)) == 1


def test_a_limb_inside_out_is_turned() -> None:
    points = ball(1500) * [1, 1, 4]
    vectors = ball(1500) * [4, 4, 1] * (4 * np.pi / 1500)
    signs = np.where(points[:, 2] > 1.5, -1.0, 1.0)
    votes = sparse.csr_array((1500, 1500))
    turned = turn_outwards(points, vectors, signs, np.zeros(1500, dtype=np.int64), votes)
    assert (turned == 1).mean() > 0.995


@pytest.mark.parametrize("exponent", [-1000, 1000])
def test_powers_of_two_change_no_bit(exponent: int) -> None:
    points = ball(300)
    normals = estimate_normals(PointCloud(points))
    scaled = PointCloud(np.ldexp(points, exponent))
    np.testing.assert_array_equal(estimate_normals(scaled), normals)
    outwards = orient_normals(PointCloud(points), normals)
    np.testing.assert_array_equal(orient_normals(scaled, normals), outwards)
