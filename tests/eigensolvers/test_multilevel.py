"""Coarse levels, and the backend that solves them one after the other: `Multilevel`."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import bumpy
from scipy.linalg import eigh

import spectra_kit as sk
from spectra_kit.eigensolvers.multilevel import level_sizes
from spectra_kit.levels import coarse_iteration, coarse_ritz, coarsen

K = 40


@pytest.mark.parametrize("rtol", [1e-3, 1e-10])
def test_multilevel_reaches_any_tolerance(animal, animal_spectrum, rtol):
    assert level_sizes(animal.n, K + 20, coarsest=300, ratio=3) == [900, 300]
    s = sk.eigensolve(animal, K, sk.Multilevel(rtol=rtol, coarsest=300, ratio=3))
    assert s.certificate.relative_residuals.max() <= rtol
    expected = animal_spectrum.eigenvalues[:K]
    assert s.eigenvalues == pytest.approx(expected, rel=max(10 * rtol**2, 1e-11))
    assert {"coarsen", "coarse"} <= set(s.provenance.seconds)
    assert s.provenance.iterations >= 1


def test_multilevel_starts_closer_than_noise(animal):
    levels = sk.eigensolve(animal, K, sk.Multilevel(degree=2))
    noise = sk.eigensolve(animal, K, sk.Refined(start=sk.RandomBasis(m=60), rtol=1e-6, degree=2))
    assert levels.provenance.iterations < noise.provenance.iterations


def test_levels_need_room():
    assert level_sizes(64_000, 144, coarsest=2048, ratio=12) == [2048]
    assert level_sizes(600_000, 144, coarsest=2048, ratio=12) == [24576, 2048]
    assert level_sizes(64_000, 1000, coarsest=2048, ratio=16) == [4000]
    assert level_sizes(1000, 144, coarsest=2048, ratio=16) == []


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


def test_coarse_iteration_finds_the_lowest_pairs_of_the_level():
    level = coarsen(sk.robust_laplacian(bumpy(2562)), 600)
    truth = eigh(level.stiffness.toarray(), level.mass.toarray(), eigvals_only=True)[:30]
    noise = np.random.default_rng(0).standard_normal((level.n, 45))
    found = coarse_iteration(level, coarse_ritz(level, noise, 45), 30, rtol=1e-12)
    again = coarse_iteration(level, found, 30, max_sweeps=1)
    for pairs in (found, again):
        np.testing.assert_allclose(pairs.eigenvalues[:30], truth, rtol=1e-9, atol=1e-9)
