"""A shape by its lowest modes: a projection, and what has no constants."""

import numpy as np
import pytest
from conftest import bumpy, refused, two_parts

from spectra_kit import Dense, eigensolve, robust_laplacian
from spectra_kit.eigen import low_pass
from spectra_kit.geometry import rectangle


@pytest.mark.parametrize("cloud", [False, True], ids=["mesh", "cloud"])
def test_modes_below_are_kept_and_those_above_are_gone(cloud):
    mesh = bumpy()
    shape = mesh.as_cloud() if cloud else mesh
    whole = eigensolve(robust_laplacian(shape), 80, Dense())
    found = low_pass(shape, whole.truncate(30))
    assert type(found) is type(shape)
    c = whole.project(found.points)
    np.testing.assert_allclose(c[:30], whole.project(shape.points)[:30], atol=1e-10)
    np.testing.assert_allclose(c[30:], 0, atol=1e-10)
    np.testing.assert_allclose(low_pass(found, whole.truncate(30)).points, found.points, atol=1e-10)
    np.testing.assert_allclose(whole.mass @ found.points, whole.mass @ shape.points, atol=1e-10)


def test_far_from_the_origin_and_in_any_unit():
    mesh = bumpy()
    spectrum = eigensolve(robust_laplacian(mesh), 20)
    found = low_pass(mesh, spectrum).points
    away = low_pass(mesh.with_points(mesh.points + 1e6), spectrum).points
    np.testing.assert_allclose(away - 1e6, found, atol=1e-8)
    large = low_pass(mesh.with_points(1e8 * mesh.points), spectrum.rescale(1e8)).points
    np.testing.assert_allclose(large / 1e8, found, atol=1e-10)


def test_all_modes_change_nothing():
    sheet = rectangle(n=100).geometry
    whole = eigensolve(robust_laplacian(sheet), sheet.n, Dense())
    np.testing.assert_allclose(low_pass(sheet, whole).points, sheet.points, atol=1e-10)


def test_what_is_refused():
    mesh, sheet = two_parts(), rectangle(n=300).geometry
    spectrum = eigensolve(robust_laplacian(mesh), 12)
    refused("spectrum", f"be of these {sheet.n} points", low_pass, sheet, spectrum)
    refused("spectrum", "have constants among its modes", low_pass, mesh, spectrum.nonzero())
    refused("spectrum", "have constants among its modes", low_pass, mesh, spectrum.truncate(1))
    held = robust_laplacian(sheet).dirichlet(sheet.boundary_vertices)
    refused("spectrum", "have constants", low_pass, sheet, eigensolve(held, 12))
