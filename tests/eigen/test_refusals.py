"""What solvers refuse: one table of calls, with the argument and what it must be."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

import spectra_kit as sk
from spectra_kit._sparse.ritz import ritz_rotation
from spectra_kit.errors import InvalidInputError, WeightsError
from spectra_kit.geometry import creature, sphere

BALL = sk.robust_laplacian(sphere(subdivisions=3).geometry)
SMALL = sk.robust_laplacian(sphere(subdivisions=1).geometry)
FEW = sk.eigen.subspaces.AmbientFourier(m=20)


def solve(solver: object, k: object = 40, laplacian: sk.Laplacian = BALL) -> sk.Spectrum:
    return sk.eigensolve(laplacian, k, solver)  # type: ignore[arg-type]


def constant(points, mass):
    return np.ones((len(points), 30))


def nan(points, mass):
    return np.full((len(points), 60), np.nan)


def flat(points, mass):
    return np.ones(len(points))


def sunk() -> sk.Laplacian:
    """Half the diagonal: still positive there, no longer semi-definite."""
    lower = BALL.stiffness - sparse.diags_array(0.5 * BALL.stiffness.diagonal())
    return sk.Laplacian(lower, BALL.mass, BALL.points)


TABLE = [
    (lambda: solve(sk.Dense(), 0), "k", "be at least 1"),
    (lambda: solve(sk.Dense(), 43, SMALL), "k", "be at most the number of free points, 42"),
    (
        lambda: solve(sk.Dense(), 3, SMALL.dirichlet(range(40))),
        "k",
        "be at most the number of free points, 2",
    ),
    (lambda: solve(sk.Dense(max_points=600)), "laplacian", "have at most 600 points for Dense"),
    (
        lambda: solve(sk.Arpack(), 7000, sk.robust_laplacian(creature(20_500, seed=0))),
        "k",
        "be less than a third of the 20498 points",
    ),
    (lambda: solve(sk.Arpack(), 4, sunk()), "stiffness", "be positive semi-definite"),
    (lambda: sk.verify(solve(sk.Arpack(), 4), SMALL), "laplacian", "live on the 642 points"),
    # Hyper-parameters.
    (lambda: sk.Arpack(shift=0), "shift", "be positive"),
    (lambda: sk.Arpack(tol=-1), "tol", "be in [0, 1)"),
    (lambda: sk.Arpack(max_restarts=0), "max_restarts", "be at least 1"),
    (lambda: sk.Lanczos(max_shifts=0), "max_shifts", "be at least 1"),
    (lambda: sk.Dense(max_points=0), "max_points", "be at least 1"),
    (lambda: sk.Refined(seed=-1), "seed", "be at least 0"),
    (lambda: sk.RayleighRitz(rank_tol=0), "rank_tol", "be positive"),
    (lambda: sk.Refined(rtol=1e-16), "rtol", "be at least 1e-14, the rounding of float64"),
    (lambda: sk.Refined(rtol=1.0), "rtol", "be at least 1e-14"),
    (lambda: sk.Refined(degree=0), "degree", "be at least 1"),
    (lambda: sk.Refined(guard=0.0), "guard", "be positive"),
    (lambda: sk.Refined(max_sweeps=0), "max_sweeps", "be at least 1"),
    (lambda: sk.Cascade(coarsest=1), "coarsest", "be at least 100"),
    (lambda: sk.Cascade(max_steps=-1), "max_steps", "be at least 0"),
    (lambda: sk.Cascade(target=0.0), "target", "be positive"),
    (lambda: sk.Neo(rank_tol=0.0), "rank_tol", "be positive"),
    *(
        (lambda a=accuracy: sk.Automatic(accuracy=a), "accuracy", expected)
        for accuracy, expected in ((0, "be "), (-1e-3, "be "), (1, "be less than 1"))
    ),
    (lambda: sk.Automatic(memory=0), "memory", "be "),
    (lambda: sk.Automatic(seed=-1), "seed", "be "),
    # Subspaces.
    (lambda: sk.eigen.subspaces.AmbientFourier(m=4), "m", "be at least 5"),
    (lambda: sk.eigen.subspaces.AmbientFourier(bandwidth=0.0), "bandwidth", "be positive"),
    (lambda: sk.eigen.subspaces.RandomBasis(m=0), "m", "be at least 1"),
    (lambda: sk.eigen.subspaces.RandomBasis(seed=-1), "seed", "be at least 0"),
    (lambda: sk.eigen.subspaces.Union(), "parts", "hold at least one subspace"),
    (lambda: sk.eigen.subspaces.GivenBasis(np.ones(4)), "columns", "have shape (n, m)"),
    (
        lambda: solve(sk.Refined(start=sk.eigen.subspaces.GivenBasis(np.ones((10, 4))))),
        "columns",
        "have a row for each of 642 points",
    ),
    *(
        (lambda s=solver: solve(s), "subspace", "return a real array of shape")
        for solver in (sk.RayleighRitz(subspace=flat), sk.Cascade(subspace=flat, coarsest=200))
    ),
]


@pytest.mark.parametrize(("call", "argument", "expected"), TABLE)
def test_what_is_refused(call, argument: str, expected: str) -> None:
    with pytest.raises(InvalidInputError) as error:
        call()
    assert error.value.argument == argument
    assert error.value.expected.startswith(expected)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: solve(sk.RayleighRitz(subspace=constant)), "at least k = 40 dim.* rank 1"),
        (lambda: solve(sk.Cascade(subspace=FEW, coarsest=200)), "must span at least k = 40"),
        (lambda: solve(sk.RayleighRitz(subspace=nan)), "`basis` must have finite columns"),
        (lambda: solve(sk.Refined(start=nan)), "`basis` must have finite columns"),
        (
            lambda: ritz_rotation(BALL.stiffness, BALL.mass, np.ones((642, 2))),
            "`X` must have columns that are far from depen",
        ),
        (lambda: solve(sk.Refined(), 4, sunk()), "`stiffness` must be positive semi-definite"),
        (lambda: sk.Neo(device="abacus"), "`device` must be one that torch can use here"),
        (lambda: sk.Refined(sk.Neo()), r"Refined takes its options by name; write .*start="),
    ],
)
def test_what_is_refused_while_it_is_computed(call, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        call()


def test_weights_that_are_not_there() -> None:
    with pytest.raises(WeightsError, match="must be one of"):
        sk.Neo(weights="huge")
