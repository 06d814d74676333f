"""Coarse levels solved, smoothed and carried up: the backends `Capped` and `Multilevel`."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import bumpy, creature
from scipy.linalg import eigh

import spectra_kit as sk
from spectra_kit.eigensolvers.multilevel import level_sizes
from spectra_kit.levels import coarse_iteration, coarse_ritz, coarsen, smoothed

K = 40


def mean_error(spectrum, exact) -> float:
    k = spectrum.k
    return float(np.abs(spectrum.eigenvalues[1:] / exact.eigenvalues[1:k] - 1).mean())


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


@pytest.mark.parametrize(
    ("subspace", "cloud"),
    [(sk.Neo().subspace, False), (sk.RandomBasis(m=60), True)],
    ids=["neo", "random"],
)
def test_a_capped_prediction_is_close(animal, animal_spectrum, subspace, cloud):
    laplacian, exact = animal, animal_spectrum
    if cloud:
        laplacian = sk.robust_laplacian(creature(4000, seed=0).as_cloud())
        exact = sk.eigensolve(laplacian, K)
    rough, smooth = (
        sk.eigensolve(
            laplacian, K, sk.Capped(subspace=subspace, n_points=1500, sweeps=3, smoothing=s)
        )
        for s in (0, 6)
    )
    assert mean_error(rough, exact) < 3e-3
    assert mean_error(smooth, exact) < min(1e-4, mean_error(rough, exact) / 5)
    for s in (rough, smooth):  # Ritz values
        assert (s.eigenvalues[1:] >= exact.eigenvalues[1:K] * (1 - 1e-10)).all()


def test_a_capped_network_is_better_than_the_whole(animal, animal_spectrum):
    whole = sk.eigensolve(animal, K, sk.Neo())
    capped = sk.eigensolve(animal, K, sk.Capped(subspace=sk.Neo().subspace, n_points=1500))
    assert mean_error(capped, animal_spectrum) < mean_error(whole, animal_spectrum)


def test_a_capped_basis_may_be_given(animal, animal_spectrum):
    """Columns that belong to the points: the rows of the subset are taken."""
    given = sk.GivenBasis(animal_spectrum.eigenvectors)
    s = sk.eigensolve(animal, K, sk.Capped(subspace=given, n_points=1500, sweeps=0))
    assert mean_error(s, animal_spectrum) < 1e-4


def test_a_cap_above_the_points_is_no_cap(bumpy_laplacian):
    subspace = sk.AmbientFourier(m=60, bandwidth=3.0)
    for sweeps, whole in (
        (0, sk.RayleighRitz(subspace=subspace)),
        (2, sk.Polished(start=subspace, sweeps=2)),
    ):
        capped = sk.Capped(subspace=subspace, n_points=400, sweeps=sweeps)
        a, b = (sk.eigensolve(bumpy_laplacian, 10, solver) for solver in (capped, whole))
        np.testing.assert_array_equal(a.eigenvalues, b.eigenvalues)


def test_no_cliff_where_the_cap_begins(animal, animal_spectrum):
    """Just below twice as many points as the cap, and just above: about as good."""
    for n in (2100, 1900):
        assert mean_error(sk.eigensolve(animal, 60, sk.Capped(n_points=n)), animal_spectrum) < 1e-3


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


def test_smoothing_leaves_modes_alone_and_takes_noise_away(animal, animal_spectrum, monkeypatch):
    values, modes = animal_spectrum.eigenvalues[:K], animal_spectrum.eigenvectors[:, :K]
    root = np.sqrt(animal.mass)[:, None]
    assert np.linalg.norm(root * (smoothed(animal, values, modes) - modes), axis=0).max() < 1e-6
    noise = np.random.default_rng(0).standard_normal(modes.shape) / np.sqrt(animal.area)
    noisy = modes + 0.01 * noise

    def energy(error):
        return np.einsum("ij,ij->j", error, animal.stiffness @ error)

    once, twice = (smoothed(animal, values, noisy, degree=degree) for degree in (6, 12))
    left, less = (energy(smooth - modes) / energy(noisy - modes) for smooth in (once, twice))
    assert left.max() < 0.05
    assert (less < left).all()
    monkeypatch.setenv("NUMBA_NUM_THREADS", "3")  # the same bits on any number
    np.testing.assert_array_equal(once, smoothed(animal, values, noisy))
