"""Bases and factors against LAPACK; and what all solvers owe to what they are given."""

import numpy as np
import pytest
from conftest import refused
from one_system import path
from scipy import sparse

from spectra_kit._sparse import (
    AdditiveTwoLevel,
    CoarseSpace,
    ConstantKernel,
    GroundedCholesky,
    IncompleteCholesky,
    ProjectedTwoLevel,
    SparseLDL,
    orthonormalize,
    pcg,
    spmm,
)

N, M = 1000, 40


def graded(condition: float) -> tuple[np.ndarray, np.ndarray]:
    """Columns whose M-singular values fall from 1 to 1 / condition, and a mass."""
    rng = np.random.default_rng(0)
    mass = rng.uniform(0.1, 2.0, N)
    left = np.linalg.qr(rng.standard_normal((N, M)))[0]
    right = np.linalg.qr(rng.standard_normal((M, M)))[0]
    singular = np.geomspace(1, 1 / condition, M)
    return (left * singular) @ right / np.sqrt(mass)[:, None], mass


@pytest.mark.parametrize(("condition", "unit"), [(1, 1.0), (1e8, 1.0), (1e6, 1e-20)])
def test_orthonormalize_keeps_the_whole_span(condition: float, unit: float) -> None:
    basis, mass = graded(condition)
    basis, mass = unit * basis, np.sqrt(unit) * mass
    Y = orthonormalize(basis, mass)
    assert Y.shape == (N, M)
    assert np.abs(Y.T @ (mass[:, None] * Y) - np.eye(M)).max() < 1e-12
    outside = basis - Y @ (Y.T @ (mass[:, None] * basis))
    assert np.linalg.norm(outside) < 1e-13 * np.linalg.norm(basis)


@pytest.mark.parametrize("rank_tol", [1e-4, 1e-12])
def test_rank_cut_means_what_it_says(rank_tol: float) -> None:
    basis, mass = graded(1e15)
    scaled = np.sqrt(mass)[:, None] * basis
    singular = np.linalg.svd(scaled / np.linalg.norm(scaled, axis=0), compute_uv=False)
    # LAPACK's rounding blurs values within a factor of two of the cut.
    low, high = ((singular > f * rank_tol * singular[0]).sum() for f in (2, 0.5))
    assert low <= orthonormalize(basis, mass, rank_tol=rank_tol).shape[1] <= high


def test_dependent_and_zero_columns_are_dropped_and_bad_ones_refused() -> None:
    rng = np.random.default_rng(1)
    basis = rng.standard_normal((N, 7)) @ rng.standard_normal((7, 20))
    basis[:, 3] = 0
    assert orthonormalize(basis, np.ones(N)).shape == (N, 7)
    for bad in (np.nan, np.inf, 0.0):
        refused("basis", "have finite columns", orthonormalize, np.full((9, 2), bad), np.ones(9))


def test_elimination_solves_like_lu() -> None:
    rng = np.random.default_rng(2)
    A = sparse.random_array((400, 400), density=0.02, rng=rng)
    A = sparse.csr_array(A @ A.T + sparse.eye_array(400))
    b = rng.standard_normal((400, 5))
    x = SparseLDL(A).solve(b)
    assert x == pytest.approx(np.linalg.solve(A.toarray(), b), rel=1e-9, abs=1e-12)
    assert SparseLDL(A).solve(b[:, 0]) == pytest.approx(x[:, 0], rel=1e-12)


def test_nothing_that_is_given_is_written_to() -> None:
    """Neither matrices nor right-hand sides nor starts; read-only ones are taken as well."""
    n, rng = 60, np.random.default_rng(0)
    A, kernel = path(n), ConstantKernel(np.zeros(n, int))
    held = sparse.csr_array(A + sparse.eye_array(n))
    b, start = kernel.remove(rng.standard_normal(n)), rng.standard_normal(n)
    Y, mass = rng.standard_normal((n, 5)), rng.uniform(1, 2, n)
    given = [A.data, A.indices, A.indptr, held.data, held.indices, held.indptr, b, start, Y, mass]
    before = [array.copy() for array in given]
    base, coarse = IncompleteCholesky(held), CoarseSpace(Y, matrix=held, dtype=np.float64)
    additive, projected = AdditiveTwoLevel(base, coarse), ProjectedTwoLevel(base, coarse, held)
    solvers = [
        lambda: pcg(A, b, start=start, kernel=kernel).x,
        lambda: pcg(held, b, start=start).x,
        lambda: pcg(held, b, start=start, preconditioner=additive).x,
        lambda: pcg(held, b, start=start, preconditioner=projected).x,
        lambda: GroundedCholesky(A, kernel).solve(b),
        lambda: SparseLDL(held).solve(b),
        lambda: SparseLDL(held).solve(Y),
        lambda: IncompleteCholesky(held, drop=0.01, relaxation=0.5).solve(b),
        lambda: coarse.solve(b),
        lambda: additive.solve(b),
        lambda: projected.solve(b),
        lambda: spmm(held, Y),
        lambda: orthonormalize(Y, mass),
    ]
    found = [solve() for solve in solvers]
    for array, old in zip(given, before, strict=True):
        np.testing.assert_array_equal(array, old)
        array.flags.writeable = False
    for solve, first in zip(solvers, found, strict=True):
        np.testing.assert_array_equal(solve(), first)
        assert not any(np.shares_memory(first, array) for array in given)
