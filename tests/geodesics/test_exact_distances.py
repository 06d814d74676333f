"""Exact distances: planes, cubes, cones and spheres by hand, libigl, and what meshes may be."""

import numpy as np
import pytest
from conftest import bumpy, creature, joined, refused
from geodesic_truths import CORNERS, QUADS, angles, by_libigl, cube, straight
from scipy.spatial import Delaunay

from spectra_kit.errors import ConvergenceError
from spectra_kit.geodesics import exact_distances, pair_distances
from spectra_kit.geometry import TriangleMesh, sphere


def square(n=60, seed=0, *, caps=0):
    """A square of random triangles in space; `caps` of them have no area."""
    rng = np.random.default_rng(seed)
    points = np.concatenate([rng.uniform(size=(n, 2)), [[0, 0], [1, 0], [0, 1], [1, 1]]])
    faces, points = Delaunay(points).simplices.tolist(), points.tolist()
    for _ in range(caps):
        a, b = shared_edges(faces)[rng.integers(len(shared_edges(faces)))]
        i = next(i for i, face in enumerate(faces) if a in face and b in face)
        (c,) = set(faces[i]) - {a, b}
        share = rng.choice([0.5, rng.uniform(), 0.0])  # 0: at the same place as a
        points.append((share * np.array(points[b]) + (1 - share) * np.array(points[a])).tolist())
        new = len(points) - 1
        faces[i] = [a, new, c]
        faces += [[new, b, c], [a, b, new]]
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    return TriangleMesh(np.column_stack([points, np.zeros(len(points))]) @ turn, faces)


def shared_edges(faces):
    sides = np.sort(np.array(faces)[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, counts = np.unique(sides, axis=0, return_counts=True)
    return edges[counts == 2].tolist()


# --- truths ---


def test_on_a_plane_they_are_euclidean():
    mesh = square()
    for source in (0, 17, 63):
        expected = straight(mesh.points, source)
        np.testing.assert_allclose(exact_distances(mesh, source), expected, atol=1e-13)
    sources = [4, 40, 41]
    nearest = np.min([straight(mesh.points, source) for source in sources], axis=0)
    np.testing.assert_allclose(exact_distances(mesh, sources), nearest, atol=1e-13)
    mask = np.isin(np.arange(mesh.n), sources)
    np.testing.assert_array_equal(exact_distances(mesh, mask), exact_distances(mesh, sources))


def test_on_a_grid_paths_run_through_vertices():
    i, j = (index.ravel() for index in np.indices((12, 12)))
    corner = np.flatnonzero((i < 11) & (j < 11))[:, None]
    mesh = TriangleMesh(
        np.column_stack([i, j, 0 * i]), np.vstack([corner + [0, 1, 13], corner + [0, 13, 12]])
    )
    for source in (0, 66):
        expected = straight(mesh.points, source)
        np.testing.assert_allclose(exact_distances(mesh, source), expected, atol=1e-12)


def test_over_a_cube_they_unfold():
    far = np.array(CORNERS).sum(axis=1)  # steps to the other corner
    truth = np.array([0, 1, np.sqrt(2), np.sqrt(5)])[far]
    np.testing.assert_allclose(exact_distances(cube(), 0), truth, atol=1e-14)
    # To the middle of an opposite face: over one face beside, or over two.
    middles = np.array([np.mean([CORNERS[i] for i in quad], axis=0) for quad in QUADS])
    fans = [[q[i], q[(i + 1) % 4], 8 + k] for k, q in enumerate(QUADS) for i in range(4)]
    fine = TriangleMesh(np.concatenate([CORNERS, middles]), fans)
    found = exact_distances(fine, 8)  # the middle of x = 0
    np.testing.assert_allclose(found[9], 2.0)  # that of x = 1
    np.testing.assert_allclose(found[10:], 1.0)
    # From a corner to the middle of a face it does not touch, 1 + 1/2 along and 1/2 across.
    np.testing.assert_allclose(exact_distances(fine, 0)[9], np.hypot(1.5, 0.5))


@pytest.mark.parametrize("turn", [1, -1])
def test_around_a_corner_of_the_boundary_they_bend(turn):
    # Three of four quarters of a square; one half of each cell is wound the other way.
    i, j = (index.ravel() for index in np.indices((11, 11)))
    corner = np.flatnonzero((i < 10) & (j < 10) & ((i < 5) | (j < 5)))[:, None]
    faces = np.vstack([corner + [12, 11, 0], corner + [0, 12, 1]])[:, ::turn]
    mesh = TriangleMesh(np.column_stack([i, j, 0 * i]), faces).without_unreferenced()
    x, y, _ = mesh.points.T
    source = int(np.flatnonzero((x == 10) & (y == 0))[0])
    hidden = (y > 5) & (x + y > 10)  # behind the corner (5, 5)
    around = np.hypot(5, 5) + np.hypot(x - 5, y - 5)
    truth = np.where(hidden, around, straight(mesh.points, source))
    np.testing.assert_allclose(exact_distances(mesh, source), truth, atol=1e-12)


@pytest.mark.parametrize("count", [6, 12])
def test_around_a_tip_they_follow_its_angle(count):
    # Sectors of 40 degrees: six make a cone, twelve, up and down by turns, more than a plane.
    around, turn = 2 * np.pi * np.arange(count) / count, np.radians(40)
    zigzag = np.ones(count) if count == 6 else (-1.0) ** np.arange(count)
    # Neighbours at height +-h have the product (1 - h^2) cos(step) +- h^2.
    side, step = zigzag[0] * zigzag[1], np.cos(2 * np.pi / count)
    height = np.sqrt((np.cos(turn) - step) / (side - step))
    radius = np.sqrt(1 - height**2)
    ring = np.column_stack([radius * np.cos(around), radius * np.sin(around), height * zigzag])
    faces = [[0, 1 + i, 1 + (i + 1) % count] for i in range(count)]
    mesh = TriangleMesh(np.concatenate([[[0, 0, 0]], ring]), faces)
    steps = np.minimum(np.arange(count), count - np.arange(count))
    angle = np.minimum(turn * steps, np.pi)  # past a half turn they lead through the tip
    np.testing.assert_allclose(exact_distances(mesh, 1)[1:], 2 * np.sin(angle / 2), atol=1e-12)


def test_on_the_sphere_they_tend_to_arcs():
    balls = [sphere(subdivisions=subdivisions).geometry for subdivisions in (2, 3, 4)]
    errors = [np.abs(exact_distances(b, 0) - angles(b.points, 0)).max() for b in balls]
    np.testing.assert_allclose(-np.diff(np.log2(errors)), 2, atol=0.15)


def test_they_are_those_of_libigl():
    mesh = bumpy()
    for sources in ([0], [5, 100, 333]):
        truth = by_libigl(mesh, *sources)
        np.testing.assert_allclose(exact_distances(mesh, sources), truth, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("seed", [0, 2, 5])
def test_where_rays_run_through_vertices_they_are_those_of_libigl(seed):
    height = np.kron(np.random.default_rng(seed).integers(0, 4, (8, 8)), np.ones((2, 2)))
    i, j = np.indices(height.shape)
    corner = np.flatnonzero(((i < 15) & (j < 15)).ravel())[:, None]
    faces = np.vstack([corner + [0, 16, 17], corner + [0, 17, 1]])
    blocks = TriangleMesh(np.column_stack([i.ravel(), j.ravel(), height.ravel()]), faces)
    for source in range(0, blocks.n, 11):
        truth = by_libigl(blocks, source)
        np.testing.assert_allclose(exact_distances(blocks, source), truth, rtol=1e-10, atol=1e-12)


def test_they_do_not_depend_on_direction_order_winding_or_unit():
    mesh, rng = creature(500, seed=1), np.random.default_rng(0)
    pairs = rng.choice(mesh.n, 6, replace=False)
    matrix = np.array([exact_distances(mesh, int(i), targets=pairs) for i in pairs])
    np.testing.assert_allclose(matrix, matrix.T, rtol=1e-9, atol=1e-12)
    order = rng.permutation(mesh.n)
    faces = np.argsort(order)[rng.permutation(mesh.faces)]
    faces[::2] = faces[::2, ::-1]
    other = TriangleMesh(1e120 * mesh.points[order], faces)
    found = exact_distances(other, int(np.argsort(order)[7]))
    np.testing.assert_allclose(found, 1e120 * exact_distances(mesh, 7)[order], rtol=1e-9)


@pytest.mark.parametrize("exponent", [-1060, 1020])
def test_powers_of_two_change_no_bit(exponent):
    mesh = creature(500, seed=1)
    lattice = np.round(mesh.points * 2**10) / 2**10  # numbers that are small enough stay whole
    one, other = (mesh.with_points(np.ldexp(lattice, e)) for e in (0, exponent))
    expected = np.ldexp(exact_distances(one, 7), exponent)
    np.testing.assert_array_equal(exact_distances(other, 7), expected)


@pytest.mark.parametrize("size", [0.0, 1e-200, 1e200])
def test_parts_of_any_size_have_the_distances_that_they_have_alone(size):
    mesh = bumpy()
    alone, both = exact_distances(mesh, 7), joined(mesh, mesh.with_points(size * mesh.points))
    found = exact_distances(both, [7, mesh.n + 7])
    np.testing.assert_allclose(found[: mesh.n], alone, rtol=1e-12)
    np.testing.assert_allclose(found[mesh.n :], size * alone, rtol=1e-12)
    assert np.isinf(exact_distances(both, 7)[mesh.n :]).all()


def test_targets_and_pairs_are_part_of_the_whole():
    mesh = joined(bumpy(), square())
    whole = exact_distances(mesh, 3)
    targets = [600, 3, mesh.n - 1, 600]
    np.testing.assert_array_equal(exact_distances(mesh, 3, targets=targets), whole[targets])
    assert exact_distances(mesh, 3, targets=np.empty(0, dtype=int)).shape == (0,)
    pairs = pair_distances(mesh, [3, 3, 9], [7, 700, 9], method="exact")
    np.testing.assert_array_equal(pairs, [whole[7], np.inf, 0])


# --- any triangles ---


def test_faces_without_area_change_nothing():
    mesh = square(caps=10)
    assert mesh.degenerate_faces().sum() >= 10
    for source in (0, mesh.n - 1):
        expected = straight(mesh.points, source)
        np.testing.assert_allclose(exact_distances(mesh, source), expected, atol=1e-9)


def test_paths_cross_an_edge_of_three_faces_into_each():
    book = TriangleMesh(
        [[0, 0, 0], [0, 0, 1], [1, 0, 0.5], [-1, 0, 0.5], [0, 1, 0.5]],
        [[0, 1, 2], [0, 1, 3], [0, 1, 4]],
    )
    for page in (2, 3, 4):
        truth = [np.sqrt(1.25), np.sqrt(1.25), 2, 2, 2]
        truth[page] = 0
        np.testing.assert_allclose(exact_distances(book, page), truth, atol=1e-14)


def test_more_faces_in_the_same_plane_change_nothing():
    mesh, rng = square(), np.random.default_rng(0)
    edges = np.array(shared_edges(mesh.faces.tolist()))
    extra = np.column_stack([edges, rng.integers(0, mesh.n, len(edges))])[:40]
    extra = extra[(extra[:, 2:] != extra[:, :2]).all(axis=1)]
    twice = mesh.faces[:20, ::-1]
    for more in (extra, twice):
        soup = TriangleMesh(mesh.points, np.concatenate([mesh.faces, more]))
        assert soup.unique_edges[1].max() >= 3
        for source in (0, 40):
            expected = straight(mesh.points, source)
            np.testing.assert_allclose(exact_distances(soup, source), expected, atol=1e-9)


@pytest.mark.parametrize("lower", [-0.5, -0.52])
def test_sheets_that_part_and_join_again_do_not_multiply_paths(lower):
    points, faces = [[0, 0, 0], [0, 1, 0]], []
    for i in range(30):
        points += [[2 * i + 1, y, z] for z in (0.5, lower) for y in (0, 1)]
        points += [[2 * i + 2, y, 0] for y in (0, 1)]
        a = 6 * i
        for b, c in ((a, a + 2), (a, a + 4), (a + 2, a + 6), (a + 4, a + 6)):
            faces += [[b, c, c + 1], [b, c + 1, b + 1]]
    found = exact_distances(TriangleMesh(points, faces), 0)
    along = 60 * np.hypot(1, 0.5)
    np.testing.assert_allclose(found[-2:], [along, np.hypot(along, 1)], rtol=1e-12)


def test_paths_pass_a_vertex_where_surfaces_touch():
    tetrahedron = np.array([[0, 0, 0], [3, 0.2, 0], [3, -0.2, 0.2], [3, -0.2, -0.2]])
    faces = [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 2, 3]]
    twin = np.where(np.array(faces) > 0, np.array(faces) + 3, 0)
    mesh = TriangleMesh(np.concatenate([tetrahedron, -tetrahedron[1:]]), [*faces, *twin])
    tip = np.linalg.norm(tetrahedron, axis=1)  # distances from the vertex they share
    np.testing.assert_allclose(exact_distances(mesh, 1)[[0, 4, 5, 6]], tip[1] + tip, rtol=1e-14)


# --- refusals ---

SQUARE, BALL = square(), sphere(subdivisions=1).geometry
LONE = TriangleMesh(np.concatenate([SQUARE.points, [[9, 9, 9]]]), SQUARE.faces)
LINE = TriangleMesh(SQUARE.points, np.concatenate([SQUARE.faces, [[0, 1, 1]]]))
WIDE = BALL.with_points(1.7e308 * BALL.points)  # a diameter is no number


@pytest.mark.parametrize(
    ("mesh", "sources", "argument", "expected"),
    [
        (SQUARE, [], "sources", "name at least one point"),
        (LONE, 64, "sources", "lie on the surface, got vertex 64, which no face uses"),
        (LINE, 0, "mesh", "have three corners to a face, got 1 face with a vertex twice"),
        (WIDE, 0, "mesh", "have distances that are numbers, got some above 1.8e+308"),
    ],
)
def test_they_refuse(mesh, sources, argument, expected):
    refused(argument, expected, exact_distances, mesh, sources)
    refused("targets", "be in [0,", exact_distances, SQUARE, 0, targets=[-1])


def test_triangles_so_thin_that_paths_go_round_and_round_are_given_up():
    needle = BALL.with_points(BALL.points * [1e7, 1, 1])
    with pytest.raises(ConvergenceError, match="remesh, or take geodesic_distance") as caught:
        exact_distances(needle, 5)
    assert caught.value.partial.shape == (BALL.n,)
