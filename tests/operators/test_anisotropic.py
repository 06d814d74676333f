"""Anisotropic operators: stretched sheets, the cotangents, LaPy's, and what is refused."""

import numpy as np
import pytest
from conftest import bumpy, refused
from scipy.spatial.transform import Rotation

from spectra_kit import TriangleMesh, cotan_laplacian, eigensolve
from spectra_kit.errors import DoubtfulCurvatureWarning
from spectra_kit.geometry import permuted, rectangle, sphere, torus
from spectra_kit.operators import anisotropic_laplacian, curvature, tensor_laplacian


def tilted(n):
    """A sheet that lies askew in space, and what turns it there."""
    turn = Rotation.from_euler("xyz", [0.4, -0.7, 1.1]).as_matrix()
    sheet = rectangle(n=n, width=1.5, height=1.0).geometry
    return sheet.with_points(sheet.points @ turn.T + [1, 2, 3]), turn


def test_a_sheet_with_a_constant_tensor_is_a_stretched_sheet():
    """``D = diag(a, b)``: the eigenvalues of a sheet whose sides are divided by the roots."""
    errors = []
    sizes = (400, 1600, 6400)
    true = rectangle(width=1.5 / 2, height=1.0 / 0.5**0.5, k=12).eigenvalues[1:]
    for n in sizes:
        sheet, turn = tilted(n)
        D = np.tile(turn @ np.diag([4.0, 0.5, 7.0]) @ turn.T, (len(sheet.faces), 1, 1))
        found = eigensolve(tensor_laplacian(sheet, D), 12).eigenvalues[1:]
        errors.append(np.abs(found / true - 1).max())
    assert -2 * np.polyfit(np.log(sizes), np.log(errors), 1)[0] == pytest.approx(2, abs=0.2), errors


def test_a_tensor_that_is_not_along_the_sides():
    """It is the operator of the affinely stretched points: ``D = A A^T``, x' = A^-1 x."""
    sheet = rectangle(n=900).geometry
    A = np.array([[1.4, 0.5], [-0.2, 0.8]])
    D = np.zeros((len(sheet.faces), 3, 3))
    D[:, :2, :2] = A @ A.T
    points = sheet.points.copy()
    points[:, :2] = points[:, :2] @ np.linalg.inv(A).T
    stretched = tensor_laplacian(
        TriangleMesh(points, sheet.faces), np.tile(np.eye(3), (len(sheet.faces), 1, 1))
    )
    found = tensor_laplacian(sheet, D)
    scale = np.linalg.det(A)
    np.testing.assert_allclose(
        found.stiffness.toarray(), scale * stretched.stiffness.toarray(), atol=1e-12
    )
    np.testing.assert_allclose(found.mass, scale * stretched.mass)


def test_without_anisotropy_it_is_the_cotangents():
    mesh = bumpy()
    D = np.tile(np.eye(3), (len(mesh.faces), 1, 1))
    expected = cotan_laplacian(mesh).stiffness
    found = tensor_laplacian(mesh, D)
    assert abs(found.stiffness - expected).max() < 1e-12
    assert found.area == pytest.approx(mesh.area, rel=1e-12)
    assert abs(anisotropic_laplacian(mesh, 1e-14).stiffness - expected).max() < 1e-10
    ball = sphere(subdivisions=3).geometry  # bends alike in all directions: by exp(-strength)
    slowed = anisotropic_laplacian(ball, 2.0).stiffness
    whole = cotan_laplacian(ball).stiffness
    assert abs(slowed - np.exp(-2.0) * whole).max() < 0.02 * abs(whole).max()


def test_heat_on_a_cylinder_flows_along_it():
    """Around it flows ``exp(-strength / radius)``; along it, all."""
    rows, columns = 41, 80
    u, z = np.meshgrid(2 * np.pi * np.arange(columns) / columns, np.linspace(0, 2 * np.pi, rows))
    points = np.stack([np.cos(u), np.sin(u), z], axis=-1).reshape(-1, 3)
    a = np.arange(rows * columns).reshape(rows, columns)[:-1]
    b, c, d = np.roll(a, -1, 1), np.roll(a, -1, 1) + columns, a + columns
    mesh = TriangleMesh(points, np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3))
    slow = np.exp(-0.7)
    i, j = np.meshgrid(np.arange(-9, 10), np.arange(9))
    true = np.sort((slow * i**2 + j**2 / 4).ravel())[:14]  # period 2 pi around, free ends
    found = eigensolve(anisotropic_laplacian(mesh, 0.7), 14).eigenvalues
    np.testing.assert_allclose(found[1:], true[1:], rtol=0.03)


def test_lapys_stiffness_with_the_same_directions():
    lapy = pytest.importorskip("lapy")
    mesh = torus(n=800).geometry
    theirs = lapy.TriaMesh(np.array(mesh.points), np.array(mesh.faces))
    u1, u2, c1, c2 = theirs.curvature_tria(smoothit=3)
    # Theirs are for sides, which are gradients turned: what slows u1 stands at u2.
    slowed = np.exp(-0.8 * np.abs(np.column_stack([c2, c1])))
    stiffness, _ = lapy.Solver._fem_tria_aniso(theirs, u1, u2, slowed, lump=True)
    D = sum(
        slowed[:, 1 - i, None, None] * u[:, :, None] * u[:, None] for i, u in enumerate((u1, u2))
    )
    ours = tensor_laplacian(mesh, D).stiffness
    assert abs(ours - stiffness).max() < 1e-9 * abs(ours).max()


def test_laws():
    mesh = bumpy()
    found = anisotropic_laplacian(mesh, 0.5)
    turn = Rotation.from_euler("xyz", [0.4, -0.7, 1.1]).as_matrix()
    rigid = anisotropic_laplacian(mesh.with_points(mesh.points @ turn.T + [5, 6, 7]), 0.5)
    size = abs(found.stiffness).max()
    assert abs(rigid.stiffness - found.stiffness).max() < 1e-7 * size
    for unit in (1e-8, 1e8, 1e100):
        scaled = anisotropic_laplacian(mesh.with_points(unit * mesh.points), 0.5 * unit)
        assert abs(scaled.stiffness - found.stiffness).max() < 1e-7 * size
        np.testing.assert_allclose(scaled.mass / unit**2, found.mass, rtol=1e-9)
    inside_out = TriangleMesh(mesh.points, mesh.faces[:, ::-1])
    assert abs(anisotropic_laplacian(inside_out, 0.5).stiffness - found.stiffness).max() < 1e-9
    other, index = permuted(mesh, seed=1)
    shuffled = anisotropic_laplacian(other, 0.5).stiffness
    assert abs(shuffled - found.stiffness[index][:, index]).max() < 1e-7 * size
    assert found.kernel_dimension == 1
    assert np.linalg.eigvalsh(found.stiffness.toarray())[0] > -1e-10 * size


def test_where_nothing_is_known_of_curvature_faces_are_isotropic():
    page = np.array([[0, 0], [1, 0], [0, 1], [1, 1], [2, 0], [2, 1], [3, 0], [3, 1.0]])
    sheet = rectangle(n=300).geometry
    points = np.vstack([sheet.points, np.c_[page, 0 * page[:, 0]] + [9, 9, 9]])
    ribbon = np.array([[0, 1, 2], [1, 3, 2], [1, 4, 3], [4, 5, 3], [4, 6, 5], [6, 7, 5]])
    mesh = TriangleMesh(points, np.vstack([sheet.faces, ribbon + sheet.n]))
    with pytest.warns(DoubtfulCurvatureWarning, match="all on a curve"):
        assert np.isnan(curvature(mesh).mean[sheet.n :]).all()
    with pytest.warns(DoubtfulCurvatureWarning):
        found = anisotropic_laplacian(mesh, 2.0)
    assert abs(found.stiffness - cotan_laplacian(mesh).stiffness).max() < 1e-9


def test_what_is_refused():
    mesh = bumpy()
    D = np.tile(np.eye(3), (len(mesh.faces), 1, 1))
    skewed, negative = D.copy(), D.copy()
    skewed[3, 0, 1] = 0.5
    negative[3] *= -1
    refused("tensors", f"have shape ({len(mesh.faces)}, 3, 3)", tensor_laplacian, mesh, D[:-1])
    refused("tensors", "be symmetric, got 1 tensor that", tensor_laplacian, mesh, skewed)
    refused("tensors", "be positive definite in the planes", tensor_laplacian, mesh, negative)
    refused("strength", "be positive", anisotropic_laplacian, mesh, -1.0)
    refused("strength", "leave some heat to flow", anisotropic_laplacian, mesh, 1e6)
    points = mesh.points.copy()
    points[mesh.faces[0, 0]] = points[mesh.faces[0, 1]]
    refused("mesh", "have faces with a plane", tensor_laplacian, mesh.with_points(points), D)
