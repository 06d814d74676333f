"""Curvature: closed forms with their rates, laws, libigl's, and what has none."""

import igl
import numpy as np
import pytest
from conftest import bumpy, creature, joined, moebius, moved, refused, two_sheets
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from spectra_kit._core.threads import single_threaded
from spectra_kit.errors import (
    DoubtfulCurvatureWarning,
    DoubtfulMatchWarning,
    InvalidInputError,
)
from spectra_kit.geometry import PointCloud, TriangleMesh, permuted, rectangle, sphere
from spectra_kit.operators import Curvature, curvature, robust_laplacian
from spectra_kit.operators._curvature_kernels import _bend


def scattered(n, width, height):
    """A grid that is shaken: points (n, 2) about evenly in a rectangle, and its triangles."""
    columns, rows = round((n * width / height) ** 0.5), round((n * height / width) ** 0.5)
    i, j = np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij")
    shaken = np.random.default_rng(0).uniform(-0.25, 0.25, (2, columns, rows))
    x, y = width * (i + 0.5 + shaken[0]) / columns, height * (j + 0.5 + shaken[1]) / rows
    number = i * rows + j
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    return np.column_stack([x.ravel(), y.ravel()]), faces


def even_sphere(n, seed=0):
    """Points of a spiral, shaken, and their hull: an irregular mesh of the unit sphere."""
    i = np.arange(n) + 0.5
    height, angle = 1 - 2 * i / n, np.pi * (1 + 5**0.5) * i
    across = np.sqrt(1 - height**2)
    points = np.column_stack([across * np.cos(angle), across * np.sin(angle), height])
    points += n**-0.5 * np.random.default_rng(seed).uniform(-1, 1, points.shape)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    faces = ConvexHull(points).simplices.astype(np.int64)
    a, b, c = np.moveaxis(points[faces], 1, 0)
    inward = np.einsum("fr,fr->f", np.cross(b - a, c - a), a) < 0
    faces[inward] = faces[inward][:, ::-1]
    return points, faces


def on_sphere(n):
    points, faces = even_sphere(n)
    return TriangleMesh(2 * points, faces), np.full((n, 2), 0.5), np.ones(n, dtype=bool)


def on_ellipsoid(n):
    axes = np.array([1.0, 1.3, 0.7])
    points, faces = even_sphere(n)
    points = points * axes
    s = ((points / axes**2) ** 2).sum(axis=1)
    mean = ((axes**2).sum() - (points**2).sum(axis=1)) / (2 * axes.prod() ** 2 * s**1.5)
    gaussian = 1 / (axes.prod() * s) ** 2
    half = np.sqrt(mean**2 - gaussian)
    return TriangleMesh(points, faces), np.c_[mean + half, mean - half], np.ones(n, dtype=bool)


def on_torus(n):
    """The angles of a grid around it, shaken; the triangles of the grid."""
    rows, columns = round((n / 0.5) ** 0.5), round((n * 0.5) ** 0.5)
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    shaken = np.random.default_rng(0).uniform(-0.25, 0.25, (2, rows, columns))
    u, v = 2 * np.pi * (i + shaken[0]) / rows, 2 * np.pi * (j + shaken[1]) / columns
    w = 1 + 0.5 * np.cos(v)
    points = np.stack([w * np.cos(u), w * np.sin(u), 0.5 * np.sin(v)], axis=-1).reshape(-1, 3)
    number = i * columns + j
    a, b = number, np.roll(number, -1, axis=0)
    c, d = np.roll(b, -1, axis=1), np.roll(a, -1, axis=1)
    faces = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    true = np.stack([np.full_like(v, 2.0), np.cos(v) / w], axis=-1).reshape(-1, 2)
    return TriangleMesh(points, faces), true, np.ones(len(points), dtype=bool)


def on_graph(n, height, gradient, hessian):
    """A function over a rectangle around 0; true where its rim is far. Upwards is out."""
    flat, faces = scattered(n, 2.0, 2.0)
    x, y = (flat - 1).T
    p, q = gradient(x, y)
    r, s, t = hessian(x, y)
    l = np.sqrt(1 + p**2 + q**2)
    mean = -((1 + q**2) * r - 2 * p * q * s + (1 + p**2) * t) / (2 * l**3)
    gaussian = (r * t - s**2) / l**4
    half = np.sqrt(np.maximum(mean**2 - gaussian, 0))
    mesh = TriangleMesh(np.column_stack([x, y, height(x, y)]), faces)
    return mesh, np.c_[mean + half, mean - half], np.maximum(abs(x), abs(y)) < 0.6


def on_saddle(n):
    return on_graph(
        n,
        lambda x, y: 0.5 * x**2 - 0.7 * y**2 + 0.2 * x**3,
        lambda x, y: (x + 0.6 * x**2, -1.4 * y),
        lambda x, y: (1 + 1.2 * x, 0 * x, -1.4 + 0 * x),
    )


def on_cylinder(n):
    flat, faces = scattered(n, 2.5, 2.0)
    angle, along = flat.T
    mesh = TriangleMesh(np.c_[np.cos(angle), np.sin(angle), along], faces)
    inside = (abs(angle - 1.25) < 0.8) & (abs(along - 1) < 0.55)
    return mesh, np.tile([1.0, 0.0], (mesh.n, 1)), inside


#: And the power of the spacing with which errors fall: third derivatives do not cancel where
#: neighbours are uneven, and a saddle has most of these.
SURFACES = {on_sphere: 1.7, on_ellipsoid: 1.7, on_torus: 1.7, on_cylinder: 1.7, on_saddle: 0.9}
SIZES = (700, 2000, 6000)


def slope(sizes, errors):
    """The power of the spacing with which errors fall."""
    return -2 * np.polyfit(np.log(sizes), np.log(errors), 1)[0]


def error_of(found, true, inside):
    """Root mean square; an open cloud may be seen from either side."""
    seen = (found.principal, -found.principal[:, ::-1])
    return min(np.sqrt(((k - true)[inside] ** 2).mean()) for k in seen)


@pytest.mark.parametrize("cloud", [False, True], ids=["mesh", "cloud"])
@pytest.mark.parametrize("surface", SURFACES, ids=lambda surface: surface.__name__)
def test_principal_curvatures_converge(surface, cloud):
    errors = []
    for n in SIZES:
        mesh, true, inside = surface(n)
        found = curvature(mesh.as_cloud() if cloud else mesh)
        errors.append(error_of(found, true, inside))
    assert slope(SIZES, errors) > SURFACES[surface], errors
    assert errors[-1] < 0.02 * np.abs(true).max(), errors


def test_directions_and_normals_converge_too():
    tilted, straight = [], []
    for n in SIZES:
        mesh, _, inside = on_cylinder(n)
        found = curvature(mesh)
        around = np.cross([0, 0, 1], mesh.points * [1, 1, 0])
        outwards = mesh.points * [1, 1, 0]
        turned = np.linalg.norm(np.cross(found.directions[:, 0], around), axis=1)
        tilted.append(np.sqrt((turned[inside] ** 2).mean()))
        leaning = np.linalg.norm(found.normals - outwards, axis=1)
        straight.append(np.sqrt((leaning[inside] ** 2).mean()))
        u, v = np.moveaxis(found.directions, 1, 0)
        np.testing.assert_allclose(np.cross(u, v), found.normals, atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(u, axis=1), 1, rtol=1e-12)
    assert slope(SIZES, tilted) > 0.9, tilted
    assert slope(SIZES, straight) > 1.7, straight


def test_at_a_boundary_errors_fall_with_the_spacing():
    errors = []
    for n in SIZES:
        mesh, true, _ = on_cylinder(n)
        rim = np.isin(np.arange(mesh.n), mesh.boundary_vertices)
        errors.append(error_of(curvature(mesh), true, rim))
    assert slope(SIZES, errors) > 0.9, errors


def test_gauss_and_bonnet():
    """The integral of Gaussian curvature is 2 pi (2 - 2 genus)."""
    for surface, whole in ((on_ellipsoid, 4 * np.pi), (on_torus, 0.0)):
        errors = []
        for n in SIZES:
            mesh = surface(n)[0]
            total = robust_laplacian(mesh).mass @ curvature(mesh).gaussian
            errors.append(abs(total - whole) + 1e-9)
        assert slope(SIZES, errors) > 1.6, (surface, errors)


@pytest.mark.parametrize("cloud", [False, True], ids=["mesh", "cloud"])
def test_noise_weighs_in_with_the_third_power_of_the_scale(cloud):
    """Of noise as large as 1 % of the spacing h the n neighbours leave noise / (scale^2 n^1/2)."""
    flat, faces = scattered(4000, 2.0, 2.0)
    h = np.sqrt(4 / len(flat))
    noise = 0.01 * h * np.random.default_rng(1).standard_normal(len(flat))
    mesh = TriangleMesh(np.column_stack([flat, noise]), faces)
    inside = np.abs(flat - 1).max(axis=1) < 0.6
    reach = np.array([3.0, 4.5, 6.75])
    found = [curvature(mesh.as_cloud() if cloud else mesh, scale=r * h) for r in reach]
    rough = [np.sqrt((one.principal[inside] ** 2).mean()) for one in found]
    assert -np.polyfit(np.log(reach), np.log(rough), 1)[0] == pytest.approx(3, abs=0.3), rough
    assert rough[0] < 0.01 / h


def test_noise_of_a_hundredth_of_an_edge_on_a_torus():
    mesh, true, inside = on_torus(4000)
    edge = np.sqrt(mesh.area / mesh.n)
    noise = 0.01 * edge * np.random.default_rng(0).standard_normal((mesh.n, 1))
    rough = mesh.with_points(mesh.points + noise * curvature(mesh).normals)
    assert error_of(curvature(rough), true, inside) < 0.05 * np.abs(true).max()


@pytest.mark.parametrize("cloud", [False, True], ids=["mesh", "cloud"])
def test_laws(cloud):
    mesh = bumpy()
    shape = mesh.as_cloud() if cloud else mesh
    found = curvature(shape)
    turn = Rotation.from_euler("xyz", [0.4, -0.7, 1.1]).as_matrix()
    rigid = curvature(shape.with_points(shape.points @ turn.T + [5, 6, 7]))
    np.testing.assert_allclose(rigid.principal, found.principal, atol=1e-6)
    np.testing.assert_allclose(rigid.normals, found.normals @ turn.T, atol=1e-6)
    for unit in (1e-8, 1e8, 1e100):
        scaled = curvature(shape.with_points(unit * shape.points))
        np.testing.assert_allclose(unit * scaled.principal, found.principal, rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(scaled.scale, unit * found.scale, rtol=1e-9)
    other, index = permuted(shape, seed=1)
    np.testing.assert_allclose(curvature(other).principal, found.principal[index], atol=1e-6)
    mirrored = curvature(shape.with_points(shape.points * [1, 1, -1]))
    np.testing.assert_allclose(mirrored.principal, found.principal, atol=1e-6)
    with single_threaded():
        np.testing.assert_array_equal(curvature(shape).principal, found.principal)


def test_windings_do_not_matter():
    mesh = bumpy()
    found = curvature(mesh)
    np.testing.assert_array_equal(
        curvature(TriangleMesh(mesh.points, mesh.faces[:, ::-1])).mean > 0, found.mean > 0
    )
    faces = mesh.faces.copy()
    faces[::7] = faces[::7, ::-1]
    with pytest.warns(DoubtfulMatchWarning, match="wound against the others"):
        mixed = curvature(TriangleMesh(mesh.points, faces))
    np.testing.assert_allclose(mixed.principal, found.principal, atol=1e-9)


def test_parts_have_what_they_have_alone():
    mesh = bumpy()
    inside_out = TriangleMesh(mesh.points, mesh.faces[:, ::-1])
    both = curvature(joined(mesh, moved(inside_out, 9, 9, 9, scale=1e-3)))
    alone = curvature(mesh).principal
    np.testing.assert_allclose(both.principal[: mesh.n], alone, atol=1e-9)
    np.testing.assert_allclose(1e-3 * both.principal[mesh.n :], alone, atol=1e-6)


def test_neighbours_are_not_found_across_a_gap_nor_on_the_other_side():
    apart = 0.02  # much less than the spacing
    lid = rectangle(n=400).geometry
    two = joined(lid, moved(lid, 0, 0, apart))
    assert np.abs(curvature(two).principal).max() < 1e-9
    foil = two_sheets(n=400, apart=apart)  # the same lid, and another that meets it at its rim
    with pytest.warns(DoubtfulCurvatureWarning, match="at which the normals of faces cancel"):
        found = curvature(foil)
    inside = np.setdiff1d(np.arange(lid.n), lid.boundary_vertices)
    assert np.abs(found.principal[inside]).max() < 1e-9
    assert np.isnan(found.mean[lid.boundary_vertices]).all()


def test_libigls_curvature_of_three_rings():
    """Theirs passes through each point, unweighted; on smooth surfaces both see the same."""
    for surface in (on_ellipsoid, on_torus):
        mesh, true, _ = surface(6000)
        *_, one, other, _ = igl.principal_curvature(np.array(mesh.points), np.array(mesh.faces), 3)
        theirs = np.sort(np.column_stack([one, other]), axis=1)[:, ::-1]
        ours = curvature(mesh).principal
        assert np.abs(ours - theirs).mean() < 0.02 * np.abs(true).max()


def test_points_where_it_is_not_known_are_told():
    sheet = rectangle(n=441, height=1.0).geometry
    wall = sheet.points @ [[1, 0, 0], [0, 1, 1], [0, 0, 0]] + [0, 0.5, 0]  # at half a right angle
    middle = np.isclose(sheet.points[:, 1], 0.5)
    line = np.flatnonzero(middle)
    assert len(line)
    whole = joined(sheet, TriangleMesh(wall, sheet.faces))
    label = np.arange(whole.n)
    foot = np.flatnonzero(np.isclose(wall[:, 2], 0))
    for v, w in zip(line, foot, strict=True):
        label[sheet.n + w] = v
    crossing = TriangleMesh(whole.points, label[whole.faces]).without_unreferenced()
    with pytest.warns(DoubtfulCurvatureWarning, match="whose faces are no single fan"):
        found = curvature(crossing)
    assert np.isnan(found.mean[line]).all()
    assert np.abs(found.principal[np.setdiff1d(np.arange(crossing.n), line)]).max() < 1e-9
    one = sphere(subdivisions=3).geometry
    tip = one.points[0]
    two = joined(one, moved(one, *(2 * tip)))
    label = np.arange(two.n)
    label[one.n + np.argmin(one.points @ tip)] = 0  # they touch there, in a point of two fans
    with pytest.warns(DoubtfulCurvatureWarning, match=r"at 1 point, .*no single fan"):
        found = curvature(TriangleMesh(two.points, label[two.faces]).without_unreferenced())
    assert np.isnan(found.mean[0])
    np.testing.assert_allclose(found.mean[1:], 1, atol=0.1)


def test_at_the_tip_of_a_needle_no_plane_is_tangent():
    angle = 2 * np.pi * np.arange(12) / 12
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.full(12, -20.0)])
    fan = np.column_stack([np.full(12, 12), np.arange(12), (np.arange(12) + 1) % 12])
    needle = TriangleMesh(np.vstack([ring, np.zeros((1, 3))]), fan)
    with pytest.raises(InvalidInputError, match="1 at which the normals of faces cancel"):
        curvature(needle)


def test_a_steep_quadric_bends_as_its_fundamental_forms_tell():
    b, scale = np.array([0.3, 1.2, -0.7, 0.5, 0.3, -0.4]), 0.1
    principal, directions, normal = np.empty(2), np.empty((2, 3)), np.empty(3)
    _bend(b, scale, *np.eye(3), principal, directions, normal)
    slope, second = b[1:3], b[[3, 4, 4, 5]].reshape(2, 2) / scale
    first = np.eye(2) + np.outer(slope, slope)
    length = np.sqrt(1 + slope @ slope)
    true = np.linalg.eigvals(np.linalg.solve(first, -second / length))
    np.testing.assert_allclose(principal, np.sort(true)[::-1], rtol=1e-12)
    np.testing.assert_allclose(normal, np.append(-slope, 1) / length, rtol=1e-12)
    # A direction is a step (x, y) in the plane, of which the surface makes its height.
    np.testing.assert_allclose(directions[:, 2], directions[:, :2] @ slope, rtol=1e-12)
    for k, x in zip(principal, directions[:, :2], strict=True):
        np.testing.assert_allclose(-second @ x / length, k * first @ x, rtol=1e-10)


def test_a_one_sided_strip_has_it_up_to_its_sign():
    strip = moebius(200, 20)
    with (
        pytest.warns(DoubtfulMatchWarning, match="no turning makes faces agree"),
        pytest.warns(DoubtfulCurvatureWarning, match="of one winding"),
    ):
        found = curvature(strip)
    known = ~np.isnan(found.mean)
    assert 0.9 < known.mean() < 1
    assert (found.gaussian[known] < 0.05).all()  # it is twisted


def test_needles_and_triangles_without_area():
    """Three points on a line make a face that says nothing."""
    ball = sphere(subdivisions=3).geometry
    a, b, _ = ball.faces[0]
    middle = (ball.points[a] + ball.points[b]) / 2
    points = np.vstack([ball.points, middle])
    found = curvature(TriangleMesh(points[:-1], ball.faces))
    assert np.isfinite(found.principal).all()
    with pytest.warns(DoubtfulCurvatureWarning, match="first is 0"):
        found = curvature(TriangleMesh(points, np.vstack([ball.faces, [a, b, 642]])))
    assert np.isnan(found.mean).sum() <= 3


@pytest.mark.parametrize(
    ("shape", "scale", "argument", "expected"),
    [
        (TriangleMesh(np.eye(3), [[0, 1, 2]]), None, "geometry", "have a point of known"),
        (sphere(subdivisions=2).geometry, 0.01, "scale", "reach neighbours enough, got 0.01; two"),
        (sphere(subdivisions=2).geometry, 3.0, "scale", "be smaller than the shape, got 3 beside"),
        (sphere(subdivisions=2).geometry, 0.0, "scale", "be positive"),
        (TriangleMesh(np.eye(4, 3), [[0, 1, 2]]), None, "mesh", "have a face at every vertex"),
        (PointCloud(np.outer(np.arange(9.0), [1, 2, 3])), None, "geometry", "be a surface"),
        (PointCloud(np.eye(3)), None, "geometry", "have at least 4 points"),
    ],
)
def test_what_is_refused(shape, scale, argument, expected):
    refused(argument, expected, curvature, shape, scale=scale)


def test_a_scale_that_is_too_small_somewhere():
    ball = sphere(subdivisions=4).geometry
    flat, faces = scattered(100, 2.0, 2.0)
    both = joined(ball, moved(TriangleMesh(np.c_[flat, 0 * flat[:, 0]], faces), 3, 0, 0))
    with pytest.warns(DoubtfulCurvatureWarning, match=r"fewer than five .*; raise `scale`$"):
        found = curvature(both, scale=0.2)
    assert np.isfinite(found.principal[: ball.n]).all()
    assert np.isnan(found.principal[ball.n :]).all()


def test_a_cloud_whose_sheets_are_confused_is_told():
    filled = PointCloud(np.random.default_rng(0).random((500, 3)))
    with (
        pytest.warns(DoubtfulCurvatureWarning, match="which side of the cloud is out is in doubt"),
        pytest.warns(DoubtfulCurvatureWarning, match="is not known"),
    ):
        curvature(filled)


def test_records_are_read_only_and_of_one_length():
    found = curvature(creature(2000))
    assert found.n == 2000
    np.testing.assert_allclose(found.mean, found.principal.sum(axis=1) / 2)
    np.testing.assert_allclose(found.gaussian, found.principal[:, 0] * found.principal[:, 1])
    assert (found.principal[:, 0] >= found.principal[:, 1]).all()
    with pytest.raises(ValueError, match="read-only"):
        found.principal[0] = 0
    refused(
        "normals", r"have shape (1, 3)", Curvature, [[1, 1]], np.zeros((1, 2, 3)), [[0, 1]], [1]
    )
