"""Shape differences: of isometries, scalings, and a stretched sheet, on which they are known."""

import numpy as np
import pytest
from conftest import bumpy, creature, refused

from spectra_kit import eigensolve, robust_laplacian, spectrum
from spectra_kit.geometry import permuted, rectangle
from spectra_kit.maps import functional_map_from_point_map, shape_difference


def test_of_an_isometry_it_is_the_identity_and_of_a_scaling_its_square() -> None:
    mesh = creature(900)
    copy, truth = permuted(mesh)
    for scale in (1.0, 5.0, 1e-60):
        scaled = copy.with_points(scale * copy.points)
        source, target = spectrum(mesh, 20), spectrum(scaled, 20)
        C = functional_map_from_point_map(source, target, truth)
        V, R = shape_difference(source, target, C)
        np.testing.assert_allclose(V / scale**2, np.eye(20), atol=1e-6)
        np.testing.assert_allclose(R, np.eye(19), atol=1e-5)


def test_a_sheet_stretched_along_one_side() -> None:
    stretch = 1.7
    exact = rectangle(n=2500, height=1.3)
    sheet = exact.geometry
    wide = sheet.with_points(sheet.points * [stretch, 1, 1])
    source = eigensolve(robust_laplacian(sheet), 8)
    target = eigensolve(robust_laplacian(wide), 60)
    C = functional_map_from_point_map(source, target, np.arange(sheet.n), k=(8, 60))
    V, R = shape_difference(source, target, C)
    np.testing.assert_allclose(V, stretch * np.eye(8), atol=2e-3)
    # A mode of eigenvalue a + b, for its waves along the sides, has a / stretch**2 + b on the copy.
    waves = [(np.pi * a) ** 2 for a in range(4)], [(np.pi * b / 1.3) ** 2 for b in range(4)]
    pairs = sorted((a + b, a, b) for a in waves[0] for b in waves[1])[1:8]
    expected = [stretch * (a / stretch**2 + b) / (a + b) for _, a, b in pairs]
    np.testing.assert_allclose(np.diag(R), expected, rtol=1e-2)
    assert np.abs(R - np.diag(np.diag(R))).max() < 1e-2
    # The largest factor is that of what varies along the other side alone.
    assert np.linalg.eigvals(R).real.max() == pytest.approx(stretch, rel=1e-2)
    assert np.linalg.eigvals(R).real.min() == pytest.approx(1 / stretch, rel=1e-2)


def test_it_does_not_depend_on_signs_of_modes_of_the_target_and_is_self_adjoint() -> None:
    mesh = bumpy()
    other = mesh.with_points(mesh.points * [1, 1.4, 0.8])
    source, target = spectrum(mesh, 12), spectrum(other, 50)
    C = functional_map_from_point_map(source, target, np.arange(mesh.n))
    V, R = shape_difference(source, target, C)
    np.testing.assert_allclose(V, V.T, atol=1e-12)
    energies = source.eigenvalues[1:, None] * R
    np.testing.assert_allclose(energies, energies.T, atol=1e-9 * energies.max())
    # Inner products of the functions themselves, as they are carried to the other surface.
    f, g = source.eigenvectors[:, 3], source.eigenvectors[:, 4]
    carried = target.project(np.stack([f, g], axis=1))
    assert V[3, 4] == pytest.approx(carried[:, 0] @ carried[:, 1], abs=1e-9)
    turned = target.eigenvalues @ (carried[:, 0] * carried[:, 1])
    assert energies[2, 3] == pytest.approx(turned, rel=1e-6, abs=1e-9)


def test_a_map_of_constants_alone_is_refused() -> None:
    s = spectrum(bumpy(162), 5)
    refused("functional_map", "carry modes outside", shape_difference, s, s, np.ones((5, 1)))
    refused("functional_map", "have shape (k2, k1)", shape_difference, s, s, np.ones(5))
