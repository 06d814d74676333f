"""Signed distances to curves: closed forms on the plane and the sphere, on any surface."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from spectra_kit.errors import InvalidInputError
from spectra_kit.geodesics import signed_distance
from spectra_kit.geometry import TriangleMesh, sphere


def equator(ball):
    """Its vertices along the equator, eastwards, the first once more."""
    x, y, z = ball.points.T
    on = np.flatnonzero(np.abs(z) < 1e-9)
    on = on[np.argsort(np.arctan2(y, x)[on])]
    return np.append(on, on[0])


def rings(n):
    """A disk of n rings of points, each with six more than the one inside."""
    points, first = [np.zeros((1, 3))], [0]
    for k in range(1, n + 1):
        a = np.arange(6 * k) * np.pi / (3 * k)
        first.append(first[-1] + max(6 * (k - 1), 1))
        points.append(k / n * np.column_stack([np.cos(a), np.sin(a), 0 * a]))
    from scipy.spatial import Delaunay

    points = np.vstack(points)
    faces = Delaunay(points[:, :2]).simplices
    a, b, c = points[faces].transpose(1, 0, 2)
    area = np.cross(b - a, c - a)[:, 2]
    faces = np.where(area[:, None] < 0, faces[:, [0, 2, 1]], faces)[np.abs(area) > 1e-9]
    middle = np.arange(first[n // 2], first[n // 2 + 1])
    return TriangleMesh(points, faces), np.append(middle, middle[0])


@pytest.mark.parametrize("cloud", [False, True])
def test_the_equator_of_a_sphere_has_latitudes(cloud):
    errors = []
    for level in (3, 4, 5):
        ball = sphere(subdivisions=level).geometry
        found = signed_distance(ball.as_cloud() if cloud else ball, equator(ball))
        # To the left of who walks eastwards is the north.
        errors.append(np.abs(found + np.arcsin(ball.points[:, 2])).mean())
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (rates > 0.8).all(), (errors, rates)
    assert errors[-1] < 0.02


@pytest.mark.parametrize("cloud", [False, True])
def test_circles_in_the_plane(cloud):
    errors = []
    for n in (10, 20, 40):
        mesh, circle = rings(n)
        if cloud:  # of which neither side of a flat one is outside
            found = signed_distance(mesh.as_cloud(), circle)
            found = found * -np.sign(found[0])
        else:
            found = signed_distance(mesh, circle)
        errors.append(np.abs(found - (np.linalg.norm(mesh.points, axis=1) - 0.5)).mean())
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (rates > 0.8).all(), (errors, rates)


def test_walking_back_turns_the_sign_and_gaps_do_not_matter():
    ball = sphere(subdivisions=4).geometry
    curve = equator(ball)
    found = signed_distance(ball, curve)
    np.testing.assert_allclose(signed_distance(ball, curve[::-1]), -found, atol=1e-9)
    halves = [curve[:20], curve[25:60]]
    broken = signed_distance(ball, halves)
    far = np.abs(found) > 0.3
    assert (np.sign(broken) == np.sign(found))[far].all()


def test_neither_motion_nor_unit_nor_numbering_nor_winding_matters():
    ball = sphere(subdivisions=3).geometry
    curve, (x, y, z) = equator(ball), ball.points.T
    # At the poles of the sphere vectors cancel, and rounding decides between them.
    ball = ball.with_points(ball.points * (1 + 0.3 * np.sin(2 * x + y) + 0.2 * z)[:, None])
    found = signed_distance(ball, curve)
    turn = Rotation.from_euler("xyz", [1.0, 0.2, -0.5]).as_matrix()
    order = np.random.default_rng(0).permutation(ball.n)
    place = np.argsort(order)
    for unit in (1.0, 1e100, 1e-100):
        points = (unit * ball.points @ turn.T)[order]
        moved = TriangleMesh(points, place[ball.faces][:, [0, 2, 1]])
        again = signed_distance(moved, place[curve])[place] / unit
        np.testing.assert_allclose(again, found, atol=1e-6)


def test_parts_without_a_curve_are_not_reached():
    ball = sphere(subdivisions=2).geometry
    twice = TriangleMesh(
        np.vstack([ball.points, ball.points + 5]), np.vstack([ball.faces, ball.faces + ball.n])
    )
    found = signed_distance(twice, equator(ball))
    np.testing.assert_array_equal(np.isnan(found), np.arange(twice.n) >= ball.n)


def test_as_potpourri3d_on_a_manifold_mesh():
    pp3d = pytest.importorskip("potpourri3d")
    mesh, circle = rings(20)
    mesh = mesh.with_points(mesh.points + np.outer(mesh.points[:, 0] ** 2, [0, 0, 1.0]))
    theirs = pp3d.MeshSignedHeatSolver(np.array(mesh.points), np.array(mesh.faces))
    reference = theirs.compute_distance([[(int(v), []) for v in circle]], [True], [])
    found = signed_distance(mesh, circle)
    reference *= np.sign(reference[0] * found[0])  # by the winding of faces; left is positive
    assert np.abs(found - reference).mean() < 0.01 * np.ptp(found)


def test_curves_that_are_none_are_refused():
    ball = sphere(subdivisions=2).geometry
    for curve in ([3], [3, 3], [[0, 1], [4]], [0, 999], [0.5, 1.5], [], [0, 12, 0]):
        with pytest.raises(InvalidInputError, match="curves"):
            signed_distance(ball, curve)
