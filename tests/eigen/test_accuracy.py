"""How far eigenvalues are off: bounds hold, and what is far too high is proved to be."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
from conftest import bumpy, creature, joined, moved, two_parts

import spectra_kit as sk
from spectra_kit.cli.tables import certificate_lines, modes_table
from spectra_kit.eigen import Eigenpairs
from spectra_kit.eigen.accuracy import DOUBTFUL, proved_excess, verdict
from spectra_kit.errors import DoubtfulSpectrumWarning, SpectraKitWarning
from spectra_kit.geometry import rectangle, sphere

SHAPES = {
    "sphere": lambda: sphere(subdivisions=3).geometry,
    "rectangle": lambda: rectangle(n=600).geometry,
    "animal": lambda: creature(1500, seed=0),
    "parts": lambda: joined(creature(900, seed=0), moved(creature(700, seed=0), 9, 0, 0)),
}
K = 30


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("rtol", [1e-2, 1e-5])
def test_no_counted_eigenvalue_is_off_by_more(shape, rtol):
    laplacian = sk.robust_laplacian(SHAPES[shape]())
    exact = sk.eigensolve(laplacian, K)
    found = sk.eigensolve(
        laplacian, K, sk.Refined(start=sk.eigen.subspaces.AmbientFourier(m=50), rtol=rtol)
    )
    least = np.maximum(exact.eigenvalues, found.certificate.residuals / rtol)
    off = np.abs(found.eigenvalues - exact.eigenvalues) / least
    certificate = found.certificate
    assert certificate.bounded.sum() == certificate.n_verified >= 0.6 * K
    assert (off <= certificate.errors + 1e-13)[certificate.bounded].all()
    if rtol == 1e-2:  # far from rounding, they are of second order
        gained = certificate.errors / certificate.relative_residuals
        assert np.median(gained[3:][certificate.bounded[3:]]) < 0.5


def test_tables_tell_which_kind_it_is(animal_spectrum):
    exact = animal_spectrum.truncate(3)
    rough = replace(exact.certificate, errors=[0, 1e-3, 2e-3], bounded=[True, True, False])
    told = exact.described(rough, exact.provenance)
    rows = modes_table(told, range(3)).splitlines()
    assert [row.split("  ")[-1].strip() for row in rows[2:]] == ["at most 1e-03", "about 2e-03"]
    assert "bounds for 2 of 3" in certificate_lines(told)
    with pytest.raises(sk.errors.InvalidInputError, match="bounded"):
        replace(rough, bounded=[True])


def test_all_is_exact_up_to_rounding(animal, animal_spectrum):
    certificate = animal_spectrum.certificate
    assert certificate.bounded.all()
    assert (certificate.errors < 1e-9).all()


def test_estimates_where_nothing_is_counted(animal, animal_spectrum):
    """Too low for none, of modes that were swept with a filter."""

    class Loose:
        def eigenpairs(self, laplacian: sk.Laplacian, k: int) -> Eigenpairs:
            return sk.Refined(rtol=1e-2).eigenpairs(laplacian, k)

    found = sk.eigensolve(animal, 20, Loose())
    off = found.eigenvalues[1:] / animal_spectrum.eigenvalues[1:20] - 1
    assert not found.certificate.bounded.any()
    assert (found.certificate.errors[1:] > off / 3).all()


def test_what_one_part_is_off_by_is_told_of_modes_of_another_that_come_before_it():
    ball = sphere(subdivisions=3).geometry
    smaller = moved(ball, 3, 0, 0, scale=1.001**-0.5)  # its eigenvalues are 1.001 times as high

    class Mixed:
        def eigenpairs(self, laplacian: sk.Laplacian, k: int) -> Eigenpairs:
            found = sk.eigensolve(laplacian, 20)
            values, vectors = found.eigenvalues[:k].copy(), found.eigenvectors[:, :k].copy()
            if laplacian.area > 0.9995 * ball.area:  # the first of three copies, 1.0018 times
                higher, part = found.eigenvalues[15], 0.019
                vectors[:, 1] *= np.sqrt(1 - part**2)
                vectors[:, 1] += part * found.eigenvectors[:, 15]
                values[1] += part**2 * (higher - values[1])
            return Eigenpairs(values, vectors)

    laplacian = sk.robust_laplacian(joined(ball, smaller))
    exact = sk.eigensolve(laplacian, 8).eigenvalues
    found = sk.eigensolve(laplacian, 8, Mixed())
    off, unit = found.eigenvalues - exact, np.maximum(exact, 1)
    assert (off[[4, 7]] > 1e-3).all()  # of which the former is a mode of the exact part
    assert (off <= 3 * found.certificate.errors * unit + 1e-9).all()


@pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulSpectrumWarning")
def test_a_prediction_is_told_nothing_by_its_residuals(animal):
    waves = sk.RayleighRitz(subspace=sk.eigen.subspaces.AmbientFourier(m=60))
    found = sk.eigensolve(animal, 20, waves)
    assert found.certificate.relative_residuals.max() > 0.1
    assert found.certificate.errors is None
    assert not found.certificate.bounded.any()


def test_values_that_are_no_rayleigh_quotients_are_off(animal, animal_spectrum):
    """By as much as that, to first order; the bound says so."""
    exact = animal_spectrum.truncate(20)
    wrong = exact.eigenvalues * (1 + 1e-5 * np.sin(np.arange(20)))
    given = sk.verify(sk.Spectrum(wrong, exact.eigenvectors, exact.mass), animal)
    bounded = given.certificate.bounded
    assert bounded[1:-1].all()
    least = np.maximum(exact.eigenvalues, animal.eigenvalue_spacing)
    off = np.abs(wrong - exact.eigenvalues) / least
    assert (given.certificate.errors >= off - 1e-12)[bounded].all()


def assert_kept(spectrum, path, *names) -> None:
    """Cut, scaled, written and read, a spectrum has the same numbers of each mode."""
    spectrum.save(path)
    for name in names:
        known = getattr(spectrum.certificate, name)
        for same in (sk.Spectrum.load(path), spectrum.rescale(3.0)):
            np.testing.assert_array_equal(getattr(same.certificate, name), known)
        short, live = spectrum.truncate(5), spectrum.nonzero()
        np.testing.assert_array_equal(getattr(short.certificate, name), known[:5])
        np.testing.assert_array_equal(getattr(live.certificate, name), known[1:])


def test_the_kinds_stay_with_the_modes(tmp_path, animal_spectrum):
    assert_kept(animal_spectrum, tmp_path / "s.npz", "bounded", "errors")
    assert animal_spectrum.truncate(5).certificate.bounded.tolist() == [True] * 5


def test_modes_that_are_not_of_unit_norm():
    """A mode too long makes its Rayleigh quotient too large by the square: bounds must tell."""
    laplacian = sk.robust_laplacian(sphere(subdivisions=3).geometry)
    exact = sk.eigensolve(laplacian, 9)
    long = sk.Spectrum(1.0201 * exact.eigenvalues, 1.01 * exact.eigenvectors, laplacian.mass)
    proved = sk.verify(long, laplacian).certificate
    off = np.abs(long.eigenvalues[1:] / exact.eigenvalues[1:] - 1)
    assert (proved.errors[1:] >= off)[proved.bounded[1:]].all()


def test_errors_stay_with_their_modes_when_the_constant_comes_out() -> None:
    """A mode that held some of the constant has another place without it."""
    laplacian = sk.robust_laplacian(bumpy())
    exact = sk.eigensolve(laplacian, 10, sk.Dense())
    told = np.arange(1.0, 11.0) * 1e-3
    turned = np.eye(10)
    turned[np.ix_([0, 8], [0, 8])] = np.array([[3, 4], [-4, 3]]) / 5

    class Mixed:
        def eigenpairs(self, laplacian: sk.Laplacian, k: int) -> Eigenpairs:
            vectors = exact.eigenvectors @ turned
            values = np.diag(turned.T @ (exact.eigenvalues[:, None] * turned))
            return Eigenpairs(values, vectors, errors=told)

    found = sk.eigensolve(laplacian, 10, Mixed())
    np.testing.assert_allclose(found.eigenvalues, exact.eigenvalues, rtol=1e-9, atol=1e-12)
    expected = told.copy()
    expected[[0, 8]] = 0.0, told[8]
    np.testing.assert_allclose(found.certificate.errors, expected, rtol=1e-14)


MODES = 24
ROUGH = sk.RayleighRitz(subspace=sk.eigen.subspaces.AmbientFourier(m=60, bandwidth=2.5))


@pytest.fixture(scope="module")
def laplacian():
    return sk.robust_laplacian(creature(1500, seed=0))


@pytest.fixture(scope="module")
def exact(laplacian):
    return sk.eigensolve(laplacian, MODES, sk.Refined())


def predicted(laplacian, solver=ROUGH, k=MODES) -> sk.Spectrum:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SpectraKitWarning)
        return sk.eigensolve(laplacian, k, solver)


def test_a_bad_prediction_is_told_where_it_is_asked_for(laplacian, exact):
    """What is proved is true, and nearly all of the error."""
    with pytest.warns(DoubtfulSpectrumWarning, match="proved to be more than 10% too hi") as told:
        spectrum = sk.eigensolve(laplacian, MODES, ROUGH)
    assert told[0].filename == __file__
    true = spectrum.eigenvalues[1:] / exact.eigenvalues[1:] - 1
    assert true.max() > 0.2
    assert f"mode {1 + true.argmax()} " in str(told[0].message)
    excess = spectrum.certificate.excess
    assert excess[0] == 0
    assert (excess[1:] <= true + 1e-9).all()
    assert excess.max() > 0.8 * true.max()


def test_exact_modes_and_good_predictions_are_quiet(laplacian, exact):
    near = sk.eigen.subspaces.GivenBasis(np.hstack([exact.eigenvectors, np.sin(laplacian.points)]))
    for solver in (sk.Refined(), sk.RayleighRitz(subspace=near)):  # any warning is an error here
        assert verdict(sk.eigensolve(laplacian, MODES, solver)) == ""
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
        spectrum = predicted(
            laplacian, sk.RayleighRitz(subspace=sk.eigen.subspaces.GivenBasis(mixed)), 8
        )
        excess = spectrum.certificate.excess
        zero = laplacian.kernel_dimension
        true = spectrum.eigenvalues[zero:] / exact.eigenvalues[zero:] - 1
        assert (excess[:zero] == 0).all()
        assert (excess[zero:] <= true + 1e-9).all()


def test_the_doubts_stay_with_the_modes(laplacian, tmp_path):
    spectrum = predicted(laplacian)
    assert_kept(spectrum, tmp_path / "s.npz", "excess")
    assert verdict(sk.Spectrum.load(tmp_path / "s.npz")) == verdict(spectrum) != ""
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
