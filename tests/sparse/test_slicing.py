"""Spectrum slicing against spectra that are known, and against LAPACK."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

import spectra_kit as sk
from spectra_kit._sparse import block_lanczos
from spectra_kit._sparse.block_lanczos import BlockLanczos
from spectra_kit._sparse.slicing import _cut, sliced_eigenpairs
from spectra_kit.eigen import lanczos
from spectra_kit.geometry import creature, sphere


def cycle(n: int) -> sparse.csr_array:
    """The graph Laplacian of a closed path: eigenvalues 2 - 2 cos(2 pi j / n)."""
    off = -np.ones(n - 1)
    ends = np.array([-1.0])
    diagonals = [ends, off, np.full(n, 2.0), off, ends]
    return sparse.csr_array(sparse.diags_array(diagonals, offsets=[1 - n, -1, 0, 1, n - 1]))


def grid(n: int, stretch: float) -> tuple[sparse.csr_array, np.ndarray]:
    """A periodic grid of n by n points: a square where `stretch` is one, with eightfold values."""
    eye = sparse.eye_array(n)
    L = sparse.kron(cycle(n), eye) + stretch * sparse.kron(eye, cycle(n))
    one = 2 - 2 * np.cos(2 * np.pi * np.arange(n) / n)
    return sparse.csr_array(L), np.sort((one[:, None] + stretch * one).ravel())


@pytest.mark.parametrize(("k", "stretch"), [(40, 1.0), (301, 0.7)])
def test_the_spectrum_of_a_torus_copies_included(k: int, stretch: float) -> None:
    L, exact = grid(40, stretch)
    mass = np.full(1600, 0.5)
    found = sliced_eigenpairs(L, mass, k, below=-1e-3, spacing=2 * exact[k] / k)
    assert found.eigenvalues == pytest.approx(2 * exact[:k], abs=1e-11)
    U = found.eigenvectors
    assert np.abs(U.T @ (mass[:, None] * U) - np.eye(k)).max() < 1e-10
    assert np.abs(L @ U - mass[:, None] * U * found.eigenvalues).max() < 1e-9


@pytest.mark.parametrize("weight", [1e-7, 0.1])
def test_clusters_wider_than_the_space_of_a_run(monkeypatch, weight: float) -> None:
    """Forty spheres on weak links: forty values about zero, 120 about two; k cuts these."""
    one = sk.robust_laplacian(sphere(subdivisions=1).geometry)
    ends = one.n * np.arange(39)
    pick = sparse.eye_array(40 * one.n, format="csr")
    links = pick[ends] - pick[ends + one.n + 5]
    L = sparse.csr_array(sparse.block_diag([one.stiffness] * 40) + weight * (links.T @ links))
    points = np.vstack([one.points + [5.0 * i, 0, 0] for i in range(40)])
    laplacian = sk.Laplacian(L, np.tile(one.mass, 40), points)
    spectrum = sk.eigensolve(laplacian, 100)
    exact = sk.eigensolve(laplacian, 100, sk.Dense())
    assert spectrum.eigenvalues == pytest.approx(exact.eigenvalues, rel=1e-9, abs=1e-9)
    assert (spectrum.provenance.name, spectrum.certificate.n_verified) == ("lanczos", 100)
    if weight == 1e-7:
        monkeypatch.setattr(lanczos, "WIDE", 8)
        monkeypatch.setattr(sk.Dense, "few", 0)  # which would go on from there
        with pytest.raises(
            sk.errors.ConvergenceError, match=r"more equal eigenvalues .* use Dense"
        ):
            sk.eigensolve(laplacian, 100)


@pytest.fixture(scope="module")
def uneven() -> sk.Laplacian:
    return sk.robust_laplacian(creature(1450, seed=1))


@pytest.fixture(scope="module")
def exact(uneven: sk.Laplacian) -> sk.Spectrum:
    """By LAPACK, as many modes as are found by slicing."""
    return sk.eigensolve(uneven, uneven.n // 3 - 1, sk.Dense())


def test_against_lapack_up_to_the_end_of_what_is_sliced(uneven, exact) -> None:
    k = exact.k
    found = sk.eigensolve(uneven, k)
    assert found.eigenvalues == pytest.approx(exact.eigenvalues, rel=1e-9, abs=1e-9)
    assert found.certificate.relative_residuals.max() < 1e-9
    assert found.certificate.orthonormality_error < 1e-10
    assert found.certificate.n_verified == k


def test_the_bits_do_not_depend_on_the_number_of_threads(uneven, monkeypatch) -> None:
    many = sk.Lanczos().eigenpairs(uneven, 200)
    monkeypatch.setenv("NUMBA_NUM_THREADS", "1")
    one = sk.Lanczos().eigenpairs(uneven, 200)
    assert np.array_equal(many.eigenvectors, one.eigenvectors)


def test_with_too_few_shifts_the_lowest_modes_are_kept(uneven, exact) -> None:
    with pytest.raises(sk.errors.ConvergenceError, match="of 400 modes around 1 shift") as caught:
        sk.eigensolve(uneven, 400, sk.Lanczos(max_shifts=1))
    partial = caught.value.partial
    assert 40 < partial.k < 400
    expected = exact.eigenvalues[: partial.k]
    assert partial.eigenvalues == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("tol", [1e-7, 1e-4, 1e-2])
def test_a_tolerance_is_kept_and_all_modes_are_orthonormal(uneven, exact, tol) -> None:
    loose = sk.eigensolve(uneven, 450, sk.Lanczos(tol=tol))
    assert loose.certificate.relative_residuals.max() < 10 * tol + 1e-5
    assert loose.certificate.orthonormality_error < 1e-11
    expected = exact.eigenvalues[:450]
    rounding = max(1e-8, 3 * tol**2)
    assert loose.eigenvalues == pytest.approx(expected, rel=rounding, abs=rounding)


@pytest.mark.parametrize("tol", [1e-4, 1e-3])
def test_what_is_found_more_loosely_errs_by_the_square(uneven, exact, tol) -> None:
    spacing = uneven.eigenvalue_spacing
    values, U, *_ = sliced_eigenpairs(
        *(uneven.stiffness, uneven.mass, 450),
        **{"below": -0.1 * spacing, "spacing": spacing, "tol": tol, "most_shifts": 99, "seed": 0},
    )
    assert np.abs(U.T @ (uneven.mass[:, None] * U) - np.eye(450)).max() < 1e-11 + tol**3
    assert values == pytest.approx(exact.eigenvalues[:450], rel=3 * tol**2, abs=3 * tol**2)
    overlap = exact.eigenvectors[:, :450].T @ (uneven.mass[:, None] * U)
    assert 1 - np.sum(overlap**2) / 450 < tol**2


def test_where_two_runs_are_put_together() -> None:
    known = np.array([1.0, 2.0, 3.0, 3.0 + 1e-9])
    assert _cut(known, np.array([3.0, 3.0 + 1e-9, 4.0]), 5, 1e-6) == 2  # not within the cluster
    assert _cut(known, np.array([4.0]), 5, 1e-6) == 4
    assert _cut(known, np.array([5.0]), 6, 1e-6) is None  # one is still to be found
    assert _cut(known[:3], np.array([3.0 + 1e-9]), 4, 1e-6) is None  # a cluster from both
    assert (
        _cut(known, np.array([2.0, 3.0, 4.0]), 5, 1e-6) == 4
    )  # only the lower run has both copies
    assert _cut(known[:3], np.array([3.0, 4.0]), 5, 1e-6) is None  # neither has
    assert _cut(known[:0], known, 4, 1.0) == 0
    assert _cut(known[:0], known[1:], 4, 0.0) is None


def test_a_space_that_becomes_invariant_still_grows() -> None:
    values = np.repeat([1.0, 2.0, 5.0, 9.0], 50)
    krylov = BlockLanczos(lambda X: values[:, None] * X, 200, block=4, most=120, seed=0)
    while krylov.size < 120:
        krylov.step()
    found = krylov.ritz()
    X = krylov.lifted(found.rotation)
    assert np.abs(X @ X.T - np.eye(120)).max() < 1e-12
    assert np.abs(X * values - found.values[:, None] * X).max() < 1e-10 + found.residuals.max()


def test_a_loose_space_is_as_good_as_orthogonal_and_powers_find_more(monkeypatch) -> None:
    """Of an inverse whose eigenvalues are far apart near the shift, and crowd far from it."""
    values = 1 / (np.arange(1.0, 1001) * np.where(np.arange(1000) % 2, 1, -1) - 0.47)
    found = {}
    for loose, powers in ((False, 0), (False, 4), (True, 4)):
        monkeypatch.setattr(block_lanczos, "_POWERS", powers)
        options = {"block": 8, "most": 240, "seed": 0, "loose": loose}
        krylov = BlockLanczos(lambda X: values[:, None] * X, 1000, **options)
        while krylov.size < 240:
            krylov.step()
        ritz = krylov.ritz()
        X = krylov.lifted(ritz.rotation)
        assert np.abs(X @ X.T - np.eye(240)).max() < (1e-7 if loose else 1e-11)
        good = int((ritz.residuals > 1e-3 * np.abs(ritz.values)).argmax())  # from one end
        assert ritz.values[:good] == pytest.approx(np.sort(values)[:good], rel=1e-5)
        found[loose, powers] = good
    assert found[True, 4] == found[False, 4] >= found[False, 0] + 4
