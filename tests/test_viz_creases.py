"""A mesh is drawn sharp along its creases, and smooth where it only has few triangles."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from spectra_kit.errors import MissingDependencyError
from spectra_kit.geometry import TriangleMesh, sphere
from spectra_kit.viz.creases import split_along_creases
from spectra_kit.viz.render import Scene, render

CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
QUADS = np.array(
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
)
CUBE = TriangleMesh(CORNERS, np.vstack([QUADS[:, :3], QUADS[:, [0, 2, 3]]]))


def roof(degrees, columns=4):
    """Two flat sheets that meet along the y axis and bend there by so many degrees."""
    x, y = np.meshgrid(np.arange(-columns, columns + 1.0), np.arange(6.0), indexing="ij")
    half = np.deg2rad(degrees / 2)
    points = np.stack([x * np.cos(half), y, -np.abs(x) * np.sin(half)], axis=2).reshape(-1, 3)
    cell = np.arange(len(points)).reshape(x.shape)
    a, b, c, d = cell[:-1, :-1], cell[1:, :-1], cell[1:, 1:], cell[:-1, 1:]
    faces = np.concatenate([np.stack(t, axis=2).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    return TriangleMesh(points, faces)


def split(mesh):
    """The doubled vertices, after a check that the triangles are where they were."""
    owner, faces = split_along_creases(mesh.points, mesh.faces)
    np.testing.assert_array_equal(owner[faces], mesh.faces)
    counts = np.bincount(owner, minlength=mesh.n)
    return np.repeat(np.arange(mesh.n), np.maximum(counts - 1, 0))


def test_a_corner_of_a_cube_is_three():
    np.testing.assert_array_equal(split(CUBE), np.repeat(np.arange(8), 2))


@pytest.mark.parametrize(("degrees", "sharp"), [(90, True), (60, True), (45, True), (30, False)])
def test_a_fold_between_flat_sheets_is_sharp(degrees, sharp):
    mesh = roof(degrees)
    ridge = np.flatnonzero(np.abs(mesh.points[:, 0]) < 1e-12)
    np.testing.assert_array_equal(split(mesh), ridge if sharp else [])


def test_few_triangles_alone_make_no_crease():
    """Every edge of an icosahedron bends by 41.8 degrees."""
    assert len(split(sphere(subdivisions=0).geometry)) == 0


def test_three_faces_at_an_edge_and_one_without_area_do_no_harm():
    points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0.1], [0, 0, 1], [2, 0, 0]]
    fins = TriangleMesh(points, [[0, 1, 2], [1, 0, 3], [0, 1, 4], [0, 1, 5]])
    assert set(split(fins)) <= {0, 1}


def shade(mesh, turn):
    """The grey of a mesh that is turned about the y axis, along the middle of its picture."""
    grey = np.full((mesh.n, 3), 200, dtype=np.uint8)
    view = Rotation.from_euler("y", turn, degrees=True).as_matrix()
    (picture,) = render([Scene(geometry=mesh, functions=[grey], rotation=view, width=96)])[0]
    return picture[len(picture) // 2, 8:-8, 0].astype(int)


def test_a_fold_is_seen_as_a_step_and_a_coarse_ball_has_none():
    try:
        steps = np.abs(np.diff(shade(roof(60), 40)))
    except MissingDependencyError:
        pytest.skip("no OpenGL library on this machine")
    assert steps.max() > 15
    assert (steps > 2).sum() <= 2  # in one place, and between it is flat
    assert np.abs(np.diff(shade(sphere(subdivisions=0).geometry, 0))).max() < 8
