"""How far smoothed modes are still off: against exact spectra, and what does not matter."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import creature

import spectra_kit as sk
from spectra_kit.eigen.multigrid import coarsest_eigenpairs
from spectra_kit.eigen.multigrid.cascade import nested, prolonged
from spectra_kit.eigen.multigrid.estimates import excess, in_order
from spectra_kit.eigen.multigrid.smoothing import Smoothing, on_device
from spectra_kit.geometry import sphere, torus

K = 49  # on a sphere, all copies of each eigenvalue


def cloud() -> sk.PointCloud:
    """Points in random order, a third of them on a tenth of the area."""
    ball = sphere(subdivisions=5).geometry.points
    x, _, z = ball.T
    body = ball * (1 + 0.2 * np.sin(2 * x + 1) + 0.1 * z**3)[:, None] * [1.0, 1.3, 1.7]
    rng = np.random.default_rng(0)
    kept = body[(z > 0.8) | (rng.random(len(ball)) < 0.2)]
    return sk.PointCloud(kept[rng.permutation(len(kept))])


def noisy() -> sk.TriangleMesh:
    mesh = creature(4000, seed=1)
    edges = np.diff(mesh.points[mesh.unique_edges[0]], axis=1)
    spacing = np.linalg.norm(edges, axis=-1).mean()
    rng = np.random.default_rng(2)
    return mesh.with_points(mesh.points + 0.2 * spacing * rng.standard_normal(mesh.points.shape))


SHAPES = {
    "sphere": lambda: sphere(subdivisions=4).geometry,
    "torus": lambda: torus(n=3600).geometry,
    "animal": lambda: creature(4000, seed=0),
    "noisy": noisy,
    "cloud": cloud,
}


def start(laplacian, k=K):
    """Levels, and Ritz pairs of the coarsest."""
    levels = nested(laplacian, 700)
    return levels, coarsest_eigenpairs(levels[-1], 80, k)


@pytest.mark.parametrize("shape", SHAPES)
def test_within_three_of_the_true_error(shape):
    """After any number of steps, and hardly ever too low by more."""
    laplacian = sk.robust_laplacian(SHAPES[shape]())
    exact = sk.eigensolve(laplacian, K).eigenvalues
    levels, pairs = start(laplacian)
    ratios = []
    for steps in (1, 2, 4):
        found = prolonged(laplacian, levels, *pairs, K, keep=80, target=1e-300, max_steps=steps)
        true = found.eigenvalues[1:K] / exact[1:] - 1
        ratios.append(np.maximum(found.errors[1:], 1e-11) / np.maximum(true, 1e-11))
    ratio = np.array(ratios)
    assert np.mean((ratio > 1 / 3) & (ratio < 3), axis=1).min() >= 0.85
    assert np.mean((ratio > 1 / 3) & (ratio < 3)) >= 0.9
    assert np.mean(ratio < 1 / 3) <= 0.02


@pytest.mark.parametrize("shape", SHAPES)
def test_no_estimate_is_below_rounding(shape):
    """Squares of residuals say 1e-40 of modes that are as near as rounding lets them."""
    laplacian = sk.robust_laplacian(SHAPES[shape]())
    exact, loose = (sk.eigensolve(laplacian, K, sk.Lanczos(tol=tol)) for tol in (0.0, 1e-2))
    off = np.abs(loose.eigenvalues - exact.eigenvalues)[1:] / exact.eigenvalues[1:]
    assert (off <= 10 * loose.certificate.errors[1:]).all()


def test_few_modes_are_told_one_by_one(animal, animal_spectrum):
    """Without a fit to those between."""
    for k in (2, 8, 9, 10):
        levels, pairs = start(animal, k)
        found = prolonged(animal, levels, *pairs, k, keep=30, target=1e-300, max_steps=1)
        true = found.eigenvalues[1:k] / animal_spectrum.eigenvalues[1:k] - 1
        assert (np.abs(np.log(found.errors[1:] / true)) < np.log(3)).all()
        assert 0 <= found.errors[0] < 1e-9


def test_neither_unit_nor_order_nor_place_matters(animal):
    levels, pairs = start(animal)
    found = prolonged(animal, levels, *pairs, K, keep=80, target=1e-300, max_steps=1)
    values, X, falls = found.eigenvalues, found.eigenvectors, np.linspace(0, 1e-3, K)

    def told(laplacian, values, X, falls, place="cpu"):
        smoothing, columns = Smoothing.of(laplacian, place), on_device(X, place)
        return excess(smoothing, values, columns, smoothing.residual(values, columns), falls)

    first = told(animal, values, X, falls)
    order = np.random.default_rng(0).permutation(animal.n)
    L = animal.stiffness[order][:, order]
    shuffled = sk.Laplacian(L, animal.mass[order], animal.points[order])
    larger = sk.Laplacian(animal.stiffness, 49 * animal.mass, 7 * animal.points)
    for same in (
        told(shuffled, values, X[order], falls),
        49 * told(larger, values / 49, X / 7, falls / 49),
        told(animal, values, X, falls, "cpu:0"),
    ):
        np.testing.assert_allclose(same, first, rtol=1e-2, atol=1e-12)


def test_a_true_mode_is_not_off(animal, animal_spectrum):
    """Nor where the columns fill the space of the points."""
    for k in (1, K):
        values, X = animal_spectrum.eigenvalues[:k], animal_spectrum.eigenvectors[:, :k]
        smoothing = Smoothing.of(animal)
        residual = smoothing.residual(values, X)
        high = excess(smoothing, values, X, residual, np.zeros(k))
        assert (high <= 1e-10 * max(values[-1], animal.eigenvalue_spacing)).all()
    few = sk.robust_laplacian(sphere(subdivisions=1).geometry)
    exact = sk.eigensolve(few, few.n)
    smoothing = Smoothing.of(few)
    residual = smoothing.residual(exact.eigenvalues, exact.eigenvectors)
    high = excess(smoothing, exact.eigenvalues, exact.eigenvectors, residual, np.zeros(few.n))
    assert (high <= 1e-10 * exact.eigenvalues[-1]).all()


def test_modes_that_change_places_are_told_in_the_order_of_their_eigenvalues():
    """Of orthogonal parts, each with one error: the eigenvalues, ascending."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        exact, off = np.sort(rng.random(12)), 10 ** rng.uniform(-9, 0, 12)
        order = np.argsort(exact + off)
        values = (exact + off)[order]
        np.testing.assert_allclose(values - in_order(values, off[order]), exact, atol=1e-14)
    np.testing.assert_array_equal(in_order(exact, exact * 1e-20), exact * 1e-20)
