"""Sources of heat: every way to name them, where their heat goes, and what is refused."""

import numpy as np
import pytest
from conftest import creature, refused

from spectra_kit import InvalidInputError, PointCloud, Spectrum, TriangleMesh
from spectra_kit.geodesics.sources import FacePoint, check_sources, nearest_source
from spectra_kit.geometry import sphere

RIGHT = TriangleMesh([[0, 0, 0], [3, 0, 0], [0, 4, 0], [9, 9, 9]], [[0, 1, 2]])


@pytest.fixture(scope="module")
def ball():
    return sphere(subdivisions=2).geometry


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
        np.isin(np.arange(162), [3, 7]),
        [np.int32(3), np.int64(7)],
    ],
    ids=["list", "tuple", "array", "mask", "numpy integers"],
)
def test_every_form_names_the_same_vertices(ball, named):
    found = check_sources(named, ball)
    assert found.vertices.tolist() == [3, 7]
    assert found.heat.tolist() == [1.0, 1.0]
    assert found.offsets.tolist() == [0.0, 0.0]
    assert same(check_sources(found, ball), found)


def test_one_index_is_one_source(ball):
    assert same(check_sources(5, ball), check_sources([5], ball))
    assert same(check_sources(np.int64(5), ball), check_sources(np.array(5), ball.as_cloud()))


def test_sources_of_a_spectrum_and_of_a_cloud(ball):
    spectrum = Spectrum(np.array([0.0, 1.0]), np.eye(3)[:, :2], np.ones(3))
    assert check_sources(2, spectrum).right_hand_side().tolist() == [0, 0, 1]
    assert same(check_sources([1, 2], ball.as_cloud()), check_sources([1, 2], ball))


def test_heat_of_two_sources_at_one_vertex_adds_up(ball):
    found = check_sources([4, 9, 4], ball, weights=[1.0, 5.0, 2.5])
    assert found.vertices.tolist() == [4, 9]
    assert found.heat.tolist() == [3.5, 5.0]


def test_weights_follow_their_sources_whatever_the_order(ball):
    first = check_sources([9, FacePoint(0, [0.2, 0.3, 0.5])], ball, weights=[2, 3])
    second = check_sources([FacePoint(0, [0.2, 0.3, 0.5]), 9], ball, weights=[3, 2])
    assert same(first, second)
    assert first.heat.sum() == pytest.approx(5)
    assert first.right_hand_side().sum() == pytest.approx(5)


def test_point_of_a_face_heats_its_corners():
    found = check_sources(FacePoint(0, [0.0, 0.5, 0.5]), RIGHT)
    assert found.vertices.tolist() == [1, 2]
    assert found.heat.tolist() == [0.5, 0.5]
    assert found.offsets.tolist() == [2.5, 2.5]  # half of the side of length 5


def test_heat_of_a_face_point_has_its_first_moments(ball):
    """So a linear function sees the source where it is."""
    point = FacePoint(11, [0.1, 0.6, 0.3])
    heat = check_sources(point, ball).right_hand_side()
    assert heat @ ball.points == pytest.approx(point.position(ball))


def test_point_at_a_corner_is_the_vertex(ball):
    corner = FacePoint(3, [0, 1, 0])
    assert same(check_sources(corner, ball), check_sources(ball.faces[3, 1], ball))


def test_offsets_are_to_the_nearest_source():
    near, far = FacePoint(0, [0.9, 0.1, 0.0]), FacePoint(0, [0.1, 0.9, 0.0])
    found = check_sources([near, far], RIGHT)
    assert found.offsets == pytest.approx([0.3, 0.3])
    assert check_sources([near, 0], RIGHT).offsets == pytest.approx([0.0, 2.7])


def test_rounding_of_barycentric_coordinates_is_forgiven():
    point = FacePoint(np.int64(2), np.array([1 + 1e-12, -1e-12, 0.0]))
    assert point == FacePoint(2, (1.0, 0.0, 0.0))
    assert hash(point) == hash(FacePoint(2, (1.0, 0.0, 0.0)))


def test_results_are_read_only(ball):
    found = check_sources([1], ball)
    for array in (found.vertices, found.heat, found.offsets):
        assert not array.flags.writeable


def test_nearest_source_finds_every_vertex_and_every_point_of_a_face():
    mesh = creature(500, seed=0)
    for vertex in (0, 17, 499):
        found = check_sources(nearest_source(mesh, mesh.points[vertex]), mesh)
        assert found.vertices.tolist() == [vertex]
        assert nearest_source(mesh.as_cloud(), mesh.points[vertex]) == vertex
    for face in (0, 5, 111):
        inside = FacePoint(face, [0.2, 0.3, 0.5])
        found = nearest_source(mesh, inside.position(mesh))
        assert found.position(mesh) == pytest.approx(inside.position(mesh), abs=1e-12)
        assert found.face == face
        assert found.barycentric == pytest.approx(inside.barycentric, abs=1e-9)


def test_nearest_source_to_a_point_off_the_surface(ball):
    """The foot of the perpendicular, of the nearest face."""
    inside = FacePoint(40, [0.3, 0.3, 0.4])
    a, b, c = ball.points[ball.faces[40]]
    normal = np.cross(b - a, c - a)
    outwards = normal * np.sign(normal @ a)
    assert nearest_source(ball, inside.position(ball) + outwards).face == 40


def test_nearest_source_leaves_out_faces_without_area():
    mesh = TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0]], [[0, 1, 3], [0, 1, 2]])
    assert nearest_source(mesh, [0.5, 0.0, 0.0]) == FacePoint(1, (0.5, 0.5, 0.0))


@pytest.mark.parametrize(
    ("sources", "weights", "message"),
    [
        ([], None, "at least one source, got none"),
        (np.zeros(4, dtype=bool), None, "at least one source, got none"),
        (np.ones(3, dtype=bool), None, r"mask must have shape \(4,\), got \(3,\)"),
        (4, None, r"must be in \[0, 4\), got 4"),
        ([0, -1], None, r"must be in \[0, 4\), got -1"),
        ([False, True, False, False], None, "must hold integers, got dtype bool"),
        ([0.0], None, "must hold integers, got dtype float64"),
        ("nose", None, "must hold integers"),
        ({1, 2}, None, "must hold integers"),
        (2**70, None, r"must be in \[0, 4\), got 1180591620717411303424"),
        ([[0, 1], [1, 2]], None, r"one index or a vector of them, got shape \(2, 2\)"),
        ([[0, 1], [1]], None, "must have rows of one length"),
        (3, None, "got vertex 3, which no face uses"),
        ([FacePoint(0, [1, 0, 0]), 9], None, r"must be in \[0, 3\], got 9"),
        ([FacePoint(0, [1, 0, 0]), 0.5], None, "must be an integer, got 0.5"),
        ([FacePoint(0, [1, 0, 0]), True], None, "must be an integer, got True"),
        (FacePoint(1, [1, 0, 0]), None, r"`face` must be in \[0, 1\), got 1"),
        ([0, 1], [1.0], "each of the 2 sources, got shape"),
        (0, 1.0, "each of the 1 sources, got shape"),
        ([0, 1], [1.0, 0.0], "`weights` must be positive, got 0"),
        ([0, 1], [1.0, np.nan], "`weights` must be finite"),
    ],
)
def test_bad_sources_are_refused(sources, weights, message):
    with pytest.raises(InvalidInputError, match=message):
        check_sources(sources, RIGHT, weights)


def test_face_point_needs_faces(ball):
    with pytest.raises(InvalidInputError, match="needs the faces of a TriangleMesh, got a PointC"):
        check_sources(FacePoint(0, [1, 0, 0]), ball.as_cloud())


def test_checked_sources_belong_to_their_geometry(ball):
    checked = check_sources(0, ball)
    with pytest.raises(InvalidInputError, match="geometry of 4 points, got those of one of 162"):
        check_sources(checked, RIGHT)
    refused("weights", "be None", check_sources, checked, ball, [1.0])


@pytest.mark.parametrize(
    ("face", "barycentric", "message"),
    [
        (0, [0.5, 0.5], r"must be a tuple of 3 numbers, got \[0.5, 0.5\]"),
        (0, [0.5, 0.4, 0.2], "sum to 1"),
        (0, [1.5, -0.5, 0.0], "non-negative"),
        (0, [np.nan, 1.0, 0.0], "must be a tuple of 3 numbers"),
        (-1, [1.0, 0.0, 0.0], "`face` must be at least 0, got -1"),
        (0.0, [1.0, 0.0, 0.0], "`face` must be an integer"),
    ],
)
def test_bad_face_points_are_refused(face, barycentric, message):
    with pytest.raises(InvalidInputError, match=message):
        FacePoint(face, barycentric)


def test_bad_coordinates_are_refused(ball):
    refused("coordinate", "have shape (3,)", nearest_source, ball, [0.0, 1.0])
    refused("coordinate", "be finite", nearest_source, ball, [0.0, np.inf, 0.0])
    with pytest.raises(InvalidInputError, match="a face of positive area, got 1 without"):
        nearest_source(TriangleMesh(np.eye(3), [[0, 1, 1]]), [0.0, 0.0, 0.0])


def test_points_of_a_cloud_are_finite_already():
    with pytest.raises(InvalidInputError, match="finite"):
        PointCloud([[np.nan, 0, 0]])


@pytest.mark.parametrize("exponent", [-1000, -600, 600, 1000])
def test_the_nearest_source_is_the_same_in_any_unit(exponent):
    mesh = creature(500, seed=1)
    place = 0.8 * mesh.points[17] + 0.1 * mesh.points[3]
    scaled = mesh.with_points(np.ldexp(mesh.points, exponent))
    one, other = nearest_source(mesh, place), nearest_source(scaled, np.ldexp(place, exponent))
    assert one == other
    cloud = nearest_source(scaled.as_cloud(), np.ldexp(place, exponent))
    assert cloud == nearest_source(mesh.as_cloud(), place)
