"""Vectors carried along surfaces: constant where flat, by closed forms on spheres."""

import warnings

import numpy as np
import pytest
from conftest import creature
from scipy.spatial.transform import Rotation

from spectra_kit.errors import DoubtfulDistanceWarning, InvalidInputError
from spectra_kit.geodesics import (
    FacePoint,
    VectorHeat,
    exact_distances,
    smoothest_field,
    transport_vectors,
)
from spectra_kit.geometry import PointCloud, TriangleMesh, rectangle, sphere, torus
from spectra_kit.operators import tangent_frames


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def between(a, b):
    """Angles between vectors."""
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1))


def nearest(points, target):
    return int(np.argmin(np.linalg.norm(points - target, axis=1)))


def carried_on_sphere(x, p, v):
    """Vectors at the points x of the unit sphere, carried along great circles from p."""
    return v - ((x @ v) / (1 + x @ p))[:, None] * (x + p)


@pytest.mark.parametrize("cloud", [False, True])
def test_on_a_plane_vectors_stay_as_they_are(cloud):
    turn = Rotation.from_euler("xyz", [0.4, -0.7, 1.1]).as_matrix()
    sheet = rectangle(n=300).geometry
    sheet = sheet.with_points(1e3 * sheet.points @ turn.T + [5, 6, 7])
    vector = turn @ [3, -4, 0]
    found = transport_vectors(sheet.as_cloud() if cloud else sheet, 17, [vector])
    np.testing.assert_allclose(found, np.broadcast_to(vector, found.shape), atol=1e-6)


def test_on_a_cylinder_they_turn_with_it():
    angle, height = np.meshgrid(
        np.linspace(0, 2 * np.pi, 60, endpoint=False), np.linspace(0, 2, 21)
    )
    a, h = angle.ravel(), height.ravel()
    points = np.column_stack([np.cos(a), np.sin(a), h])
    i, k = np.meshgrid(np.arange(20), np.arange(60), indexing="ij")
    p, q = 60 * i + k, 60 * i + (k + 1) % 60
    faces = np.concatenate([np.stack([p, q, p + 60], -1), np.stack([q, q + 60, p + 60], -1)])
    mesh = TriangleMesh(points, faces.reshape(-1, 3))
    around = np.column_stack([-np.sin(a), np.cos(a), 0 * a])
    up = np.broadcast_to([0, 0, 1.0], around.shape)
    source = nearest(points, [1, 0, 1])
    found = transport_vectors(mesh, source, [2 * around[source] + up[source]])
    np.testing.assert_allclose(found, 2 * around + up, atol=1e-3)


def balls(cloud):
    """Unit spheres of rising resolution; or as many random points, of which no star is even."""
    for level in (3, 4, 5):
        ball = sphere(subdivisions=level).geometry
        random = np.random.default_rng(1).standard_normal((ball.n, 3))
        yield PointCloud(unit(random)) if cloud else ball


def rate(errors):
    """The power of the edge by which errors fall, as edges are halved."""
    return -np.polyfit(np.arange(len(errors)), np.log2(errors), 1)[0]


@pytest.mark.parametrize("cloud", [False, True])
def test_on_the_sphere_they_follow_great_circles(cloud):
    errors = []
    for ball in balls(cloud):
        source = nearest(ball.points, unit(np.array([0.3, -0.5, 0.8])))
        p = ball.points[source]
        seen = ball.points @ p > -0.7  # beyond, ways around the other side are as short
        vector = np.cross(p, [1.0, 2.0, 3.0])
        found = transport_vectors(ball, source, [vector])
        np.testing.assert_allclose(np.linalg.norm(found, axis=1), np.linalg.norm(found[source]))
        errors.append(between(found[seen], carried_on_sphere(ball.points[seen], p, vector)).mean())
    # Where triangles are even, nothing is left but what the paths of heat prefer.
    assert rate(errors) > 0.8 if cloud else max(errors) < 0.003, errors
    assert errors[-1] < 0.01


@pytest.mark.parametrize("cloud", [False, True])
def test_around_an_octant_they_turn_by_its_area(cloud):
    ball = sphere(subdivisions=4).geometry
    heat = VectorHeat(ball.as_cloud() if cloud else ball)
    corners = [nearest(ball.points, axis) for axis in np.eye(3)]
    # Away from the axes, where rounding of a mesh decides nothing.
    start = unit(np.array([0, 1.0, 0.4]))
    vector = start
    for one, other in ((0, 1), (1, 2), (2, 0)):
        vector = heat.transport(corners[one], [vector])[corners[other]]
    assert abs(between(vector, start) - np.pi / 2) < 0.03
    assert np.cross(start, vector)[0] > 0  # counter-clockwise, as it was walked


def test_many_sources_serve_the_points_next_to_them_and_lengths_with_them():
    sheet = rectangle(n=600, width=2.0, height=1.0).geometry
    left, right = nearest(sheet.points, [0, 0.5, 0]), nearest(sheet.points, [2, 0.5, 0])
    found = transport_vectors(sheet, [left, right], [[1, 0, 0], [0, 5, 0]])
    x = sheet.points[:, 0]
    np.testing.assert_allclose(
        found[x < 0.7], np.broadcast_to([1, 0, 0], found[x < 0.7].shape), atol=0.05
    )
    np.testing.assert_allclose(
        found[x > 1.3], np.broadcast_to([0, 5, 0], found[x > 1.3].shape), atol=0.05
    )
    swapped = transport_vectors(sheet, [right, left], [[0, 5, 0], [1, 0, 0]])
    np.testing.assert_allclose(swapped, found, atol=1e-9)


def test_values_are_those_of_the_nearest_and_stay_in_their_range():
    mesh = creature(2000)
    places = [0, 700, 1500]
    values = np.array([[1.0, -3e200], [2.0, 0.0], [-5.0, 3e200]])
    found = VectorHeat(mesh).extend(places, values)
    away = np.stack([exact_distances(mesh, one) for one in places])
    first, second = np.sort(away, axis=0)[:2]
    clear = second - first > 0.15 * away.max()
    assert clear.mean() > 0.5
    best = values[away.argmin(axis=0)]
    np.testing.assert_allclose(found[clear] / [1, 1e200], best[clear] / [1, 1e200], atol=0.05)
    assert (found >= values.min(axis=0)).all()
    assert (found <= values.max(axis=0)).all()


def test_a_source_inside_a_face_is_like_its_corners():
    ball = sphere(subdivisions=4).geometry
    point = FacePoint(100, (1 / 3, 1 / 3, 1 / 3))
    p = unit(point.position(ball))
    vector = np.cross(p, [1.0, 2.0, 3.0])
    found = transport_vectors(ball, point, [vector])
    seen = ball.points @ p > -0.7
    assert between(found[seen], carried_on_sphere(ball.points[seen], p, vector)).max() < 0.1
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), np.linalg.norm(vector), rtol=1e-3)


def test_neither_motion_nor_unit_nor_numbering_nor_winding_matters():
    mesh = creature(520)
    vector = tangent_frames(mesh).axes[3, 0]
    found = transport_vectors(mesh, 3, [vector])
    turn = Rotation.from_euler("xyz", [1.0, 0.2, -0.5]).as_matrix()
    order = np.random.default_rng(0).permutation(mesh.n)
    place = np.argsort(order)
    faces = place[mesh.faces]
    faces[::3] = faces[::3, [0, 2, 1]]
    moved = TriangleMesh((1e100 * mesh.points @ turn.T)[order], faces)
    np.testing.assert_allclose(
        transport_vectors(moved, int(place[3]), [turn @ vector])[place] @ turn, found, atol=1e-6
    )
    tiny = mesh.with_points(1e-100 * mesh.points)
    np.testing.assert_allclose(transport_vectors(tiny, 3, [vector]), found, atol=1e-9)


@pytest.mark.parametrize("cloud", [False, True])
def test_the_logarithm_is_the_inverse_of_walking_straight(cloud):
    """On the unit sphere, ``exp_p(v) = cos |v| p + sin |v| v / |v|``."""
    errors = []
    for ball in balls(cloud):
        x = ball.points
        source = nearest(x, unit(np.array([0.3, -0.5, 0.8])))
        v = VectorHeat(ball).logarithm(source)
        length = np.linalg.norm(v, axis=1, keepdims=True)
        end = np.cos(length) * x[source] + np.sinc(length / np.pi) * v
        seen = x @ x[source] > -0.7
        errors.append(np.linalg.norm(end - x, axis=1)[seen].mean())
    assert rate(errors) > 0.85, errors
    assert errors[-1] < 0.01


def test_the_logarithm_of_a_plane_is_the_way_there():
    sheet = rectangle(n=900).geometry
    source = nearest(sheet.points, [0.4, 0.7, 0])
    found, true = VectorHeat(sheet).logarithm(source), sheet.points - sheet.points[source]
    np.testing.assert_allclose(found, true, atol=1e-6)


def test_smoothest_fields():
    flat = smoothest_field(rectangle(n=200).geometry)
    np.testing.assert_allclose(flat, np.broadcast_to(flat[0], flat.shape), atol=1e-6)
    ball = sphere(subdivisions=3).geometry
    twice = TriangleMesh(
        np.vstack([ball.points, 1e-3 * ball.points + 5]),
        np.vstack([ball.faces, ball.faces + ball.n]),
    )
    field = smoothest_field(twice)
    for part in (field[: ball.n], field[ball.n :]):
        np.testing.assert_allclose((part**2).sum(axis=1).mean(), 1, rtol=0.02)
        assert np.linalg.norm(part, axis=1).min() < 0.2  # it has a zero, as all of them


def test_what_is_not_reached_is_told():
    ball = sphere(subdivisions=2).geometry
    twice = TriangleMesh(
        np.vstack([ball.points, ball.points + 5]), np.vstack([ball.faces, ball.faces + ball.n])
    )
    heat = VectorHeat(twice)
    vector = np.cross(ball.points[0], [1.0, 2, 3])
    for found in (heat.transport(0, [vector]), heat.logarithm(0), heat.extend(0, [[3.0]])):
        np.testing.assert_array_equal(np.isnan(found).any(axis=1), np.arange(twice.n) >= ball.n)
    n = 3000
    x = np.arange(n)
    points = np.concatenate([np.stack([x, y + 0 * x, 0 * x], axis=1) for y in (0, 1)])
    faces = np.concatenate(
        [np.stack([x[:-1], x[1:], x[:-1] + n], 1), np.stack([x[1:], x[1:] + n, x[:-1] + n], 1)]
    )
    long = TriangleMesh(points, faces)
    with pytest.warns(DoubtfulDistanceWarning, match="too many edges away"):
        found = transport_vectors(long, 0, [[1, 0, 0]])
    assert np.isnan(found).any()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = VectorHeat(long, time_coefficient=100.0).transport(0, [[1, 0, 0]])
    np.testing.assert_allclose(found, np.broadcast_to([1, 0, 0], found.shape), atol=1e-6)


def test_places_and_vectors_that_do_not_fit_are_refused():
    ball = sphere(subdivisions=2).geometry
    heat = VectorHeat(ball)
    for vectors, told in (
        ([[1, 0]], "shape"),
        ([[0, 0, 0]], "along"),
        ([3 * ball.points[0]], "along"),
    ):
        with pytest.raises(InvalidInputError, match=told):
            heat.transport(0, vectors)
    for call in (lambda: heat.transport([], np.empty((0, 3))), lambda: heat.extend([], [])):
        with pytest.raises(InvalidInputError, match="at least one"):
            call()
    with pytest.raises(InvalidInputError, match="source"):
        heat.logarithm(ball.n)


def test_as_potpourri3d_on_manifold_meshes():
    pp3d = pytest.importorskip("potpourri3d")
    mesh = torus(n=3000).geometry
    theirs = pp3d.MeshVectorHeatSolver(np.array(mesh.points), np.array(mesh.faces))
    x, y, _ = theirs.get_tangent_frames()
    found = theirs.transport_tangent_vector(5, [0.6, 0.8])
    reference = found[:, [0]] * x + found[:, [1]] * y
    ours = transport_vectors(mesh, 5, [0.6 * x[5] + 0.8 * y[5]])
    assert np.median(between(ours, reference)) < 0.01
    assert np.quantile(between(ours, reference), 0.9) < 0.05
