"""Tangent planes and gradients: exact on planes, right on spheres, by laws elsewhere."""

import numpy as np
import pytest
from conftest import creature, moebius, refused, two_sheets
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from spectra_kit.errors import DoubtfulMatchWarning, InvalidInputError
from spectra_kit.geometry import PointCloud, TriangleMesh, rectangle, sample, sphere
from spectra_kit.operators import divergence, gradient, tangent_gradient
from spectra_kit.operators.tangent import _tangent


def in_space(geometry, values):
    """Gradients as vectors of space, (n, 3)."""
    frames, x, y = tangent_gradient(geometry)
    return np.einsum("in,nir->nr", np.stack([x @ values, y @ values]), frames[:, :2])


@pytest.mark.parametrize("cloud", [False, True])
def test_linear_functions_on_a_plane_have_their_gradients(cloud):
    sheet = rectangle(n=300).geometry
    turn = Rotation.from_euler("xyz", [0.4, -0.7, 1.1]).as_matrix()
    points = 1e-3 * sheet.points @ turn.T + [5, 6, 7]
    shape = PointCloud(points) if cloud else TriangleMesh(points, sheet.faces)
    slope = turn @ [3.0, -2.0, 0.0]  # in the plane
    np.testing.assert_allclose(
        in_space(shape, points @ slope), np.broadcast_to(slope, points.shape), atol=1e-8
    )


@pytest.mark.parametrize("cloud", [False, True])
def test_gradients_on_the_sphere_converge(cloud):
    errors = []
    for level in (2, 3, 4):
        ball = sphere(subdivisions=level).geometry
        x = ball.points
        true = np.array([0, 0, 1.0]) - x[:, 2:] * x  # of the height
        found = in_space(ball.as_cloud() if cloud else ball, x[:, 2])
        errors.append(np.sqrt(((found - true) ** 2).sum(1).mean()))
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (rates > 1.2).all(), (errors, rates)  # of the first order, and better where even
    assert errors[-1] < 4e-3


def test_constants_have_none_windings_do_not_matter_and_units_divide():
    mesh = creature(600)
    assert np.abs(in_space(mesh, np.ones(mesh.n))).max() < 1e-9
    values = np.sin(5 * mesh.points[:, 0])
    found = in_space(mesh, values)
    faces = mesh.faces.copy()
    faces[::3] = faces[::3, [0, 2, 1]]
    np.testing.assert_allclose(in_space(TriangleMesh(mesh.points, faces), values), found, atol=1e-9)
    larger = TriangleMesh(1e6 * mesh.points, mesh.faces)
    np.testing.assert_allclose(1e6 * in_space(larger, values), found, atol=1e-8)


def test_they_turn_with_the_surface():
    cloud = sample(creature(600), 800, seed=0)
    turn = Rotation.from_euler("xyz", [1.0, 0.2, -0.5]).as_matrix()
    values = np.cos(4 * cloud.points[:, 1])
    np.testing.assert_allclose(
        in_space(PointCloud(cloud.points @ turn.T), values),
        in_space(cloud, values) @ turn.T,
        atol=1e-6,
    )


def test_a_point_whose_triangles_have_no_area_is_refused():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [3, 0, 0], [4, 0, 0], [5, 0, 0.0]])
    with pytest.raises(InvalidInputError, match=r"at every point, got none at point 3; repair"):
        tangent_gradient(TriangleMesh(points, [[0, 1, 2], [3, 4, 5]]))


@pytest.mark.parametrize("as_given", ["mesh", "inside out", "cloud"])
def test_oriented_frames_tell_a_ball_from_its_mirror_image(as_given):
    ball = sphere(subdivisions=3).geometry
    shapes = {
        "mesh": ball,
        "inside out": TriangleMesh(ball.points, ball.faces[:, ::-1]),
        "cloud": ball.as_cloud(),
    }
    x, y, z = ball.points.T
    frames, along, across = tangent_gradient(shapes[as_given], oriented=True)
    assert (np.einsum("nr,nr->n", frames[:, 2], ball.points) > 0.999).all()
    np.testing.assert_allclose(np.linalg.det(frames), 1, atol=1e-12)
    orthonormal = np.broadcast_to(np.eye(3), frames.shape)
    np.testing.assert_allclose(frames @ frames.transpose(0, 2, 1), orthonormal, atol=1e-12)
    # On the unit ball n . (grad x x grad y) is z.
    skew = (along @ x) * (across @ y) - (across @ x) * (along @ y)
    np.testing.assert_allclose(skew, z, atol=0.05)


def test_orienting_turns_the_second_axis_alone():
    sheet = creature(600)
    free, held = tangent_gradient(sheet), tangent_gradient(sheet, oriented=True)
    np.testing.assert_allclose(np.linalg.det(free.frames), 1, atol=1e-12)
    signs = np.einsum("nr,nr->n", free.frames[:, 2], held.frames[:, 2])
    np.testing.assert_allclose(np.abs(signs), 1)
    np.testing.assert_array_equal(held.frames[:, 0], free.frames[:, 0])
    assert abs(held.x - free.x).max() == 0
    values = np.sin(5 * sheet.points[:, 0])
    np.testing.assert_allclose(held.y @ values, signs * (free.y @ values), atol=1e-12)


def test_a_face_of_the_other_winding_does_not_turn_normals():
    mesh = creature(600)
    faces = mesh.faces.copy()
    faces[0] = faces[0, ::-1]
    with pytest.warns(DoubtfulMatchWarning, match="1 face wound against the others"):
        mixed = tangent_gradient(TriangleMesh(mesh.points, faces), oriented=True)
    np.testing.assert_allclose(
        mixed.frames[:, 2], tangent_gradient(mesh, oriented=True).frames[:, 2], atol=1e-12
    )


SHAPES = [creature(600), creature(500).as_cloud(), moebius(), two_sheets()]


@pytest.mark.parametrize("shape", SHAPES, ids=["mesh", "cloud", "one-sided", "non-manifold"])
def test_divergence_is_minus_the_adjoint_of_the_gradient(shape):
    rng = np.random.default_rng(0)
    f, vectors = rng.standard_normal(shape.n), rng.standard_normal((shape.n, 3))
    mass = _tangent(shape, 30)[1]
    if isinstance(shape, TriangleMesh):
        mass = np.bincount(shape.faces.ravel(), np.repeat(shape.face_areas, 3)) / 3
    found = mass @ (f * divergence(shape, vectors))
    expected = -mass @ (gradient(shape, f) * vectors).sum(axis=1)
    assert found == pytest.approx(expected, rel=1e-10)
    np.testing.assert_allclose(gradient(shape, f), in_space(shape, f), atol=1e-12)
    normals = tangent_gradient(shape).frames[:, 2]
    np.testing.assert_allclose(
        divergence(shape, vectors + 9 * normals), divergence(shape, vectors), atol=1e-9
    )


def test_divergence_of_linear_fields_on_a_plane_is_exact_inside():
    flat = np.random.default_rng(1).random((300, 2))
    sheet = TriangleMesh(np.c_[flat, 0 * flat[:, 0]], Delaunay(flat).simplices)
    matrix = np.array([[1.0, 2, 0], [-3, 0.5, 0], [0, 0, 0]])
    inside = np.setdiff1d(np.arange(300), sheet.boundary_vertices)
    away = (np.abs(flat - 0.5) < 0.35).all(axis=1)
    for unit in (1e-50, 1.0, 1e50):
        shape = TriangleMesh(unit * sheet.points, sheet.faces)
        found = divergence(shape, sheet.points @ matrix.T)[inside] * unit
        np.testing.assert_allclose(found, 1.5, atol=1e-9)
    cloud = divergence(sheet.as_cloud(), sheet.points @ matrix.T)
    np.testing.assert_allclose(cloud[away], 1.5, atol=1e-9)


@pytest.mark.parametrize("cloud", [False, True])
def test_divergences_on_the_sphere_converge(cloud):
    errors = []
    for level in (2, 3, 4):
        ball = sphere(subdivisions=level).geometry
        x, y, z = ball.points.T
        around = np.stack([-y, x, 0 * x], axis=1)  # has none
        down = np.array([0, 0, 1.0]) - z[:, None] * ball.points  # of which it is -2 z
        found = divergence(ball.as_cloud() if cloud else ball, down + 5 * around)
        errors.append(np.sqrt(np.mean((found + 2 * z) ** 2)))
    assert np.polyfit([2, 3, 4], np.log2(errors), 1)[0] < -0.9, errors


def test_fields_of_another_shape_are_refused():
    mesh = creature(600)
    refused("values", "have shape (600,)", gradient, mesh, np.ones(5))
    refused("vectors", "have shape (600, 3)", divergence, mesh, np.ones((600, 2)))
