"""Sources of heat: every way to name them, where their heat goes, and what is refused."""

import numpy as np
import pytest
from conftest import creature, refused

from spectra_kit import Spectrum, TriangleMesh
from spectra_kit.geodesics.sources import FacePoint, check_sources, nearest_source
from spectra_kit.geometry import sphere

RIGHT = TriangleMesh([[0, 0, 0], [3, 0, 0], [0, 4, 0], [9, 9, 9]], [[0, 1, 2]])
BALL = sphere(subdivisions=2).geometry
CORNER = FacePoint(0, [1, 0, 0])


def same(first, second):
    return (
        first.n == second.n
        and np.array_equal(first.vertices, second.vertices)
        and np.allclose(first.heat, second.heat, rtol=1e-15)
        and np.array_equal(first.offsets, second.offsets)
    )


@pytest.mark.parametrize(
    "named",
    [
        [7, 3],
        (3, 7),
        np.array([7, 3], dtype=np.uint8),
        np.isin(np.arange(BALL.n), [3, 7]),
        [np.int32(3), np.int64(7)],
    ],
    ids=["list", "tuple", "array", "mask", "numpy integers"],
)
def test_every_form_names_the_same_vertices(named):
    spectrum = Spectrum(np.array([0.0, 1.0]), np.eye(BALL.n)[:, :2], np.ones(BALL.n))
    for geometry in (BALL, BALL.as_cloud(), spectrum):
        found = check_sources(named, geometry)
        assert found.vertices.tolist() == [3, 7]
        assert found.heat.tolist() == [1.0, 1.0]
        assert found.offsets.tolist() == [0.0, 0.0]
        assert np.flatnonzero(found.right_hand_side()).tolist() == [3, 7]
        assert same(check_sources(found, geometry), found)
        assert not any(a.flags.writeable for a in (found.vertices, found.heat, found.offsets))


def test_one_index_is_one_source():
    assert same(check_sources(5, BALL), check_sources([5], BALL))
    assert same(check_sources(np.int64(5), BALL), check_sources(np.array(5), BALL))


def test_weights_follow_their_sources_and_add_up():
    found = check_sources([4, 9, 4], BALL, weights=[1.0, 5.0, 2.5])
    assert found.vertices.tolist() == [4, 9]
    assert found.heat.tolist() == [3.5, 5.0]
    inside = FacePoint(0, [0.2, 0.3, 0.5])
    first = check_sources([9, inside], BALL, weights=[2, 3])
    assert same(first, check_sources([inside, 9], BALL, weights=[3, 2]))
    assert first.heat.sum() == pytest.approx(5)


def test_point_of_a_face_heats_its_corners():
    found = check_sources(FacePoint(0, [0.0, 0.5, 0.5]), RIGHT)
    assert found.vertices.tolist() == [1, 2]
    assert found.heat.tolist() == [0.5, 0.5]
    assert found.offsets.tolist() == [2.5, 2.5]  # half of the side of length 5
    point = FacePoint(11, [0.1, 0.6, 0.3])  # a linear function sees it where it is
    heat = check_sources(point, BALL).right_hand_side()
    assert heat @ BALL.points == pytest.approx(point.position(BALL))
    corner = FacePoint(3, [0, 1, 0])
    assert same(check_sources(corner, BALL), check_sources(BALL.faces[3, 1], BALL))


def test_offsets_are_to_the_nearest_source():
    near, far = FacePoint(0, [0.9, 0.1, 0.0]), FacePoint(0, [0.1, 0.9, 0.0])
    assert check_sources([near, far], RIGHT).offsets == pytest.approx([0.3, 0.3])
    assert check_sources([near, 0], RIGHT).offsets == pytest.approx([0.0, 2.7])


def test_rounding_of_barycentric_coordinates_is_forgiven():
    point = FacePoint(np.int64(2), np.array([1 + 1e-12, -1e-12, 0.0]))
    assert point == FacePoint(2, (1.0, 0.0, 0.0))
    assert hash(point) == hash(FacePoint(2, (1.0, 0.0, 0.0)))


def test_nearest_source_finds_every_vertex_and_every_point_of_a_face():
    mesh = creature(500, seed=0)
    for vertex in (0, 499):
        found = check_sources(nearest_source(mesh, mesh.points[vertex]), mesh)
        assert found.vertices.tolist() == [vertex]
        assert nearest_source(mesh.as_cloud(), mesh.points[vertex]) == vertex
    inside = FacePoint(111, [0.2, 0.3, 0.5])
    found = nearest_source(mesh, inside.position(mesh))
    assert found.face == 111
    assert found.barycentric == pytest.approx(inside.barycentric, abs=1e-9)
    place = 0.8 * mesh.points[17] + 0.1 * mesh.points[3]  # off the surface, in any unit
    for exponent in (-1000, 1000):
        scaled = mesh.with_points(np.ldexp(mesh.points, exponent))
        for one, other in ((mesh, scaled), (mesh.as_cloud(), scaled.as_cloud())):
            far = nearest_source(other, np.ldexp(place, exponent))
            assert far == nearest_source(one, place)


def test_nearest_source_leaves_out_faces_without_area():
    mesh = TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0]], [[0, 1, 3], [0, 1, 2]])
    assert nearest_source(mesh, [0.5, 0.0, 0.0]) == FacePoint(1, (0.5, 0.5, 0.0))


@pytest.mark.parametrize(
    ("given", "argument", "expected"),
    [
        (([],), "sources", "name at least one source, got none"),
        ((np.zeros(4, dtype=bool),), "sources", "name at least one source, got none"),
        ((np.ones(3, dtype=bool),), "sources", "have shape (4,) as a mask, got (3,)"),
        (([False, True, False, False],), "sources", "hold integers, got dtype bool"),
        ((2**70,), "sources", f"be in [0, 4), got {2**70}"),
        (([[0, 1], [1, 2]],), "sources", "be one index or a vector of them, got shape (2, 2)"),
        (([[0, 1], [1]],), "sources", "have rows of one length"),
        ((3,), "sources", "lie on the surface, got vertex 3, which no face uses"),
        (([CORNER, 9],), "sources", "be in [0, 3], got 9"),
        (([CORNER, 0.5],), "sources", "be an integer, got 0.5"),
        ((FacePoint(1, [1, 0, 0]),), "face", "be in [0, 1), got 1"),
        (([0, 1], [1.0]), "weights", "have one entry for each of the 2 sources, got shape (1,)"),
        (([0, 1], [1.0, 0.0]), "weights", "be positive, got 0"),
        ((check_sources(0, BALL),), "sources", "belong to the geometry of 4 points, got those of"),
        ((check_sources(0, RIGHT), [1.0]), "weights", "be None where `sources` are checked"),
    ],
)
def test_bad_sources_are_refused(given, argument, expected):
    refused(argument, expected, lambda sources, *w: check_sources(sources, RIGHT, *w), *given)


@pytest.mark.parametrize(
    ("call", "given", "argument", "expected"),
    [
        (check_sources, (CORNER, BALL.as_cloud()), "sources", "be vertices where `geometry` has"),
        (FacePoint, (0, [0.5, 0.4, 0.2]), "barycentric", "be non-negative and sum to 1"),
        (FacePoint, (0, [1.5, -0.5, 0.0]), "barycentric", "be non-negative and sum to 1"),
        (nearest_source, (BALL, [0.0, 1e7, 0.0]), "coordinate", "lie near the points"),
        (
            nearest_source,
            (TriangleMesh(np.eye(3), [[0, 1, 1]]), [0.0, 0.0, 0.0]),
            "geometry",
            "have a face of positive area, got 1 without",
        ),
    ],
)
def test_bad_points_are_refused(call, given, argument, expected):
    refused(argument, expected, call, *given)
