"""What no operator can use is refused at the door, with the argument and the next step named."""

import numpy as np
import pytest

from spectra_kit import _validate
from spectra_kit.errors import InvalidInputError, SpectraKitError
from spectra_kit.geometry import PointCloud, TriangleMesh, diagnose, sphere

POINTS = [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]


@pytest.mark.parametrize("make", [PointCloud, lambda points: TriangleMesh(points, [[0, 0, 0]])])
@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([[0, 0, np.nan]], r"`points` must be finite, got 1 NaN .* the first at \(0, 2\)"),
        ([[0, 0, 1], [-np.inf, 0, np.inf]], r"got 2 NaN .* the first at \(1, 0\)"),
        (np.empty((0, 3)), r"`points` must hold at least one point, got shape \(0, 3\)"),
        ([], r"`points` must have shape \(n, 3\), got \(0,\)"),
        (None, "`points` must hold real numbers, got None"),
        ([1.0, 2.0, 3.0], r"must have shape \(n, 3\), got \(3,\)"),
        (np.zeros((5, 2)), r"must have shape \(n, 3\), got \(5, 2\)"),
        (np.zeros((3, 50)), r"got \(3, 50\); did you pass its transpose\?"),
        (np.zeros((2, 5, 3)), r"must have shape \(n, 3\), got \(2, 5, 3\)"),
        ([[1, 2, 3], [4, 5]], "`points` must have rows of one length"),
        (np.zeros((4, 3), dtype=complex), "must hold real numbers, got dtype complex128"),
        (np.zeros((4, 3), dtype=bool), "must hold real numbers, got dtype bool"),
        ([["a", "b", "c"]], "must hold real numbers, got dtype <U1"),
        (np.zeros((4, 3), dtype=object), "must hold real numbers, got dtype object"),
    ],
)
def test_bad_points(make, points, message):
    with pytest.raises(InvalidInputError, match=message):
        make(points)


@pytest.mark.parametrize(
    ("faces", "message"),
    [
        ([[0, 1, 4]], r"`faces` must be in \[0, 4\), got 4"),
        ([[0, 1, -1]], r"`faces` must be in \[0, 4\), got -1"),
        ([[1, 2, 3], [2, 3, 4]], r"must be in \[0, 4\), got 4; indices count from 0"),
        (np.empty((0, 3), dtype=int), r"at least one triangle.*; use PointCloud for bare points"),
        (np.zeros((2, 4), dtype=int), r"`faces` must have shape \(f, 3\), got \(2, 4\)"),
        (np.zeros((3, 120), dtype=int), r"got \(3, 120\); did you pass its transpose\?"),
        ([0, 1, 2], r"`faces` must have shape \(f, 3\), got \(3,\)"),
        ([[0.0, 1.0, 2.0]], "`faces` must hold integers, got dtype float64"),
        ([[0, 1, 2], [0, 1]], "`faces` must have rows of one length"),
        (np.array([[0, 1, 2**63]], dtype=np.uint64), r"`faces` must be in \[0, 4\), got 9223"),
    ],
)
def test_bad_faces(faces, message):
    with pytest.raises(InvalidInputError, match=message):
        TriangleMesh(POINTS, faces)


@pytest.mark.parametrize("dtype", [np.int32, np.uint8, np.uint64, ">i4"])
def test_any_integer_type_is_welcome(dtype):
    mesh = TriangleMesh(np.asfortranarray(POINTS, dtype=np.float32), np.array([[0, 1, 2]], dtype))
    assert (mesh.faces.dtype, mesh.points.dtype) == (np.int64, np.float64)
    assert mesh.points.flags.c_contiguous


def test_errors_are_caught_as_their_builtin_too():
    for kind in (InvalidInputError, SpectraKitError, ValueError):
        with pytest.raises(kind):
            PointCloud([])


def test_dirt_is_kept_until_its_removal_is_asked_for():
    """Unreferenced, degenerate, duplicate, non-manifold: all legal, all reported, none touched."""
    faces = [[0, 1, 2], [0, 1, 2], [1, 0, 2], [1, 1, 2]]
    mesh = TriangleMesh([*POINTS, POINTS[0]], faces)
    np.testing.assert_array_equal(mesh.faces, faces)
    assert mesh.n == 5
    assert len(diagnose(mesh).problems) == 5


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_millimetres_and_kilometres_are_the_same_surface(scale):
    ball = sphere(subdivisions=2).geometry
    scaled = ball.with_points(ball.points * scale)
    assert scaled.area == pytest.approx(ball.area * scale**2, rel=1e-14)
    plain, other = vars(diagnose(ball)), vars(diagnose(scaled))
    for count in plain.keys() - {"area", "lower", "upper"}:
        assert other[count] == plain[count]


def test_methods_check_what_they_are_given():
    mesh = TriangleMesh(POINTS, [[0, 1, 2]])
    with pytest.raises(InvalidInputError, match=r"`faces` must be in \[0, 2\), got 2"):
        mesh.with_points(POINTS[:2])
    with pytest.raises(InvalidInputError, match="`points` must be finite"):
        PointCloud(POINTS).with_points(np.full((4, 3), np.nan))
    with pytest.raises(InvalidInputError, match="at least one triangle"):
        TriangleMesh(POINTS, [[1, 1, 2]]).without_degenerate_faces()


@pytest.mark.parametrize(
    ("check", "message"),
    [
        (lambda: _validate.check_mass("mass", [1.0, 2.0], 3), r"`mass` must have shape \(3,\)"),
        (
            lambda: _validate.check_mass("mass", [1.0, 0.0], 2),
            "must be positive, got 1 entry <= 0",
        ),
        (lambda: _validate.check_mass("mass", [1.0, np.nan], 2), "`mass` must be finite"),
        (lambda: _validate.check_count("k", 2.0, low=1), "`k` must be an integer, got 2.0"),
        (lambda: _validate.check_count("k", True, low=1), "`k` must be an integer, got True"),
        (lambda: _validate.check_count("k", 0, low=1), "`k` must be at least 1, got 0"),
        (lambda: _validate.check_count("k", 9, low=1, high=5), r"`k` must be in \[1, 5\], got 9"),
        (lambda: _validate.check_positive("t", "1"), "`t` must be a number, got '1'"),
        (lambda: _validate.check_positive("t", True), "`t` must be a number, got True"),
        (lambda: _validate.check_positive("t", -1.0), "`t` must be positive and finite, got -1.0"),
        (lambda: _validate.check_positive("t", np.inf), "`t` must be positive and finite, got inf"),
        (lambda: _validate.check_indices("sources", [0.5], 3), "`sources` must hold integers"),
    ],
)
def test_checks_of_arguments(check, message):
    with pytest.raises(InvalidInputError, match=message):
        check()


def test_checks_return_what_they_checked():
    assert _validate.check_count("k", np.int32(7), low=1) == 7
    assert _validate.check_positive("t", np.float32(0.5)) == 0.5
    np.testing.assert_array_equal(_validate.check_mass("mass", [1, 2], 2), [1.0, 2.0])
