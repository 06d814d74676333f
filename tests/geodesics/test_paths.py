"""Paths on triangles: planes, cubes, cones, cylinders, spheres by hand; any mesh by length."""

import warnings

import igl
import numpy as np
import pytest
from conftest import bumpy, creature, joined, moebius, moved, refused
from geodesic_truths import by_libigl, cube
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from test_exact_distances import LONE, square

from spectra_kit.errors import DoubtfulDistanceWarning
from spectra_kit.geodesics import (
    FacePoint,
    GeodesicPaths,
    exact_distances,
    farthest_point_sampling,
    geodesic_path,
    logarithmic_map,
    nearest_source,
    shortened_path,
    trace_geodesic,
)
from spectra_kit.geometry import PointCloud, TriangleMesh, rectangle, sphere, torus


def check_on_surface(mesh, path, rtol=1e-9):
    """Each segment lies in its face, and the weights of its points are theirs."""
    corners = mesh.points[mesh.faces[path.faces]]
    size = np.ptp(mesh.points, axis=0).max()
    at = np.einsum("pc,pcr->pr", path.barycentric, corners)
    np.testing.assert_allclose(at, path.points, atol=rtol * size)
    np.testing.assert_allclose(path.barycentric.sum(axis=1), 1, atol=1e-12)
    assert path.barycentric.min() >= -1e-12
    for triangle, point in zip(corners[:-1], path.points[1:], strict=True):
        away, *_ = igl.point_mesh_squared_distance(point[None], triangle, np.array([[0, 1, 2]]))
        assert np.sqrt(away) < rtol * size


def check_shortest(mesh, sources, targets=None):
    paths, distances = GeodesicPaths(mesh, sources), exact_distances(mesh, sources)
    np.testing.assert_array_equal(paths.distances, distances)
    starts = mesh.points[np.atleast_1d(sources)]
    for target in np.flatnonzero(np.isfinite(distances)) if targets is None else targets:
        path = paths.to(int(target))
        check_on_surface(mesh, path)
        assert (path.points[0] == starts).all(axis=1).any()
        np.testing.assert_array_equal(path.points[-1], mesh.points[target])
        np.testing.assert_allclose(path.length, distances[target], rtol=1e-9)


# --- shortest paths ---


def test_on_a_plane_they_are_straight():
    mesh = square()
    check_shortest(mesh, 17)
    path = geodesic_path(mesh, 17, 40)
    way = mesh.points[40] - mesh.points[17]
    share = path.lengths / path.length
    np.testing.assert_allclose(path.points, mesh.points[17] + share[:, None] * way, atol=1e-12)
    assert len(path) > 4


def test_where_faces_have_no_area_they_are_found_too():
    check_shortest(square(caps=10), 0)


def test_between_points_of_faces_they_are_straight():
    mesh, rng = square(), np.random.default_rng(1)
    weights = rng.dirichlet([1, 1, 1], 12)
    weights[:2] = [[0, 0.3, 0.7], [0, 1, 0]]  # on an edge, at a corner
    faces = rng.integers(0, len(mesh.faces), 12)
    faces[5:8] = faces[4]  # several in one face
    points = [FacePoint(int(f), w) for f, w in zip(faces, weights, strict=True)]
    paths = GeodesicPaths(mesh, points[4], targets=points)
    for point in points:
        path, start, end = paths.to(point), points[4].position(mesh), point.position(mesh)
        check_on_surface(mesh, path)
        np.testing.assert_allclose(path.points[[0, -1]], [start, end], atol=1e-12)
        np.testing.assert_allclose(path.length, np.linalg.norm(end - start), atol=1e-12)
    whole = exact_distances(mesh, points[:6])
    singly = [np.linalg.norm(mesh.points - p.position(mesh), axis=1) for p in points[:6]]
    np.testing.assert_allclose(whole, np.min(singly, axis=0), atol=1e-12)


def test_over_a_cube_they_unfold():
    path = geodesic_path(cube(), 0, 7)
    np.testing.assert_allclose(path.length, np.sqrt(5))
    middle = path.points[np.argmin(abs(path.lengths - path.length / 2))]
    assert sorted(middle.round(12)) in ([0, 0.5, 1], [0.5, 0.5, 1], [0, 0.5, 0.5])
    check_shortest(cube(), 0)


def test_any_mesh_has_paths_as_long_as_its_distances():
    book = TriangleMesh(
        [[0, 0, 0], [0, 0, 1], [1, 0, 0.5], [-1, 0, 0.5], [0, 1, 0.5]],
        [[0, 1, 2], [0, 1, 3], [0, 1, 4]],
    )
    mesh, rng = square(), np.random.default_rng(0)
    flaps = np.column_stack([mesh.faces[:30, :2], rng.integers(0, mesh.n, 30)])
    flaps = flaps[(flaps[:, 2:] != flaps[:, :2]).all(axis=1)]
    soup = TriangleMesh(mesh.points, np.concatenate([mesh.faces, flaps]))
    assert soup.unique_edges[1].max() >= 3
    for shape in (book, soup, moebius(), joined(bumpy(162), square())):
        check_shortest(shape, 2)
        check_shortest(shape, [0, 3])


def test_bumps_bend_them():
    check_shortest(bumpy(), 5)
    animal = creature(600, seed=1)
    faces = animal.faces.copy()
    faces[::2] = faces[::2, ::-1]
    check_shortest(TriangleMesh(animal.points, faces), 7)


def test_scale_and_order_change_nothing():
    mesh = bumpy()
    path, other = (
        geodesic_path(mesh, 5, 600),
        geodesic_path(mesh.with_points(1e-90 * mesh.points), 5, 600),
    )
    np.testing.assert_allclose(other.points, 1e-90 * path.points, rtol=1e-9, atol=1e-99)
    np.testing.assert_array_equal(other.faces, path.faces)
    back = geodesic_path(mesh, 600, 5)
    np.testing.assert_allclose(back.points[::-1], path.points, atol=1e-9)


def test_real_shapes(real_shapes):
    from spectra_kit.geometry import read

    for name in ("spot", "cow", "fandisk"):
        mesh = read(real_shapes / f"{name}.npz", kind="mesh")
        source = int(mesh.referenced_vertices[0])
        check_shortest(mesh, source, mesh.referenced_vertices[1 :: mesh.n // 20])
        truth = by_libigl(mesh, source)
        found = exact_distances(mesh, source)
        assert (found <= truth * (1 + 1e-6)).all()  # which does not pass where fans meet
        if name != "cow":
            np.testing.assert_allclose(found, truth, rtol=1e-6)


# --- exponential and logarithmic map ---


def test_on_a_plane_tracing_adds():
    mesh = square()
    inner = int(np.argmin(np.linalg.norm(mesh.points - mesh.points[:60].mean(axis=0), axis=1)))
    axes = logarithmic_map(mesh, inner).axes
    for turn in np.linspace(0, 6, 9):
        step = 0.2 * np.array([np.cos(turn), np.sin(turn)]) @ axes
        path = trace_geodesic(mesh, inner, step)
        check_on_surface(mesh, path)
        np.testing.assert_allclose(path.points[-1], mesh.points[inner] + step, atol=1e-12)
    found = logarithmic_map(mesh, inner)
    away = mesh.points - mesh.points[inner]
    np.testing.assert_allclose(found.coordinates @ axes, away, atol=1e-12)


def cylinder(turns=40, rows=30):
    i, j = (index.ravel() for index in np.indices((rows, turns)))
    angle = 2 * np.pi * (j + 0.5 * (i % 2)) / turns
    points = np.column_stack([np.cos(angle), np.sin(angle), 0.12 * i])
    k = np.arange(turns)
    faces = []
    for row in range(rows - 1):
        a, b = row * turns + k, row * turns + (k + 1) % turns
        c, d = a + turns, b + turns
        faces += [[a, b, c], [b, d, c]] if row % 2 == 0 else [[a, b, d], [a, d, c]]
    return TriangleMesh(points, np.hstack(faces).T)


def test_around_a_cylinder_tracing_winds():
    mesh = cylinder()
    start = 2 * 40  # of an even row; a full turn along the row is the way around a polygon
    around = 40 * 2 * np.sin(np.pi / 40)
    ring = trace_geodesic(mesh, start, np.cross([0, 0, 1], mesh.points[start]), length=around)
    check_on_surface(mesh, ring)
    np.testing.assert_allclose(ring.points[-1], mesh.points[start], atol=1e-9)


def test_on_the_sphere_tracing_follows_great_circles():
    errors = []
    for subdivisions in (3, 4, 5):
        ball = sphere(subdivisions=subdivisions).geometry
        towards = np.cross(ball.points[9], [0.3, 0.2, 1])
        towards /= np.linalg.norm(towards)
        path = trace_geodesic(ball, 9, towards, length=2.0)
        end = np.cos(2.0) * ball.points[9] + np.sin(2.0) * towards
        errors.append(np.linalg.norm(path.points[-1] - end))
    assert errors[2] < errors[0] / 4


@pytest.mark.parametrize(
    "source", [12, FacePoint(30, (0.2, 0.5, 0.3)), FacePoint(30, (0, 0.5, 0.5))]
)
def test_the_logarithm_inverts_tracing(source):
    mesh = bumpy()
    mesh = TriangleMesh(
        mesh.points,
        np.where(np.arange(len(mesh.faces))[:, None] % 3, mesh.faces, mesh.faces[:, ::-1]),
    )
    found, distances = logarithmic_map(mesh, source), exact_distances(mesh, source)
    np.testing.assert_allclose(
        np.linalg.norm(found.coordinates, axis=1), distances, rtol=1e-9, atol=1e-12
    )
    vectors = found.coordinates @ found.axes
    ends = [
        trace_geodesic(mesh, source, vectors[i]).points[-1]
        for i in range(0, mesh.n, 7)
        if distances[i]
    ]
    errors = np.linalg.norm(
        np.array(ends) - [mesh.points[i] for i in range(0, mesh.n, 7) if distances[i]], axis=1
    )
    # Straight on, a path that bends at a vertex goes elsewhere; few do on so round a shape.
    assert np.mean(errors < 1e-9) > 0.8


def test_a_straightest_path_halves_the_angle_at_a_vertex():
    count, turn = 6, np.radians(40)  # a cone of six sectors
    around = 2 * np.pi * np.arange(count) / count
    height = np.sqrt((np.cos(turn) - np.cos(np.pi / 3)) / (1 - np.cos(np.pi / 3)))
    radius = np.sqrt(1 - height**2)
    ring = np.column_stack(
        [radius * np.cos(around), radius * np.sin(around), np.full(count, height)]
    )
    mesh = TriangleMesh(
        np.vstack([[0, 0, 0], ring]), [[0, 1 + i, 1 + (i + 1) % 6] for i in range(6)]
    )
    path = trace_geodesic(mesh, 1, -ring[0], length=1.7)
    np.testing.assert_allclose(path.points[-1], 0.7 * ring[3], atol=1e-12)


def test_a_trace_that_ends_early_says_so():
    mesh = rectangle(n=100).geometry
    middle = int(np.argmin(np.linalg.norm(mesh.points - mesh.points.mean(axis=0), axis=1)))
    with pytest.warns(DoubtfulDistanceWarning, match="at the boundary"):
        path = trace_geodesic(mesh, middle, [0, 1, 0], length=100)
    np.testing.assert_allclose(path.points[-1, 1], mesh.points[:, 1].max())
    refused(
        "direction", "lead onto the surface", trace_geodesic, mesh, 0, -mesh.points.mean(axis=0)
    )


# --- straight on over clouds ---


def scattered(n, seed=0):
    points = np.random.default_rng(seed).standard_normal((n, 3))
    return PointCloud(points / np.linalg.norm(points, axis=1)[:, None])


def test_over_a_round_cloud_they_are_great_circles():
    errors = []
    for n in (1000, 4000, 16000):
        cloud = scattered(n)
        start = cloud.points[0]
        across = np.cross(start, [0.3, 0.5, 0.8])
        path = trace_geodesic(cloud, 0, across, length=2 * np.pi)
        np.testing.assert_allclose(path.length, 2 * np.pi, rtol=1e-12)
        assert path.faces.size == path.barycentric.size == 0
        errors.append(np.linalg.norm(path.points - start, axis=1)[-1])
    assert errors[2] < errors[0] / 16  # at least of second order
    assert errors[2] < 1e-3


def test_over_a_ring_of_points_clairaut_holds():
    spread = []
    for n in (1000, 4000, 16000):
        cloud = torus(n=n, minor=0.4).geometry.as_cloud()
        path = trace_geodesic(cloud, int(np.argmax(cloud.points[:, 0])), [0, 1, 0.7], length=20)
        ways = np.diff(path.points, axis=0) / np.diff(path.lengths)[:, None]
        x, y, _ = (path.points[1:] + path.points[:-1]).T / 2
        spread.append(np.ptp(x * ways[:, 1] - y * ways[:, 0]))  # the same all along
    assert spread[1] < spread[0] / 4
    assert spread[2] < spread[1] / 4


def test_over_a_cloud_they_turn_with_it_and_know_no_unit():
    cloud, direction = bumpy(642).as_cloud(), np.array([0.2, 0.9, -0.3])
    path = trace_geodesic(cloud, 7, direction, length=1.5)
    rotation = Rotation.from_rotvec([0.4, 1.1, -0.3])
    for unit in (1e-30, 1.0, 1e30):
        other = PointCloud(rotation.apply(cloud.points) * unit)
        same = trace_geodesic(other, 7, rotation.apply(direction), length=1.5 * unit)
        np.testing.assert_allclose(same.points / unit, rotation.apply(path.points), atol=1e-9)


def test_over_a_cloud_they_lead_where_those_of_its_mesh_do():
    mesh = bumpy(2562)
    log = logarithmic_map(mesh, 5)
    near = np.flatnonzero(np.linalg.norm(log.coordinates, axis=1) < 0.8)[1::25]
    for target in near:
        path = trace_geodesic(mesh.as_cloud(), 5, log.coordinates[target] @ log.axes)
        assert np.linalg.norm(path.points[-1] - mesh.points[target]) < 0.02 * path.length + 0.005


def test_over_a_cloud_they_end_at_the_boundary_or_where_no_point_is():
    flat = rectangle(n=900).geometry
    cloud, (width, height, _) = flat.as_cloud(), np.ptp(flat.points, axis=0)
    spacing = np.sqrt(width * height / flat.n)
    middle = int(np.argmin(np.linalg.norm(flat.points - flat.points.mean(axis=0), axis=1)))
    with pytest.warns(DoubtfulDistanceWarning, match="at the boundary"):
        path = trace_geodesic(cloud, middle, [0.1, 1, 0], length=100)
    way = path.points - path.points[0]
    np.testing.assert_allclose(way, np.outer(way[:, 1], [0.1, 1, 0]), atol=1e-9)
    assert abs(path.points[-1, 1] - flat.points[:, 1].max()) < spacing
    corner = int(np.argmin(flat.points[:, :2].sum(axis=1)))
    along = trace_geodesic(cloud, corner, [1, 0, 0], length=width)  # on the boundary itself
    np.testing.assert_allclose(along.points[-1], flat.points[corner] + [width, 0, 0], atol=1e-9)


def test_over_a_cloud_they_do_not_leave_it_in_silence():
    """A cube of points: beyond an edge, or at its end, but never in the air."""
    grid = np.linspace(0, 1, 11)
    points = np.stack(np.meshgrid(grid, grid, grid), axis=-1).reshape(-1, 3)
    cloud = PointCloud(points[((points == 0) | (points == 1)).any(axis=1)])
    start = int(np.argmin(np.linalg.norm(cloud.points - [0.4, 0.4, 1], axis=1)))
    for towards in ([1, 0.2, 0], [0.3, 1, 0], [-1, 0.7, 0]):
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            path = trace_geodesic(cloud, start, towards, length=2.0)
        away, _ = cKDTree(cloud.points).query(path.points)
        assert away.max() < 0.15  # of spacings of 0.1, where 0.07 is as far as a face has it
        assert all(one.category is DoubtfulDistanceWarning for one in told)
        assert told or path.length == pytest.approx(2.0)


# --- locally shortest ---


def test_loops_settle_on_the_inner_equator():
    errors = []
    for n in (1000, 4000):
        ring = torus(n=n, minor=0.3).geometry
        inner = [[0.7 * np.cos(angle), 0.7 * np.sin(angle), 0] for angle in (-2, 0, 2)]
        stops = [int(np.argmin(np.linalg.norm(ring.points - place, axis=1))) for place in inner]
        loop = shortened_path(ring, stops, closed=True)
        check_on_surface(ring, loop, rtol=1e-6)
        np.testing.assert_allclose(loop.points[0], loop.points[-1])
        errors.append(abs(loop.length / (2 * np.pi * 0.7) - 1))
    assert errors[1] < errors[0] / 2


def test_a_direct_way_becomes_the_shortest():
    ball = sphere(subdivisions=3).geometry
    np.testing.assert_allclose(shortened_path(ball, [0, 77]).length, exact_distances(ball, 0)[77])


# --- farthest points ---


def test_farthest_points_cover_a_surface_as_gonzalez_says():
    ball = sphere(subdivisions=3).geometry
    some = farthest_point_sampling(ball, 20, start=3)
    assert some[0] == 3
    assert len(set(some.tolist())) == 20
    radii = [exact_distances(ball, some[:k]).max() for k in range(1, 21)]
    assert (np.diff(radii) <= 0).all()
    for k, radius in enumerate(radii[:-1], start=1):  # the next is the farthest
        assert exact_distances(ball, some[:k])[some[k]] == pytest.approx(radius)
    two = joined(ball, moved(ball, 5.0, 0.0, 0.0))
    assert (farthest_point_sampling(two, 2, start=0) >= [0, ball.n]).all()
    assert len(farthest_point_sampling(ball.as_cloud(), 5)) == 5


# --- refusals ---


def test_they_refuse():
    two = joined(square(), bumpy(162))
    refused("target", "be reached from a source", geodesic_path, two, 0, 100)
    refused("target", "be a vertex", GeodesicPaths(two, 0).to, FacePoint(0, (0.2, 0.3, 0.5)))
    refused("target", "be one of `targets`", GeodesicPaths(two, 0, targets=[3]).to, 4)
    refused("target", "lie on the surface", geodesic_path, LONE, 0, 64)
    refused("source", "lie on the surface", logarithmic_map, LONE, 64)
    refused("direction", "have a part in the tangent plane", trace_geodesic, two, 0, [0, 0, 0])
    book = TriangleMesh(
        [[0, 0, 0], [0, 0, 1], [1, 0, 0.5], [-1, 0, 0.5], [0, 1, 0.5]],
        [[0, 1, 2], [0, 1, 3], [0, 1, 4]],
    )
    refused("source", "lie on one sheet", logarithmic_map, book, 0)
    ball = scattered(300)
    inside = FacePoint(0, (0.2, 0.3, 0.5))
    refused("source", "be a point of the cloud", trace_geodesic, ball, inside, [1, 0, 0])
    refused("source", "be in [0, 299]", trace_geodesic, ball, 300, [1, 0, 0])
    refused("direction", "have a part in the tangent plane", trace_geodesic, ball, 0, [0, 0, 0])
    refused("length", "take fewer than", trace_geodesic, ball, 0, [1, 0, 0], length=1e9)
    refused("mesh", "be an orientable manifold", shortened_path, book, [0, 3])
    refused("mesh", "be an orientable manifold", shortened_path, moebius(), [0, 3])
    refused("vertices", "lie on one component", shortened_path, two, [0, 100])
    refused("vertices", "name 3 or more vertices", shortened_path, two, [0, 10], closed=True)
    point = nearest_source(two, two.points[5])
    assert geodesic_path(two, point, 5).length == 0
