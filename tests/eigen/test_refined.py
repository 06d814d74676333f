"""Refinement of any start to any residual, and what happens when it cannot be reached."""

from __future__ import annotations

import numpy as np
import pytest

import spectra_kit as sk
from spectra_kit._sparse import host
from spectra_kit._sparse.products import residual_norms, residuals
from spectra_kit._sparse.ritz import ritz_pairs, ritz_rotation
from spectra_kit._sparse.shift_invert import shift_invert_iteration
from spectra_kit.geometry import sphere

K = 40


STARTS = {
    "waves": sk.eigen.subspaces.AmbientFourier(m=100, bandwidth=4.0),
    "network": sk.Neo().subspace,
    "random": sk.eigen.subspaces.RandomBasis(m=60, seed=3),
    "too few columns": sk.eigen.subspaces.RandomBasis(m=5),
    "no columns": lambda points, mass: np.empty((len(points), 0)),
    "constants alone": lambda points, mass: np.ones((len(points), 3)),
}


@pytest.mark.parametrize(
    ("start", "rtol"),
    [("waves", 1e-3), ("waves", 1e-10), *((start, 1e-6) for start in list(STARTS)[1:])],
)
def test_any_start_reaches_any_tolerance(animal, animal_spectrum, start: str, rtol: float) -> None:
    s = sk.eigensolve(animal, K, sk.Refined(start=STARTS[start], rtol=rtol))
    assert s.certificate.relative_residuals.max() <= rtol
    # The error of a Ritz value is quadratic in its residual.
    assert s.eigenvalues == pytest.approx(
        animal_spectrum.eigenvalues[:K], rel=max(10 * rtol**2, 1e-11)
    )
    assert s.provenance.iterations >= 1


@pytest.mark.parametrize(
    ("noise", "missing"),
    [(0.0, (7,)), (1e-8, (K - 2, K - 1, K)), (1e-4, (0, K - 1))],
)
def test_modes_that_the_start_lacks_are_found(animal, animal_spectrum, noise, missing) -> None:
    """Neither silently left out, nor taken for rounding while they come up."""
    columns = np.delete(animal_spectrum.eigenvectors, missing, axis=1)
    columns = columns + noise * np.random.default_rng(0).standard_normal(columns.shape)
    s = sk.eigensolve(animal, K, sk.Refined(start=sk.eigen.subspaces.GivenBasis(columns)))
    assert s.eigenvalues == pytest.approx(animal_spectrum.eigenvalues[:K], rel=1e-10, abs=1e-10)


def test_k_inside_a_cluster() -> None:
    """On the sphere, where the guards may end anywhere in a shell of equal eigenvalues."""
    laplacian = sk.robust_laplacian(sphere(subdivisions=4).geometry)
    exact = sk.eigensolve(laplacian, 36).eigenvalues
    for k in (15, 17, 21):
        s = sk.eigensolve(laplacian, k, sk.Refined())
        assert s.certificate.relative_residuals.max() <= 1e-8
        assert s.eigenvalues == pytest.approx(exact[:k], rel=1e-10, abs=1e-10)


def test_a_better_start_takes_fewer_sweeps(animal, animal_spectrum) -> None:
    sweeps = [
        sk.eigensolve(animal, K, sk.Refined(start=start)).provenance.iterations
        for start in (
            sk.eigen.subspaces.GivenBasis(animal_spectrum.eigenvectors),
            STARTS["network"],
            sk.eigen.subspaces.RandomBasis(m=60),
        )
    ]
    assert sweeps[0] == 1
    assert sweeps[0] < sweeps[1] < sweeps[2]


def test_short_of_the_tolerance(animal) -> None:
    """The error says how many made it and what to change, and carries what there is."""
    with pytest.raises(
        sk.errors.ConvergenceError, match=r"of 40 modes .*raise max_sweeps, loosen rtol"
    ) as e:
        sk.eigensolve(animal, K, sk.Refined(start=sk.eigen.subspaces.RandomBasis(), max_sweeps=2))
    partial = e.value.partial
    assert partial.k == K
    made_it = (partial.certificate.relative_residuals <= 1e-8).sum()
    assert e.value.n_converged == made_it
    assert f"{made_it} of 40 modes reached rtol = 1e-08 in 2 sweeps" in str(e.value)
    assert partial.provenance.iterations == 2


def test_rounding_is_recognised_however_it_falls(bumpy_laplacian) -> None:
    """Residuals that are rounding fall as often as they rise: that is no progress."""
    exact = sk.eigensolve(bumpy_laplacian, K).eigenvalues
    for seed in range(2):
        with pytest.raises(
            sk.errors.ConvergenceError, match="rounding stops the others; loosen"
        ) as e:
            sk.eigensolve(bumpy_laplacian, K, sk.Refined(rtol=1e-14, seed=seed))
        assert e.value.partial.certificate.relative_residuals.max() < 1e-10
        assert e.value.partial.eigenvalues == pytest.approx(exact, rel=1e-11, abs=1e-11)


def test_sweeps_converge_at_the_rate_of_chebyshev(animal, animal_spectrum) -> None:
    """In the long run the last wanted mode gains on the last of the block as the filter says."""
    block, degree = 60, 4
    residuals = [
        shift_invert_iteration(
            animal.stiffness,
            animal.mass,
            sk.eigen.subspaces.AmbientFourier(m=60, bandwidth=4.0)(animal.points, animal.mass),
            K,
            tolerance=np.zeros_like,
            spacing=animal.eigenvalue_spacing,
            block=block,
            degree=degree,
            max_sweeps=sweeps,
        ).residuals[K - 1]
        for sweeps in (5, 7)
    ]
    edge = animal_spectrum.eigenvalues[block - 1] * (1 + 2 / block)
    x = 2 * (edge + edge / 8) / (animal_spectrum.eigenvalues[[K - 1, block - 1]] + edge / 8) - 1
    wanted, guard = np.polynomial.Chebyshev.basis(degree)(x)
    predicted = guard / wanted
    assert np.sqrt(residuals[1] / residuals[0]) == pytest.approx(predicted, rel=0.5)


def test_ritz_pairs_of_a_bad_basis(bumpy_laplacian) -> None:
    """Scale, dependence and tiny directions of the columns do not matter, down to `rank_tol`."""
    L, mass = bumpy_laplacian.stiffness, bumpy_laplacian.mass
    modes = sk.eigensolve(bumpy_laplacian, 30).eigenvectors
    rng = np.random.default_rng(0)
    for condition in (1.0, 1e8):
        mixed = modes @ rng.standard_normal((30, 30)) * np.geomspace(1, condition, 30)
        twice = np.hstack([mixed, mixed[:, :7] @ rng.standard_normal((7, 4))])
        values, vectors, rank = ritz_pairs(L, mass, twice, 30)
        assert rank == 30
        assert host.gram(mass, vectors) == pytest.approx(np.eye(30), abs=1e-11)
        expected = sk.eigensolve(bumpy_laplacian, 30).eigenvalues
        assert values == pytest.approx(expected, rel=1e-9, abs=1e-12 * expected[-1])
    assert ritz_rotation(L, mass, vectors)[0] == pytest.approx(values, rel=1e-10, abs=1e-10)
    with pytest.raises(
        sk.InvalidInputError, match="at least k = 31 dimensions, got numerical rank"
    ):
        ritz_pairs(L, mass, twice, 31, least=31)


def test_residuals_compiled_and_not(animal, animal_spectrum) -> None:
    """Both ways give the norms, and R is rounded to float32 only."""
    moved = animal_spectrum.eigenvectors + 0.01 * np.roll(animal_spectrum.eigenvectors, 1, axis=1)
    arguments = animal.stiffness, animal.mass, animal_spectrum.eigenvalues, moved
    R, norms = residuals(*arguments)
    expected = animal.stiffness @ moved - animal.mass[:, None] * moved * animal_spectrum.eigenvalues
    assert np.abs(R - expected).max() <= 1e-7 * np.abs(expected).max()
    plain = np.sqrt((expected**2 / animal.mass[:, None]).sum(axis=0))
    assert norms == pytest.approx(plain, rel=1e-10)
    again, along = residual_norms(*arguments)
    assert again == pytest.approx(plain, rel=1e-10)
    assert along == pytest.approx((moved * expected).sum(axis=0), rel=1e-10, abs=1e-10)
