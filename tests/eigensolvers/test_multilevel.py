"""Coarse levels solved, smoothed and carried up: the backends `Capped` and `Multilevel`."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import bumpy, creature, two_parts
from scipy.linalg import eigh

from spectra_kit import (
    AmbientFourier,
    Capped,
    ConvergenceError,
    GivenBasis,
    Laplacian,
    Multilevel,
    Neo,
    Polished,
    RandomBasis,
    RayleighRitz,
    Refined,
    eigensolve,
    robust_laplacian,
)
from spectra_kit.eigensolvers.multilevel import level_sizes
from spectra_kit.geometry import rectangle, sphere
from spectra_kit.levels import coarse_iteration, coarse_ritz, coarsen, smoothed

K = 40


@pytest.fixture(scope="module")
def laplacian() -> Laplacian:
    return robust_laplacian(creature(6000, seed=0))


@pytest.fixture(scope="module")
def exact(laplacian: Laplacian):
    return eigensolve(laplacian, K)


def mean_error(spectrum, exact) -> float:
    k = spectrum.k
    return float(np.abs(spectrum.eigenvalues[1:] / exact.eigenvalues[1:k] - 1).mean())


@pytest.mark.parametrize("rtol", [1e-3, 1e-6, 1e-10])
def test_multilevel_reaches_any_tolerance(laplacian, exact, rtol):
    solver = Multilevel(rtol=rtol, coarsest=300, ratio=4)
    assert level_sizes(laplacian.n, K + 20, coarsest=300, ratio=4) == [1200, 300]
    s = eigensolve(laplacian, K, solver)
    assert s.certificate.relative_residuals.max() <= rtol
    assert s.eigenvalues == pytest.approx(exact.eigenvalues, rel=max(10 * rtol**2, 1e-11))
    assert {"coarsen", "coarse"} <= set(s.provenance.seconds)
    assert s.provenance.iterations >= 1


def test_multilevel_starts_closer_than_noise(laplacian):
    levels = eigensolve(laplacian, K, Multilevel(degree=2))
    noise = eigensolve(laplacian, K, Refined(start=RandomBasis(m=60), rtol=1e-6, degree=2))
    assert levels.provenance.iterations < noise.provenance.iterations


def test_multilevel_misses_no_mode_of_a_sphere():
    laplacian = robust_laplacian(sphere(subdivisions=5).geometry)
    s = eigensolve(laplacian, 49, Multilevel(coarsest=500))
    shells = np.repeat(np.arange(7), 2 * np.arange(7) + 1)
    assert s.eigenvalues == pytest.approx(shells * (shells + 1), rel=0.01, abs=1e-9)


def test_multilevel_with_fixed_points_and_parts():
    mesh = rectangle(n=6000).geometry
    for laplacian in (
        robust_laplacian(mesh).dirichlet(mesh.boundary_vertices),
        robust_laplacian(two_parts()),
    ):
        s = eigensolve(laplacian, 20, Multilevel(coarsest=200))
        assert s.eigenvalues == pytest.approx(eigensolve(laplacian, 20).eigenvalues, abs=1e-7)


def test_multilevel_says_what_it_did_not_reach(laplacian):
    with pytest.raises(ConvergenceError, match="raise max_sweeps") as caught:
        eigensolve(laplacian, K, Multilevel(rtol=1e-10, degree=1, max_sweeps=2))
    partial = caught.value.partial
    assert partial.k == K
    assert partial.certificate.relative_residuals.max() > 1e-10


def test_levels_need_room():
    assert level_sizes(64_000, 144, coarsest=2048, ratio=12) == [2048]
    assert level_sizes(600_000, 144, coarsest=2048, ratio=12) == [24576, 2048]
    assert level_sizes(64_000, 1000, coarsest=2048, ratio=16) == [4000]
    assert level_sizes(1000, 144, coarsest=2048, ratio=16) == []


@pytest.mark.parametrize("kind", ["mesh", "cloud"])
@pytest.mark.parametrize("subspace", [Neo().subspace, RandomBasis(m=60)], ids=["neo", "random"])
def test_a_capped_prediction_is_close(laplacian, exact, subspace, kind):
    if kind == "cloud":
        laplacian = robust_laplacian(creature(6000, seed=0).as_cloud())
        exact = eigensolve(laplacian, K)
    rough, swept = (
        eigensolve(laplacian, K, Capped(subspace=subspace, n_points=2000, sweeps=3, smoothing=s))
        for s in (0, 6)
    )
    assert mean_error(rough, exact) < 3e-3
    assert mean_error(swept, exact) < min(1e-4, mean_error(rough, exact) / 5)
    for s in (rough, swept):  # Ritz values
        assert (s.eigenvalues[1:] >= exact.eigenvalues[1:] * (1 - 1e-10)).all()


def test_a_capped_network_is_better_than_the_whole(laplacian, exact):
    whole = eigensolve(laplacian, K, Neo())
    capped = eigensolve(laplacian, K, Capped(subspace=Neo().subspace, n_points=2000))
    assert mean_error(capped, exact) < mean_error(whole, exact)


def test_a_capped_basis_may_be_given(laplacian, exact):
    """Columns that belong to the points: the rows of the subset are taken."""
    given = GivenBasis(exact.eigenvectors)
    s = eigensolve(laplacian, K, Capped(subspace=given, n_points=2000, sweeps=0))
    assert mean_error(s, exact) < 1e-4


def test_a_cap_above_the_points_is_no_cap(bumpy_laplacian):
    subspace = AmbientFourier(m=60, bandwidth=3.0)
    for sweeps, whole in (
        (0, RayleighRitz(subspace=subspace)),
        (1, Polished(start=subspace)),
        (2, Polished(start=subspace, sweeps=2)),
    ):
        capped = Capped(subspace=subspace, n_points=400, sweeps=sweeps)
        a, b = (eigensolve(bumpy_laplacian, 10, solver) for solver in (capped, whole))
        np.testing.assert_array_equal(a.eigenvalues, b.eigenvalues)


def test_no_cliff_where_the_cap_begins():
    """Just below twice as many points as the cap, and just above: about as good."""
    laplacian = robust_laplacian(creature(5000, seed=0))
    exact = eigensolve(laplacian, 60).eigenvalues
    errors = [
        np.abs(eigensolve(laplacian, 60, Capped(n_points=n)).eigenvalues[1:] / exact[1:] - 1).mean()
        for n in (2600, 2400)
    ]
    assert max(errors) < 1e-3


def test_nested_levels_compose(laplacian, exact):
    fine = coarsen(laplacian, 2500)
    bottom = coarsen(fine, 500)
    assert bottom.mass.sum() == pytest.approx(laplacian.area)
    assert (bottom.lumped > 0).all()
    values, vectors = eigh(
        bottom.stiffness.toarray(), bottom.mass.toarray(), subset_by_index=[0, 9]
    )
    U = fine.prolongation @ (bottom.prolongation @ vectors)
    np.testing.assert_allclose(U.T @ (laplacian.mass[:, None] * U), np.eye(10), atol=1e-9)
    assert values[1:] == pytest.approx(exact.eigenvalues[1:10], rel=0.01)


def test_coarse_iteration_finds_the_lowest_pairs_of_the_level():
    level = coarsen(robust_laplacian(bumpy(2562)), 600)
    truth = eigh(level.stiffness.toarray(), level.mass.toarray(), eigvals_only=True)[:30]
    noise = np.random.default_rng(0).standard_normal((level.n, 45))
    start = coarse_ritz(level, noise, 45)
    found = coarse_iteration(level, start, 30, rtol=1e-12)
    np.testing.assert_allclose(found.eigenvalues[:30], truth, rtol=1e-9, atol=1e-9)
    again = coarse_iteration(level, found, 30, max_sweeps=1)
    np.testing.assert_allclose(again.eigenvalues[:30], truth, rtol=1e-9, atol=1e-9)


def test_smoothing_leaves_modes_alone_and_takes_noise_away(laplacian, exact):
    values, modes = exact.eigenvalues, exact.eigenvectors
    kept = smoothed(laplacian, values, modes)
    root = np.sqrt(laplacian.mass)[:, None]
    assert np.linalg.norm(root * (kept - modes), axis=0).max() < 1e-6
    noise = np.random.default_rng(0).standard_normal(modes.shape) / np.sqrt(laplacian.area)
    noisy = modes + 0.01 * noise

    def energy(error):
        return np.einsum("ij,ij->j", error, laplacian.stiffness @ error)

    left = energy(smoothed(laplacian, values, noisy) - modes) / energy(noisy - modes)
    assert left.max() < 0.05
    more = energy(smoothed(laplacian, values, noisy, degree=12) - modes) / energy(noisy - modes)
    assert (more < left).all()


def test_smoothing_has_the_same_bits_on_any_number_of_threads(laplacian, exact, monkeypatch):
    noisy = exact.eigenvectors + np.random.default_rng(0).standard_normal((laplacian.n, K))
    a = smoothed(laplacian, exact.eigenvalues, noisy)
    monkeypatch.setenv("NUMBA_NUM_THREADS", "3")
    np.testing.assert_array_equal(a, smoothed(laplacian, exact.eigenvalues, noisy))
