"""The Laplacian of tangent vector fields: spectra of spheres, planes and bands, on any surface."""

import numpy as np
import pytest
from conftest import creature
from scipy.spatial.transform import Rotation

from spectra_kit import Dense, Lanczos, Refined, eigensolve, verify
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import PointCloud, TriangleMesh, rectangle, sphere, torus
from spectra_kit.operators import (
    connection_laplacian,
    delaunay_laplacian,
    tangent_frames,
)


def strip(n, twisted, width=0.4):
    """A band of n quads around a circle, with or without half a twist."""
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    half = angle / 2 if twisted else np.zeros(n)
    across = np.stack([np.cos(half) * np.cos(angle), np.cos(half) * np.sin(angle), np.sin(half)])
    middle = np.stack([np.cos(angle), np.sin(angle), np.zeros(n)])
    rows = [middle + s * width * across for s in (-1, -0.5, 0, 0.5, 1)]
    points = np.stack(rows, axis=2).transpose(1, 2, 0).reshape(-1, 3)
    m, faces = len(rows), []
    for i in range(n):
        for k in range(m - 1):
            a, b = m * i + k, m * i + k + 1
            end = i == n - 1
            c, d = ((m - 1 - k, m - 2 - k) if twisted else (k, k + 1)) if end else (a + m, b + m)
            faces += [[a, c, b], [b, c, d]]
    return TriangleMesh(points, faces)


def lowest(geometry, k, **options):
    return eigensolve(connection_laplacian(geometry, **options), k).eigenvalues


@pytest.mark.parametrize("cloud", [False, True])
def test_the_sphere_has_the_eigenvalues_of_the_rough_laplacian(cloud):
    """``l (l + 1) - 1`` over the square of the radius, ``4 l + 2`` times: gradients and curls."""
    true, errors = np.repeat([1.0, 5.0, 11.0], [6, 10, 14]) / 4, []
    for level in (2, 3, 4):
        ball = sphere(subdivisions=level, radius=2).geometry
        found = lowest(ball.as_cloud() if cloud else ball, 31)
        errors.append(np.abs(found[:30] / true - 1).max())
        assert found[30] > 1.5 * true[-1]
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (rates > 1.8).all(), (errors, rates)


def test_the_lowest_field_of_the_sphere_is_that_of_a_gradient_or_a_curl():
    ball = sphere(subdivisions=4).geometry
    frames, x = tangent_frames(ball), ball.points
    modes = eigensolve(connection_laplacian(ball), 6)
    fields = [np.eye(3)[a] - x[:, [a]] * x for a in range(3)]  # gradients of the coordinates
    fields += [np.cross(x, field) for field in fields]
    given = np.column_stack([frames.coordinates(field) for field in fields])
    norms = np.sqrt((modes.mass[:, None] * given**2).sum(axis=0))
    cosines = np.linalg.svd(modes.project(given / norms), compute_uv=False)
    assert cosines.min() > 0.9999


@pytest.mark.parametrize("cloud", [False, True])
def test_a_plane_and_a_flat_torus_have_two_parallel_fields(cloud):
    turn = Rotation.from_euler("xyz", [0.4, -0.7, 1.1]).as_matrix()
    sheet = rectangle(n=300).geometry
    sheet = sheet.with_points(1e-6 * sheet.points @ turn.T + [5, 6, 7])
    sheet = sheet.as_cloud() if cloud else sheet
    laplacian, frames = connection_laplacian(sheet), tangent_frames(sheet)
    for field in turn.T[:2]:
        constant = frames.coordinates(np.broadcast_to(field, (sheet.n, 3)))
        energy = constant @ laplacian.stiffness @ constant
        assert energy < 1e-9 * laplacian.stiffness.diagonal().sum()
    plain, found = eigensolve(delaunay_laplacian(sheet), 6), eigensolve(laplacian, 12)
    scale = plain.eigenvalues[-1]
    np.testing.assert_allclose(
        found.eigenvalues / scale, np.repeat(plain.eigenvalues, 2) / scale, atol=1e-8
    )


def test_a_cylinder_is_flat_and_a_mobius_band_has_no_parallel_field_across():
    """Around the band a vector across comes back turned round; one along comes back as it was."""
    around = lowest(strip(120, twisted=False), 3)
    twisted = lowest(strip(120, twisted=True), 3)
    assert around[1] < 1e-3 * around[2]
    assert twisted[0] < 0.1 * twisted[1]
    # Antiperiodic fields on a circle of length 2 pi: 1/4, each twice.
    np.testing.assert_allclose(twisted[1:], 0.25, rtol=0.2)


@pytest.mark.parametrize("solver", [Dense(), Lanczos(), Refined()], ids=repr)
def test_all_exact_solvers_agree_and_are_verified(solver):
    laplacian = connection_laplacian(creature(520))
    reference = eigensolve(laplacian, 12)
    found = verify(eigensolve(laplacian, 12, solver), laplacian)
    np.testing.assert_allclose(found.eigenvalues, reference.eigenvalues, rtol=1e-8)
    assert found.certificate.n_verified == 12
    # Turned by a right angle, a field is as smooth.
    np.testing.assert_allclose(found.eigenvalues[::2], found.eigenvalues[1::2], rtol=1e-8)
    assert found.n_zero_modes == 0


def test_neither_motion_nor_unit_nor_numbering_nor_winding_matters():
    mesh = creature(520)
    found = lowest(mesh, 8)
    turn = Rotation.from_euler("xyz", [1.0, 0.2, -0.5]).as_matrix()
    order = np.random.default_rng(0).permutation(mesh.n)
    faces = np.argsort(order)[mesh.faces]
    faces[::3] = faces[::3, [0, 2, 1]]
    moved = TriangleMesh((mesh.points @ turn.T + [1, 2, 3])[order], faces)
    np.testing.assert_allclose(lowest(moved, 8), found, rtol=1e-8)
    for unit in (1e100, 1e-100):
        tiny = mesh.with_points(unit * mesh.points)
        np.testing.assert_allclose(lowest(tiny, 8) * unit**2, found, rtol=1e-8)


def test_energies_are_not_negative_on_any_surface():
    rng = np.random.default_rng(0)
    fan = TriangleMesh(rng.normal(size=(5, 3)), [[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    ball = sphere(subdivisions=1).geometry
    pair = np.concatenate([ball.points, ball.points + 5]), np.vstack([ball.faces, ball.faces + 42])
    torn = TriangleMesh(pair[0], pair[1][:-20])
    lone = TriangleMesh(rng.normal(size=(3, 3)), [[0, 1, 2]])
    book = TriangleMesh([[0, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0.0]], [[0, 1, 2], [1, 0, 3]])
    for mesh in (fan, torn.without_unreferenced(), lone, book, strip(30, twisted=True)):
        laplacian = connection_laplacian(mesh)
        dense = laplacian.stiffness.toarray()
        assert np.linalg.eigvalsh(dense).min() > -1e-12 * dense.max()
        np.testing.assert_array_equal(dense, dense.T)


def test_folds_turn_vectors_however_sharp():
    """Across the edge of a thin plate, what points at the edge points away from it behind."""
    flat = rectangle(n=400, width=1.0, height=1.0).geometry
    for opening in (0.05, np.pi / 2, np.pi):  # of a book that is bent along its middle
        x, y, _ = flat.points.T
        side = np.abs(x - 0.5)
        leaf = np.where(x < 0.5, -1.0, 1.0) * opening / 2
        bent = np.column_stack([side * np.cos(leaf), y, side * np.sin(leaf)])
        # An unfolded book is isometric to the sheet, which has two parallel fields.
        assert lowest(flat.with_points(bent), 3)[1] < 1e-2


def test_coordinates_and_vectors_are_each_others_inverse():
    mesh = creature(520)
    frames = tangent_frames(mesh)
    axes = frames.axes
    unit = np.broadcast_to(np.eye(3), axes.shape)
    np.testing.assert_allclose(axes @ axes.transpose(0, 2, 1), unit, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(axes), 1)
    given = np.random.default_rng(0).normal(size=2 * mesh.n)
    vectors = frames.vectors(given)
    np.testing.assert_allclose(frames.coordinates(vectors), given)
    np.testing.assert_allclose(frames.vectors(given.reshape(-1, 2)), vectors)


def test_what_has_no_plane_is_refused():
    line = TriangleMesh(
        [[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0], [0, 2, 0]], [[0, 1, 2], [3, 4, 5]]
    )
    with pytest.raises(InvalidInputError, match="some area at every point"):
        connection_laplacian(line)
    with pytest.raises(InvalidInputError, match="4 points"):
        connection_laplacian(PointCloud([[0, 0, 0], [1, 0, 0], [0, 1, 0]]))
    with pytest.raises(InvalidInputError, match="shape"):
        tangent_frames(torus(n=200).geometry).vectors(np.ones(3))


def test_sharp_edges_turn_vectors_and_reflect_none():
    """A rod of three sides with a sharp edge has two sides of its surface all over."""
    section = np.array([[0, 0], [0.3, 1.0], [-0.3, 1.0]])
    n = 20
    points = np.array([[x, y, z] for z in np.linspace(0, 6, n) for x, y in section])
    a = (3 * np.arange(n - 1)[:, None] + np.arange(3)).ravel()
    b = (3 * np.arange(n - 1)[:, None] + (np.arange(3) + 1) % 3).ravel()
    sides = np.vstack([np.column_stack([a, b + 3, b]), np.column_stack([a, a + 3, b + 3])])
    rod = TriangleMesh(points, np.vstack([sides, [[0, 1, 2], [3 * n - 1, 3 * n - 2, 3 * n - 3]]]))
    found = eigensolve(connection_laplacian(rod), 12).eigenvalues
    np.testing.assert_allclose(found[::2], found[1::2], rtol=1e-9)
