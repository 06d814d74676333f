"""Polygons are cut into triangles that cover them once, with all corners and their winding."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from spectra_kit.errors import IgnoredContentWarning, InvalidInputError
from spectra_kit.geometry.polygons import Polygons, surface, triangulate


def in_space(outline):
    return np.column_stack([outline, np.zeros(len(outline))]).astype(float)


def sides(faces):
    return {(f[i - 1], f[i]) for f in np.asarray(faces).tolist() for i in range(len(f))}


def check(points, polygon):
    """Twice the area is Newell's, no triangle is turned over, and the outline alone is open."""
    faces = triangulate(points, [polygon])
    a, b, c = (points[faces[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    corners = points[polygon]
    newell = np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0)
    size = np.linalg.norm(newell)
    np.testing.assert_allclose(normals.sum(axis=0), newell, atol=1e-9 * size)
    assert (normals @ newell > -1e-9 * size**2).all()
    assert np.linalg.norm(normals, axis=1).sum() == pytest.approx(size, rel=1e-9)
    assert len(faces) == len(polygon) - 2
    ours = sides(faces)
    assert {s for s in ours if s[::-1] not in ours} == {
        s for s in sides([polygon]) if s[::-1] not in sides([polygon])
    }


def outline(corners):
    return [tuple(map(float, corner.split(","))) for corner in corners.split()]


L = outline("0,0 2,0 2,1 1,1 1,2 0,2")
OUTLINES = {
    "dart": outline("2,0 0,3 -2,0 0,1"),
    "L": L,
    "L with corners on its sides": outline("0,0 1,0 2,0 2,1 1,1 1,2 0,2 0,1"),
    "square with corners on its sides": outline("0,0 1,0 2,0 2,2 1,2 0,2 0,1"),
    "comb": outline("0,0 7,0 7,3 6,3 6,1 4,1 4,3 3,3 3,1 1,1 1,3 0,3"),
    "spiral": outline("0,0 5,0 5,5 1,5 1,2 3,2 3,3 2,3 2,4 4,4 4,1 0,1"),
    "star": [
        (r * np.cos(a), r * np.sin(a))
        for a, r in zip(np.arange(10) * np.pi / 5, [2, 1] * 5, strict=True)
    ],
    "needle": outline("0,0 1000,0 1000,1 500,0.25 0,1"),
}


@pytest.mark.parametrize("name", OUTLINES)
@pytest.mark.parametrize("scale", [1.0, 2.0**-660, 2.0**460])
def test_outlines_from_each_corner_and_side(name, scale):
    turn = Rotation.from_rotvec([0.3, 1.0, -0.7]).as_matrix()
    flat = in_space(OUTLINES[name])
    for points in (flat, flat @ turn.T + 1):
        n = len(points)
        for start in range(n):
            polygon = np.roll(np.arange(n), start).tolist()
            if scale == 1:
                check(points, polygon)
                check(points, polygon[::-1])
            else:
                np.testing.assert_array_equal(
                    triangulate(scale * points, [polygon])[0], triangulate(points, [polygon])[0]
                )


@pytest.mark.parametrize("seed", range(40))
def test_star_shaped_outlines(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(4, 60))
    angle = (np.arange(n) + rng.uniform(0, 0.9, n)) * 2 * np.pi / n
    outline = np.c_[np.cos(angle), np.sin(angle)] * rng.uniform(0.05, 1, (n, 1))
    if seed % 2:
        outline = np.stack([outline, (outline + np.roll(outline, -1, 0)) / 2], 1).reshape(-1, 2)
    points = in_space(outline) @ Rotation.random(rng=rng).as_matrix().T
    check(points, np.roll(np.arange(len(points)), int(rng.integers(n))).tolist())


def test_holes_by_bridges():
    ring = [(0, 0), (9, 0), (9, 3), (0, 3)]
    holes = [(x + a, 1 + b) for x in (1, 4) for a, b in ((0, 0), (0, 1), (1, 1), (1, 0))]
    points = in_space(ring + holes)
    polygon = [1, 2, 3, 0, 4, 5, 6, 7, 4, 0]
    check(points[:8], polygon)
    two = [1, 2, 3, 0, 4, 5, 6, 8, 9, 10, 11, 8, 6, 7, 4, 0]
    check(points, two)
    assert surface(points, Polygons.of([two])).area == pytest.approx(9 * 3 - 2)


def test_convex_ones_are_fans_and_mixed_ones_keep_their_order():
    angle = np.arange(7) * 2 * np.pi / 7
    points = np.vstack([in_space(np.c_[np.cos(angle), np.sin(angle)]), in_space(L)])
    polygons = [[2, 3, 4, 5, 6, 0, 1], [8, 9, 10, 11, 12, 7], [0, 1, 2], [3, 5, 6, 1]]
    faces = triangulate(points, polygons)
    np.testing.assert_array_equal(faces[:5], [(2, i % 7, (i + 1) % 7) for i in range(3, 8)])
    assert set(faces[5:9].ravel()) == set(range(7, 13))
    np.testing.assert_array_equal(faces[9:], [(0, 1, 2), (3, 5, 6), (3, 6, 1)])
    np.testing.assert_array_equal(triangulate(points, np.array([[0, 1, 2]])), [(0, 1, 2)])


SQUARE = in_space([(0, 0), (1, 0), (1, 1), (0, 1)])


@pytest.mark.parametrize(
    ("points", "polygon", "n", "area"),
    [
        (in_space([(0, 0), (1, 0), (2, 0), (3, 0)]), [0, 1, 2, 3], 2, 0.0),  # on a line
        (np.zeros((4, 3)), [0, 1, 2, 3], 2, 0.0),
        (SQUARE, [0, 1, 1, 2, 3], 3, 1.0),  # a corner twice
        (SQUARE, [0, 1, 2, 3, 0], 3, 1.0),
        (SQUARE, [0, 1, 2, 1], 0, 0.0),  # there and back
        (SQUARE, [0, 0, 0, 0], 2, 0.0),
    ],
)
def test_degenerate_ones(points, polygon, n, area):
    faces = triangulate(points, [polygon])
    assert len(faces) == n
    a, b, c = (points[faces[:, i]] for i in range(3))
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 == pytest.approx(area)


PENTAGRAM = in_space([(np.cos(a), np.sin(a)) for a in np.arange(5) * 4 * np.pi / 5])


@pytest.mark.parametrize(
    ("points", "polygon", "problem"),
    [
        (SQUARE, [0, 2, 1, 3], "face 1, counted from 0, crosses itself"),
        (np.array([[0, 0, 0], [3, 0, 0], [1, 2, 0], [1, -1, 0.0]]), [0, 1, 2, 3], "face 1"),
        (PENTAGRAM, [0, 1, 2, 3, 4], "face 1, counted from 0, crosses itself"),
        (SQUARE, [0, 1], "at least 3 corners, got one with 2"),
        (SQUARE, [0, 1, 2, 4], r"`faces` must be in \[0, 4\), got 4"),
    ],
)
def test_what_cannot_be_cut_is_refused_by_its_number(points, polygon, problem):
    with pytest.raises(InvalidInputError, match=problem):
        triangulate(points, [[0, 1, 2], polygon])


def test_what_is_far_from_any_plane_is_told():
    crown = in_space([(np.cos(a), np.sin(a)) for a in np.arange(6) * np.pi / 3])
    crown[::2, 2] = 3
    with pytest.warns(IgnoredContentWarning, match="1 polygon cut as if flat.* first being face 1"):
        triangulate(crown, [[0, 1, 2], [0, 1, 2, 3, 4, 5]])
    crown[::2, 2] = 0.1
    assert len(triangulate(crown, [[0, 1, 2, 3, 4, 5]])) == 4


def test_points_that_no_face_uses_may_be_nan():
    points = np.vstack([[np.nan] * 3, SQUARE])
    with pytest.warns(IgnoredContentWarning, match="1 NaN vertex that no face uses.* vertex 0"):
        mesh = surface(points, np.array([[1, 2, 3], [1, 3, 4]]))
    np.testing.assert_array_equal(mesh.points, SQUARE)
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [0, 2, 3]])
    with pytest.raises(InvalidInputError, match=r"finite, got 3 NaN .*without_nan\(\) leaves"):
        surface(points, np.array([[0, 2, 3]]))
