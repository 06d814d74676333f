"""Subsets, prolongation and Galerkin operators of coarse levels."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import bumpy, creature, joined, moved, refused
from scipy import sparse
from scipy.linalg import eigh
from scipy.spatial import cKDTree

from spectra_kit import Laplacian, TriangleMesh, cotan_laplacian, eigensolve, robust_laplacian
from spectra_kit.eigen.multigrid import (
    Subset,
    cascade,
    coarsen,
    coarsest_eigenpairs,
    prolongation,
    well_spread,
)
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import sphere


@pytest.fixture(scope="module")
def ball() -> Laplacian:
    return robust_laplacian(sphere(subdivisions=5).geometry)


def sheet(n: int, warp: float = 1.0) -> TriangleMesh:
    """The unit square on a grid; `warp` above 1 crowds its points towards x = 0."""
    x, y = np.meshgrid(np.linspace(0, 1, n) ** warp, np.linspace(0, 1, n), indexing="ij")
    i = np.arange(n * n).reshape(n, n)
    a, b, c, d = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
    faces = np.vstack([np.c_[a, b, c], np.c_[a, c, d]])
    return TriangleMesh(np.c_[x.ravel(), y.ravel(), np.zeros(n * n)], faces)


@pytest.mark.parametrize("n_points", [1, 10, 300, 2000, 10242])
def test_a_subset_has_about_the_points_asked_for(ball, n_points):
    subset = well_spread(ball, n_points)
    assert len(subset.indices) <= n_points
    # Near the sampling distance the balls hold one point or seven, and nothing between.
    assert len(subset.indices) >= (0.9 if 10 < n_points <= 300 else 0.3) * n_points
    assert (np.diff(subset.indices) > 0).all()


def test_a_subset_is_spread_by_area_not_by_points_in_any_unit():
    laplacian = cotan_laplacian(sheet(120, warp=3.0))  # 8 of 10 points lie in x < 0.5
    subset = well_spread(laplacian, 400)
    chosen = laplacian.points[subset.indices]
    assert (chosen[:, 0] < 0.5).mean() == pytest.approx(0.5, abs=0.08)
    tree = cKDTree(chosen)
    assert tree.query(laplacian.points)[0].max() < subset.radius
    assert tree.query(chosen, k=2)[0][:, 1].min() >= subset.radius
    small = Laplacian(laplacian.stiffness, laplacian.mass * 1e-12, laplacian.points * 1e-6)
    other = well_spread(small, 400)
    np.testing.assert_array_equal(subset.indices, other.indices)
    assert other.radius == pytest.approx(1e-6 * subset.radius)


def test_every_part_of_a_thin_shape_is_covered():
    n = 3000  # a path: its length, not its area, decides how many points a radius needs
    edges = sparse.diags_array([np.full(n - 1, -1.0)] * 2, offsets=[-1, 1])
    path = sparse.csr_array(edges + sparse.diags_array(-edges.sum(axis=0)))
    points = np.zeros((n, 3))
    points[:, 0] = np.linspace(0, 100, n)
    laplacian = Laplacian(path, np.full(n, 1e-6), points)
    subset = well_spread(laplacian, 50)
    assert 30 <= len(subset.indices) <= 50
    assert np.diff(subset.indices).max() * 100 / n < 2 * subset.radius
    carried = prolongation(laplacian, subset) @ points[subset.indices]
    np.testing.assert_allclose(carried, points, atol=1e-10)


def test_functions_linear_along_a_plane_are_reproduced():
    rotation = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    flat = sheet(60)
    laplacian = cotan_laplacian(TriangleMesh(flat.points @ rotation + 5, flat.faces))
    subset = well_spread(laplacian, 300)
    lift = prolongation(laplacian, subset)
    np.testing.assert_allclose(lift.sum(axis=1), 1, atol=1e-13)
    carried = lift @ laplacian.points[subset.indices]
    np.testing.assert_allclose(carried, laplacian.points, atol=1e-11)


def test_smooth_functions_converge_with_the_square_of_the_radius(ball, monkeypatch):
    radii, errors = [], []
    x, y, z = ball.points.T
    f = x * y + z**3
    for n_points in (200, 600, 1800):
        subset = well_spread(ball, n_points)
        lift = prolongation(ball, subset)
        error = lift @ f[subset.indices] - f
        radii.append(subset.radius)
        errors.append(np.sqrt(ball.mass @ error**2))
    assert np.polyfit(np.log(radii), np.log(errors), 1)[0] == pytest.approx(2, abs=0.3)
    monkeypatch.setenv("NUMBA_NUM_THREADS", "3")  # the same on any number
    assert (lift != prolongation(ball, subset)).nnz == 0


def test_two_sheets_that_nearly_touch_do_not_mix():
    """A sheet folded over itself, with a gap a tenth of the radius of the subset."""
    flat = sheet(90)
    s = flat.points[:, 0] * 4  # unrolled length
    gap = 0.02
    bend = np.clip((s - 2) / (np.pi * gap / 2), 0, 1) * np.pi
    over = np.maximum(s - 2 - np.pi * gap / 2, 0)
    x = np.minimum(s, 2) + gap / 2 * np.sin(bend) - over
    z = gap / 2 * (1 - np.cos(bend))
    laplacian = cotan_laplacian(flat.with_points(np.c_[x, 2 * flat.points[:, 1], z]))
    subset = well_spread(laplacian, 300)
    assert subset.radius > 5 * gap
    side = np.where(s < 2, -1.0, 1.0)
    carried = prolongation(laplacian, subset) @ side[subset.indices]
    # A ball that reaches round the fold, 2.5 radii away, comes back as far on the other side.
    far = np.abs(s - 2) > 5.5 * subset.radius
    assert far.mean() > 0.5
    np.testing.assert_allclose(carried[far], side[far], atol=1e-12)
    # The lower sheet has its own half of the subset.
    assert (side[subset.indices] < 0).mean() == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize("cloud", [False, True])
def test_galerkin_eigenvalues_bound_the_true_ones_closely(cloud):
    mesh = creature(4000, seed=0)
    laplacian = robust_laplacian(mesh.as_cloud() if cloud else mesh)
    exact = eigensolve(laplacian, 30).eigenvalues
    level = coarsen(laplacian, 1500)
    assert (level.lumped > 0).all()
    assert level.lumped.sum() == pytest.approx(laplacian.area)
    values, vectors = eigh(level.stiffness.toarray(), level.mass.toarray(), subset_by_index=[0, 29])
    assert abs(values[0]) < 1e-8
    assert (values[1:] >= exact[1:] * (1 - 1e-9)).all()
    assert (values[1:] / exact[1:] - 1).max() < 4e-3
    U = level.prolongation @ vectors  # and it is the Ritz value of the functions on all points
    np.testing.assert_allclose(U.T @ (laplacian.mass[:, None] * U), np.eye(30), atol=1e-10)
    np.testing.assert_allclose(np.einsum("ij,ij->j", U, laplacian.stiffness @ U), values, atol=1e-9)


def test_what_is_refused(ball):
    with pytest.raises(InvalidInputError, match="points out of reach"):
        prolongation(ball, Subset(np.array([0, 1]), 0.05))
    for n_points in (0, 10243, 2.5):
        refused("n_points", "be ", coarsen, ball, n_points)
    small = sphere(subdivisions=2).geometry
    two = robust_laplacian(joined(small, moved(small, 5, 5, 5)))
    refused("n_points", "be at least", well_spread, two, 1)
    assert (well_spread(two, 2).indices // small.n).tolist() == [0, 1]


def test_nested_levels_compose(animal, animal_spectrum):
    fine = coarsen(animal, 2000)
    bottom = coarsen(fine, 500)
    assert bottom.mass.sum() == pytest.approx(animal.area)
    assert (bottom.lumped > 0).all()
    values, vectors = eigh(
        bottom.stiffness.toarray(), bottom.mass.toarray(), subset_by_index=[0, 9]
    )
    U = fine.prolongation @ (bottom.prolongation @ vectors)
    np.testing.assert_allclose(U.T @ (animal.mass[:, None] * U), np.eye(10), atol=1e-9)
    assert values[1:] == pytest.approx(animal_spectrum.eigenvalues[1:10], rel=0.01)


def test_sweeps_find_the_lowest_pairs_of_the_level(monkeypatch):
    monkeypatch.setattr(cascade, "_DENSE", 0)
    level = coarsen(robust_laplacian(bumpy(2562)), 600)
    truth = eigh(level.stiffness.toarray(), level.mass.toarray(), eigvals_only=True)[:30]
    values, _ = coarsest_eigenpairs(level, 45, 30, rtol=1e-12)
    np.testing.assert_allclose(values[:30], truth, rtol=1e-9, atol=1e-9)
