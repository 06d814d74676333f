"""Oriented triangles, and what is integrated over them."""

import numpy as np
import pytest
from conftest import creature, moebius, refused

from spectra_kit import PointCloud, TriangleMesh
from spectra_kit.errors import DoubtfulMatchWarning
from spectra_kit.geometry import disk, rectangle, sample_with_origin, sphere
from spectra_kit.operators.oriented import (
    OrientedTriangles,
    area_form,
    orientation_operator,
    oriented_triangles,
    skew,
)

FLIP = [0, 2, 1]
MIRROR = np.array([1.0, -1.0, 1.0])


def volume_of(mesh: TriangleMesh) -> float:
    return np.linalg.det(mesh.points[mesh.faces]).sum() / 6


def smooth_functions(points: np.ndarray, k: int = 5, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.sin(points @ rng.standard_normal((3, k)) + rng.standard_normal(k))


# --- meshes ---------------------------------------------------------------------------------


@pytest.mark.parametrize("flipped", [False, True])
@pytest.mark.parametrize("mirror", [1, -1])
def test_closed_meshes_are_turned_outwards_and_mirrors_change_the_form(flipped, mirror) -> None:
    mesh = creature(600)
    points = mesh.points * [1, mirror, 1]
    oriented = oriented_triangles(
        TriangleMesh(points, mesh.faces[:, FLIP] if flipped else mesh.faces)
    )
    assert volume_of(TriangleMesh(points, oriented.faces)) == pytest.approx(volume_of(mesh))
    assert (oriented.weights == 1).all()
    assert oriented.consistent == 1
    functions = smooth_functions(mesh.points)
    form = area_form(oriented_triangles(mesh), functions)
    assert np.allclose(area_form(oriented, functions), mirror * form, atol=1e-14)
    assert np.abs(form).max() > 0.1


def test_pieces_that_share_one_vertex_are_turned_on_their_own() -> None:
    ball = sphere(subdivisions=1).geometry
    touch = int(np.argmin(np.linalg.norm(ball.points + ball.points[0], axis=1)))
    faces = np.vstack([ball.faces, ball.faces[:, FLIP] + ball.n])
    faces[faces == ball.n] = touch  # vertex 0 of the other ball
    points = np.vstack([ball.points, ball.points - 2 * ball.points[0]])
    mesh = TriangleMesh(points, faces).without_unreferenced()
    assert volume_of(mesh) == pytest.approx(0, abs=1e-12)
    turned = TriangleMesh(mesh.points, oriented_triangles(mesh).faces)
    assert volume_of(turned) == pytest.approx(2 * volume_of(ball))


@pytest.mark.parametrize("mirror", [1, -1])
def test_a_mesh_with_a_hole_is_turned_outwards(mirror) -> None:
    """As if the hole were closed: however its faces came, and in a mirror too."""
    ball = sphere(subdivisions=3).geometry
    points = ball.points * [mirror, 1.0, 1.0]
    kept = ball.faces[points[ball.faces].mean(axis=1)[:, 2] < 0.7]
    for faces in (kept, kept[:, FLIP]):
        mesh = TriangleMesh(points, faces).without_unreferenced()
        turned = TriangleMesh(mesh.points, oriented_triangles(mesh).faces)
        outwards = np.einsum(
            "fr,fr->f",
            np.cross(*np.moveaxis(np.diff(turned.points[turned.faces], axis=1), 1, 0)),
            turned.points[turned.faces].mean(axis=1),
        )
        assert (outwards > 0).all()


def test_flat_meshes_and_pillows_keep_their_winding() -> None:
    flat, sheet = disk().geometry, rectangle(n=50).geometry
    turned = TriangleMesh(flat.points, flat.faces[:, FLIP])
    wavy = sheet.with_points(sheet.points + 1e-3 * np.sin(3 * sheet.points[:, :1]) * [0, 0, 1])
    other = TriangleMesh(wavy.points, wavy.faces[:, FLIP])
    pillow = TriangleMesh(sheet.points, np.vstack([sheet.faces, sheet.faces[:, FLIP]]))
    odd = TriangleMesh(np.eye(5)[:, :3], [[0, 1, 2], [1, 0, 3], [0, 1, 4]])  # one hangs on an edge
    for mesh in (flat, turned, wavy, other, pillow, odd):
        assert (oriented_triangles(mesh).faces == mesh.faces).all()


@pytest.mark.parametrize("every", [3, 7, 600])
@pytest.mark.parametrize("mirror", [1, -1])
def test_faces_of_mixed_winding_are_turned_as_their_neighbours_are(every: int, mirror: int) -> None:
    mesh = creature(600)
    points, faces = mesh.points * [1, mirror, 1], np.array(mesh.faces)
    faces[::every] = faces[::every, FLIP]
    with pytest.warns(DoubtfulMatchWarning, match=r"faces? wound against .* geometry.repair"):
        oriented = oriented_triangles(TriangleMesh(points, faces))
    truth = oriented_triangles(mesh.with_points(points))
    assert (oriented.faces == truth.faces).all()
    assert oriented.consistent == 1


def test_where_no_turning_helps_it_is_told_and_the_rest_is_oriented() -> None:
    """A ball beside a Möbius strip: the ball has its inside."""
    ball, strip = sphere(subdivisions=3).geometry, moebius()
    points = np.vstack([ball.points, strip.points + [3, 0, 0]])
    faces = np.vstack([ball.faces, strip.faces + ball.n])
    with pytest.warns(DoubtfulMatchWarning, match="edges at which no turning") as told:
        oriented = oriented_triangles(TriangleMesh(points, faces))
    assert len(told) == 1
    assert 0.9 < oriented.consistent < 1
    assert volume_of(TriangleMesh(points, oriented.faces[: len(ball.faces)])) == pytest.approx(
        volume_of(ball)
    )
    assert "repair" not in str(told[0].message)  # which would change nothing


# --- clouds ---------------------------------------------------------------------------------


def relative_error(form: np.ndarray, truth: np.ndarray) -> float:
    return float(np.linalg.norm(form - truth) / np.linalg.norm(truth))


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_the_area_form_of_a_cloud_is_near_that_of_its_mesh(mirror: float) -> None:
    for mesh, error in ((sphere(subdivisions=3).geometry, 1e-6), (creature(1500), 0.06)):
        f = smooth_functions(mesh.points)
        oriented = oriented_triangles(PointCloud(mesh.points * [1000, 1000, 1000 * mirror] + 7))
        assert oriented.consistent > 0.99
        assert oriented.n == mesh.n
        assert (oriented.weights == 1 / 3).all()
        truth = mirror * area_form(oriented_triangles(mesh), f)
        assert relative_error(area_form(oriented, f), truth) < error
        assert oriented.weights @ oriented.areas == pytest.approx(1e6 * mesh.area, rel=0.02)


def test_random_points_of_an_animal_are_oriented_outwards() -> None:
    mesh = creature(1500)
    samples, f = sample_with_origin(mesh, 2000, seed=0), smooth_functions(mesh.points)
    form = area_form(oriented_triangles(samples.cloud), samples.interpolate(f))
    assert relative_error(form, area_form(oriented_triangles(mesh), f)) < 0.1


@pytest.mark.parametrize("size", [1.0, 1e-3, 1e-20])
def test_components_of_a_cloud_are_oriented_on_their_own(size: float) -> None:
    ball = sphere(subdivisions=3).geometry.points
    triangles = oriented_triangles(PointCloud(np.vstack([size * ball, ball * [1, -1, 1] + 5])))
    corners = np.vstack([ball, ball * [1, -1, 1]])[triangles.faces]
    volumes = np.linalg.det(corners) / 18  # all three windings of each
    first = triangles.faces[:, 0] < len(ball)
    for part in (first, ~first):
        assert volumes[part].sum() == pytest.approx(4 * np.pi / 3, rel=0.02)


def test_near_sheets_are_told_apart_down_to_the_spacing_of_their_points() -> None:
    rng = np.random.default_rng(0)
    flat = [rng.random((400, 2)) for _ in range(2)]  # a spacing of 0.05

    def slab(gap: float) -> tuple[OrientedTriangles, np.ndarray]:
        points = np.vstack([np.c_[f, np.full(400, z)] for f, z in zip(flat, (0, gap), strict=True)])
        oriented = oriented_triangles(PointCloud(points))
        a, b, c = (points[oriented.faces[:, i]] for i in range(3))
        return oriented, np.cross(b - a, c - a)[:, 2] * np.sign(a[:, 2] - gap / 2)

    apart, outwards = slab(0.2)
    assert apart.consistent > 0.99
    assert (outwards >= 0).mean() > 0.99
    assert slab(0.07)[0].consistent < 0.9
    one, _ = slab(0.01)  # two sheets are taken for one
    assert one.weights @ one.areas == pytest.approx(1, abs=0.1)


# --- integrals ------------------------------------------------------------------------------


def test_area_form_is_the_enclosed_volume_to_machine_precision() -> None:
    mesh = creature(600)
    x = mesh.points
    form = area_form(oriented_triangles(mesh), x)
    levi_civita = np.zeros((3, 3, 3))
    levi_civita[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1
    levi_civita[[0, 2, 1], [2, 1, 0], [1, 0, 2]] = -1
    assert np.allclose(form, volume_of(mesh) * levi_civita, atol=1e-13)


def test_area_form_and_orientation_operator_match_quadrature() -> None:
    mesh = rectangle(n=60).geometry
    f = smooth_functions(mesh.points, 4)
    oriented = oriented_triangles(mesh)
    form, operators = area_form(oriented, f), orientation_operator(oriented, f, f[:, :2])
    expected = 0.0
    for i, j, k in mesh.faces:
        corners = mesh.points[[i, j, k], :2]
        slope = np.linalg.solve(corners[1:] - corners[0], f[[j, k], :3] - f[i, :3])
        area = np.linalg.det(corners[1:] - corners[0]) / 2
        expected += f[[i, j, k], 0].mean() * area * np.linalg.det(slope[:, 1:])
    assert form[0, 1, 2] == pytest.approx(expected, rel=1e-12)
    assert np.abs(form + form.transpose(0, 2, 1)).max() == 0
    assert operators.shape == (2, 4, 4)
    assert np.allclose(operators, form.transpose(1, 0, 2)[:2], atol=1e-14)


def test_weights_count() -> None:
    mesh = sphere(subdivisions=1).geometry
    thrice = OrientedTriangles(
        np.tile(mesh.faces, (3, 1)),
        np.full(3 * len(mesh.faces), 1 / 3),
        np.tile(mesh.face_areas, 3),
        mesh.n,
    )
    once = oriented_triangles(mesh)
    f = smooth_functions(mesh.points)
    assert np.allclose(area_form(thrice, f), area_form(once, f))
    assert np.allclose(skew(thrice, f[:, :2], f[:, 2:4]), skew(once, f[:, :2], f[:, 2:4]))
    opposite = area_form(once.reversed(), f)
    assert np.allclose(opposite, -area_form(once, f))


def test_skew_on_the_sphere_is_the_third_coordinate() -> None:
    # n . (grad x  x  grad y) = n . (e_x x e_y) = z
    mesh = sphere(subdivisions=4).geometry
    x, y, z = mesh.points.T
    value = skew(oriented_triangles(mesh), x, y)
    assert np.abs(value - z).max() < 0.01
    assert np.allclose(skew(oriented_triangles(mesh), y, x), -value)
    mirror = oriented_triangles(mesh.with_points(mesh.points * MIRROR))
    assert np.allclose(skew(mirror, x, y), -value)
    both = skew(oriented_triangles(mesh), np.c_[x, y], np.c_[y, z])
    assert np.allclose(both[:, 0], value)
    assert np.abs(both[:, 1] - x).max() < 0.01


ONE, BALL = [[0, 1, 2]], oriented_triangles(sphere(subdivisions=1).geometry)


@pytest.mark.parametrize(
    ("call", "given", "argument", "expected"),
    [
        (OrientedTriangles, (ONE, [1.0], [-1.0], 3), "areas", "hold 1 number >= 0"),
        (OrientedTriangles, (ONE, [0.0], [1.0], 3), "weights", "be positive"),
        (OrientedTriangles, ([[0, 1, 3]], [1.0], [1.0], 3), "faces", "be in [0, 3)"),
        (OrientedTriangles, (ONE, [1.0], [1.0], 2), "n", "be at least 3"),
        (area_form, (BALL, np.ones((41, 2))), "functions", "have shape (42, k)"),
        (
            orientation_operator,
            (BALL, np.ones((2, 42)), np.ones(42)),
            "basis",
            "have shape (42, k)",
        ),
        (skew, (BALL, np.ones(42), np.ones((42, 2))), "g", "have as many columns as `f`"),
    ],
)
def test_bad_input(call, given, argument, expected) -> None:
    refused(argument, expected, call, *given)
    flat = OrientedTriangles(ONE, [1.0], [0.0], 3)
    assert (skew(flat, [0.0, 1, 2], [0.0, 2, 4]) == 0).all()
