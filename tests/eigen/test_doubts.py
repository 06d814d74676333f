"""Predictions that are bad say so, and those that are good say nothing."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from conftest import creature, two_parts

import spectra_kit as sk
from spectra_kit.eigen.accuracy import DOUBTFUL, proved_excess, verdict
from spectra_kit.errors import DoubtfulSpectrumWarning, SpectraKitWarning

K = 24
ROUGH = sk.RayleighRitz(subspace=sk.AmbientFourier(m=60, bandwidth=2.5))


@pytest.fixture(scope="module")
def laplacian():
    return sk.robust_laplacian(creature(1500, seed=0))


@pytest.fixture(scope="module")
def exact(laplacian):
    return sk.eigensolve(laplacian, K, sk.Refined())


def predicted(laplacian, solver=ROUGH, k=K) -> sk.Spectrum:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SpectraKitWarning)
        return sk.eigensolve(laplacian, k, solver)


def test_a_bad_prediction_is_told_where_it_is_asked_for(laplacian, exact):
    """What is proved is true, and nearly all of the error."""
    with pytest.warns(DoubtfulSpectrumWarning, match="proved to be more than 10% too hi") as told:
        spectrum = sk.eigensolve(laplacian, K, ROUGH)
    assert told[0].filename == __file__
    true = spectrum.eigenvalues[1:] / exact.eigenvalues[1:] - 1
    assert true.max() > 0.2
    assert f"mode {1 + true.argmax()} " in str(told[0].message)
    excess = spectrum.certificate.excess
    assert excess[0] == 0
    assert (excess[1:] <= true + 1e-9).all()
    assert excess.max() > 0.8 * true.max()


def test_exact_modes_and_good_predictions_are_quiet(laplacian, exact):
    near = sk.GivenBasis(np.hstack([exact.eigenvectors, np.sin(laplacian.points)]))
    for solver in (sk.Refined(), sk.RayleighRitz(subspace=near)):  # any warning is an error here
        assert verdict(sk.eigensolve(laplacian, K, solver)) == ""
    assert exact.certificate.excess is None


def test_a_mode_left_out_is_proved_only_as_far_as_smoothing_finds_it(laplacian, exact):
    """What is proved is a bound, not an estimate: exact modes without the second are not caught."""
    gap = sk.Spectrum(exact.eigenvalues[[0, 2, 3]], exact.eigenvectors[:, [0, 2, 3]], exact.mass)
    assert verdict(gap) == ""
    assert proved_excess(gap, laplacian).max() < 1e-6


def test_components_and_fixed_points():
    two = sk.robust_laplacian(two_parts())
    for laplacian in (two, two.dirichlet([0, 5, 9])):
        exact = sk.eigensolve(laplacian, 8, sk.Refined())
        noise = 0.3 * np.random.default_rng(1).standard_normal((laplacian.n, 8))
        noise[laplacian.fixed] = 0
        mixed = exact.eigenvectors + noise * np.abs(exact.eigenvectors).max()
        spectrum = predicted(laplacian, sk.RayleighRitz(subspace=sk.GivenBasis(mixed)), 8)
        excess = spectrum.certificate.excess
        zero = laplacian.kernel_dimension
        true = spectrum.eigenvalues[zero:] / exact.eigenvalues[zero:] - 1
        assert (excess[:zero] == 0).all()
        assert (excess[zero:] <= true + 1e-9).all()


def test_the_doubts_stay_with_the_modes(laplacian, tmp_path):
    spectrum = predicted(laplacian)
    excess = spectrum.certificate.excess
    spectrum.save(tmp_path / "s.npz")
    for same in (sk.Spectrum.load(tmp_path / "s.npz"), spectrum.rescale(3.0)):
        np.testing.assert_array_equal(same.certificate.excess, excess)
        assert verdict(same) == verdict(spectrum) != ""
    np.testing.assert_array_equal(spectrum.truncate(5).certificate.excess, excess[:5])
    np.testing.assert_array_equal(spectrum.nonzero().certificate.excess, excess[1:])
    assert sk.verify(spectrum, laplacian).certificate.excess.max() > DOUBTFUL


@pytest.mark.parametrize(
    "solver", [sk.Cascade(target=1e-10, max_steps=1), sk.Neo(target=1e-10, max_steps=1)]
)
def test_a_target_that_is_missed_is_told(solver) -> None:
    """Unless nothing was to be smoothed."""
    laplacian = sk.robust_laplacian(creature(6000, seed=0))
    missed = r"target = 1e-10 was not reached: 1 step of smoothing left errors .*max_steps"
    with pytest.warns(DoubtfulSpectrumWarning, match=missed):
        sk.eigensolve(laplacian, 40, solver)
    sk.eigensolve(laplacian, 40, replace(solver, max_steps=0))
