"""Smoothing: exact on modes, volumes and planes kept, and what cannot be smoothed."""

import numpy as np
import pytest
from conftest import bumpy, creature, joined, moebius, moved, refused, two_parts
from scipy.spatial.transform import Rotation

from spectra_kit import (
    Dense,
    PointCloud,
    TriangleMesh,
    delaunay_laplacian,
    eigensolve,
    intrinsic_delaunay,
)
from spectra_kit.geometry import permuted, rectangle, sample, sphere, torus
from spectra_kit.operators import area_form, oriented_triangles, smooth


def volume(mesh):
    return area_form(oriented_triangles(mesh), mesh.points)[0, 1, 2]


def shaken(sheet, *, rim=False):
    """The same in the plane, uneven inside, and at its rim, too."""
    moves = np.random.default_rng(0).uniform(-0.01, 0.01, (sheet.n, 2))
    if not rim:
        moves[sheet.boundary_vertices] = 0
    return sheet.with_points(sheet.points + np.c_[moves, np.zeros(sheet.n)])


@pytest.mark.parametrize(
    ("cloud", "boundary", "steps"), [(False, "free", 1), (True, "free", 1), (False, "held", 3)]
)
def test_ripples_of_a_plane_are_divided_by_one_plus_lambda_t(cloud, boundary, steps):
    """So small ones that the metric is that of the plane; a free sheet draws in at a step."""
    sheet = shaken(rectangle(n=500).geometry, rim=True)
    shape = sheet.as_cloud() if cloud else sheet
    flat = intrinsic_delaunay(shape)
    held = [] if boundary == "free" else sheet.boundary_vertices
    modes = eigensolve(flat.laplacian.dirichlet(np.array(held, dtype=int)), 60, Dense())
    for k in (5, 20, 59):
        ripple = 1e-9 * modes.eigenvectors[:, k]
        rough = shape.with_points(shape.points + np.outer(ripple, [0, 0, 1]))
        found = smooth(rough, time=0.03, steps=steps, boundary=boundary)
        expected = ripple / (1 + 0.03 / steps * modes.eigenvalues[k]) ** steps
        np.testing.assert_allclose(found.points[:, 2], expected, atol=1e-15)


def test_ripples_of_a_sphere_fade_as_its_normals_tell():
    """On the unit sphere mean curvature flow takes ``(lambda - 2) t`` of a short ripple."""
    ball, t = sphere(subdivisions=3).geometry, 1e-4
    modes = eigensolve(delaunay_laplacian(ball), 50, Dense())
    for k in (8, 20, 49):
        ripple = modes.eigenvectors[:, k]
        rough = ball.with_points(ball.points * (1 + 1e-6 * ripple[:, None]))
        plain, found = (smooth(one, time=t, volume="free").points for one in (ball, rough))
        out = np.einsum("nr,nr->n", found - plain, ball.points) / 1e-6
        shrunk = 1 - np.average(np.linalg.norm(plain, axis=1), weights=modes.mass)
        assert shrunk / t == pytest.approx(2, rel=0.01)
        lost = (1 - modes.project(out)[k]) / t
        assert lost == pytest.approx(modes.eigenvalues[k] - 2, rel=0.03)


@pytest.mark.parametrize("cloud", [False, True], ids=["mesh", "cloud"])
def test_a_plane_stays_where_it_is(cloud):
    sheet = shaken(rectangle(n=400).geometry)
    turn = Rotation.from_euler("xyz", [0.4, -0.7, 1.1]).as_matrix()
    points = sheet.points @ turn.T
    shape = PointCloud(points) if cloud else TriangleMesh(points, sheet.faces)
    found = smooth(shape, time=0.5, steps=2)
    assert type(found) is type(shape)
    np.testing.assert_allclose((found.points @ turn)[:, 2], 0, atol=1e-12)
    if not cloud:
        np.testing.assert_allclose(found.points, points, atol=1e-12)


@pytest.mark.parametrize("time", [1e-3, 0.1, 0.5])
def test_volumes_of_closed_parts_are_kept(time):
    both = joined(bumpy(), moved(torus(n=500).geometry, 9, 0, 0, scale=0.1))
    inside_out = TriangleMesh(both.points, both.faces[:, ::-1])
    for mesh in (both, inside_out):
        found = smooth(mesh, time=time, steps=3 if time < 1 else 1)
        np.testing.assert_array_equal(found.faces, mesh.faces)
        assert volume(found) == pytest.approx(volume(mesh), rel=1e-10)
    free = smooth(both, time=time, volume="free")
    assert volume(free) < volume(both) * (1 - 1e-4)


def test_a_thin_rod_is_not_lengthened():
    """All its radius is less than a ripple that fades: it thins, and is widened again."""
    ball = sphere(subdivisions=3).geometry
    rod = ball.with_points(ball.points * [1.0, 0.02, 0.02])
    found = smooth(rod)
    assert volume(found) == pytest.approx(volume(rod), rel=1e-10)
    assert np.ptp(found.points[:, 0]) < 2


def test_the_centre_of_the_area_stays():
    mesh = bumpy()
    mass = delaunay_laplacian(mesh).mass
    found = smooth(mesh, time=0.2, volume="free")
    np.testing.assert_allclose(mass @ found.points, mass @ mesh.points, atol=1e-10)


def test_at_a_volume_that_is_kept_the_area_falls_to_that_of_a_ball():
    mesh = sphere(subdivisions=3).geometry
    long = mesh.with_points(mesh.points * [1.0, 1.3, 1.7])
    excess = []
    for _ in range(6):
        excess.append(long.area / (36 * np.pi * volume(long) ** 2) ** (1 / 3) - 1)
        long = smooth(long, time=0.1, steps=5)
    assert (np.diff(excess) < 0).all(), excess
    assert excess[-1] < 0.5 * excess[0], excess


def test_fixed_points_and_boundaries_stay():
    mesh = creature(800)
    fixed = [3, 50, 700]
    found = smooth(mesh, fixed=fixed, steps=2)
    np.testing.assert_array_equal(found.points[fixed], mesh.points[fixed])
    mask = np.isin(np.arange(mesh.n), fixed)
    np.testing.assert_array_equal(smooth(mesh, fixed=mask, steps=2).points, found.points)
    assert volume(found) == pytest.approx(volume(mesh), rel=1e-10)
    sheet = rectangle(n=300).geometry
    bent = sheet.with_points(sheet.points + np.outer(np.sin(5 * sheet.points[:, 0]), [0, 0, 0.3]))
    rim = bent.boundary_vertices
    np.testing.assert_array_equal(smooth(bent).points[rim], bent.points[rim])
    assert np.abs(smooth(bent, boundary="free").points[rim] - bent.points[rim]).max() > 1e-3


def test_a_soap_film_across_two_rings_is_a_catenoid():
    """Held boundaries and a long flow: a minimal surface, here of revolution."""
    rows, columns, height = 21, 60, 0.5
    u, z = np.meshgrid(2 * np.pi * np.arange(columns) / columns, np.linspace(-height, height, rows))
    waist = 0.8483379380  # of a chain through (1, 1/2): cosh(0.5 / waist) * waist == 1
    assert waist * np.cosh(height / waist) == pytest.approx(1, abs=1e-6)
    points = np.stack([np.cos(u), np.sin(u), z], axis=-1).reshape(-1, 3)
    a = np.arange(rows * columns).reshape(rows, columns)[:-1]
    b, c, d = np.roll(a, -1, 1), np.roll(a, -1, 1) + columns, a + columns
    faces = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    film = smooth(TriangleMesh(points, faces), time=3.0, steps=30)
    across = np.hypot(*film.points[:, :2].T)
    np.testing.assert_allclose(across, waist * np.cosh(film.points[:, 2] / waist), rtol=5e-3)


@pytest.mark.parametrize("cloud", [False, True], ids=["mesh", "cloud"])
def test_laws(cloud):
    mesh = creature(600)
    shape = sample(mesh, 700, seed=0) if cloud else mesh
    time = 1e-4 * mesh.area
    found = smooth(shape, time=time, steps=2)
    turn = Rotation.from_euler("xyz", [0.4, -0.7, 1.1]).as_matrix()
    rigid = smooth(shape.with_points(shape.points @ turn.T + [3, 1, 2]), time=time, steps=2)
    np.testing.assert_allclose(rigid.points, found.points @ turn.T + [3, 1, 2], atol=1e-5)
    for unit in (2.0**-30, 2.0**30, 2.0**300):
        scaled = smooth(shape.with_points(unit * shape.points), time=unit**2 * time, steps=2)
        np.testing.assert_allclose(scaled.points / unit, found.points, atol=1e-9)
    other, index = permuted(shape, seed=1)
    again = smooth(other, time=time, steps=2)
    np.testing.assert_allclose(again.points, found.points[index], atol=1e-5)


def test_the_default_time_halves_ripples_of_six_edges():
    flat = rectangle(n=6000, width=2.0, height=2.0).geometry
    edge = np.sqrt(flat.area / flat.n) * (2 + 2**0.5) / 3  # sides and diagonals of a grid
    wave = 1e-6 * np.sin(flat.points[:, 0] / edge)
    found = smooth(flat.with_points(flat.points + np.outer(wave, [0, 0, 1])))
    inside = np.abs(flat.points[:, :2] - 1).max(axis=1) < 0.5
    before, after = wave[inside], found.points[inside, 2]
    assert before @ after == pytest.approx(0.5 * before @ before, rel=0.05)


def test_one_sided_strips_and_what_has_nothing_free():
    found = smooth(moebius(), steps=2)
    assert np.isfinite(found.points).all()
    triangle = TriangleMesh(np.eye(3), [[0, 1, 2]])
    np.testing.assert_array_equal(smooth(triangle).points, triangle.points)


def test_what_is_refused():
    mesh = two_parts()
    refused("time", "leave each part of the surface more", smooth, mesh, time=1e30)
    refused("time", "be positive", smooth, mesh, time=0.0)
    refused("steps", "be at least 1", smooth, mesh, steps=0)
    refused("fixed", "be in [0, ", smooth, mesh, fixed=[mesh.n])
    loose = TriangleMesh(np.vstack([mesh.points, [9, 9, 9]]), mesh.faces)
    refused("mesh", "have a face at every vertex", smooth, loose)
