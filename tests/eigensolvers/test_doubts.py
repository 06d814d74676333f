"""Predictions that are bad say so, and those that are good say nothing."""

import warnings

import numpy as np
import pytest
from conftest import creature, two_parts

from spectra_kit import (
    AmbientFourier,
    GivenBasis,
    RayleighRitz,
    Refined,
    Spectrum,
    eigensolve,
    robust_laplacian,
    verify,
)
from spectra_kit.eigensolvers.doubts import DOUBTFUL, proved_excess, verdict
from spectra_kit.errors import DoubtfulSpectrumWarning, SpectraKitWarning
from spectra_kit.geometry import sphere

K = 24
ROUGH = RayleighRitz(subspace=AmbientFourier(m=60, bandwidth=2.5))


@pytest.fixture(scope="module")
def laplacian():
    return robust_laplacian(creature(1500, seed=0))


@pytest.fixture(scope="module")
def exact(laplacian):
    return eigensolve(laplacian, K, Refined())


def predicted(laplacian, solver=ROUGH, k=K) -> Spectrum:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SpectraKitWarning)
        return eigensolve(laplacian, k, solver)


def test_a_bad_prediction_is_told_where_it_is_asked_for(laplacian, exact):
    """What is proved is true, and nearly all of the error."""
    with pytest.warns(DoubtfulSpectrumWarning, match="proved to be more than 10% too hi") as told:
        spectrum = eigensolve(laplacian, K, ROUGH)
    assert told[0].filename == __file__
    true = spectrum.eigenvalues[1:] / exact.eigenvalues[1:] - 1
    assert true.max() > 0.2
    assert f"mode {1 + true.argmax()} " in str(told[0].message)
    excess = spectrum.certificate.excess
    assert excess[0] == 0
    assert (excess[1:] <= true + 1e-9).all()
    assert excess.max() > 0.8 * true.max()


def test_exact_modes_and_good_predictions_are_quiet(laplacian, exact):
    near = GivenBasis(np.hstack([exact.eigenvectors, np.sin(laplacian.points)]))
    for solver in (Refined(), RayleighRitz(subspace=near)):  # any warning is an error here
        assert verdict(eigensolve(laplacian, K, solver)) == ""
    assert exact.certificate.excess is None


def test_a_mode_left_out_is_proved_only_as_far_as_smoothing_finds_it(laplacian, exact):
    """What is proved is a bound, not an estimate: exact modes without the second are not caught."""
    gap = Spectrum(exact.eigenvalues[[0, 2, 3]], exact.eigenvectors[:, [0, 2, 3]], exact.mass)
    assert proved_excess(gap, laplacian).max() < 1e-6


def test_components_and_fixed_points():
    two = robust_laplacian(two_parts())
    for laplacian in (two, two.dirichlet([0, 5, 9])):
        exact = eigensolve(laplacian, 8, Refined())
        noise = 0.3 * np.random.default_rng(1).standard_normal((laplacian.n, 8))
        noise[laplacian.fixed] = 0
        mixed = exact.eigenvectors + noise * np.abs(exact.eigenvectors).max()
        spectrum = predicted(laplacian, RayleighRitz(subspace=GivenBasis(mixed)), 8)
        excess = spectrum.certificate.excess
        zero = laplacian.kernel_dimension
        true = spectrum.eigenvalues[zero:] / exact.eigenvalues[zero:] - 1
        assert (excess[:zero] == 0).all()
        assert (excess[zero:] <= true + 1e-9).all()


def test_the_doubts_stay_with_the_modes(laplacian, tmp_path):
    spectrum = predicted(laplacian)
    excess = spectrum.certificate.excess
    spectrum.save(tmp_path / "s.npz")
    for same in (Spectrum.load(tmp_path / "s.npz"), spectrum.rescale(3.0)):
        np.testing.assert_array_equal(same.certificate.excess, excess)
        assert verdict(same) == verdict(spectrum) != ""
    np.testing.assert_array_equal(spectrum.truncate(5).certificate.excess, excess[:5])
    np.testing.assert_array_equal(spectrum.nonzero().certificate.excess, excess[1:])
    assert verify(spectrum, laplacian).certificate.excess.max() > DOUBTFUL


def test_an_uncertified_spectrum_has_no_verdict():
    ball = sphere(subdivisions=1).geometry
    assert verdict(Spectrum(np.zeros(1), np.ones((ball.n, 1)), np.ones(ball.n))) == ""
