"""Coarse spaces: exact on their span, the same for every basis of it."""

import numpy as np
import pytest
from conftest import refused
from scipy import sparse

from spectra_kit import InvalidInputError
from spectra_kit._sparse import (
    AdditiveTwoLevel,
    CoarseSpace,
    ProjectedTwoLevel,
    pcg,
)

RNG = np.random.default_rng(0)


def test_it_solves_exactly_within_its_span(body):
    coefficients = RNG.standard_normal(16)
    x = body.Y @ coefficients
    for options in ({"energies": body.energies}, {"matrix": body.A}):
        coarse = CoarseSpace(body.Y, dtype=np.float64, **options)
        np.testing.assert_allclose(coarse.solve(body.A @ x), x, atol=1e-8)
        assert coarse.dimension == 16
    single = CoarseSpace(body.Y, energies=body.energies)
    np.testing.assert_allclose(single.solve(body.A @ x), x, atol=1e-5 * np.abs(x).max())


def test_a_general_basis_of_the_same_span_gives_the_same_iterates(body):
    mixed = body.Y @ RNG.standard_normal((16, 16)) * np.geomspace(1e-6, 1e6, 16)
    runs = []
    for coarse in (
        CoarseSpace(body.Y, energies=body.energies, dtype=np.float64),
        CoarseSpace(mixed, matrix=body.A, dtype=np.float64),
    ):
        both = AdditiveTwoLevel(body.factor, coarse)
        start = coarse.solve(body.b)
        np.testing.assert_allclose(both.solve(body.b), body.factor.solve(body.b) + start)
        runs.append(pcg(body.A, body.b, preconditioner=both, start=start, kernel=body.kernel))
    diagonal, general = runs
    assert diagonal.iterations == general.iterations
    np.testing.assert_allclose(general.residual_norms, diagonal.residual_norms, rtol=1e-5)
    np.testing.assert_allclose(general.x, diagonal.x, atol=1e-7)


def test_dependent_columns_and_the_kernel_are_dropped(body):
    doubled = np.hstack([body.Y, 3 * body.Y[:, :5], np.ones((body.n, 1)), np.zeros((body.n, 1))])
    mixed = body.all_modes @ RNG.standard_normal((17, 17))  # the constant is in all of them
    plain = CoarseSpace(body.Y, energies=body.energies, dtype=np.float64)
    expected = body.kernel.remove(plain.solve(body.b))
    for basis in (doubled, mixed):
        for dtype, tolerance in ((np.float32, 1e-4), (np.float64, 1e-7)):
            coarse = CoarseSpace(basis, matrix=body.A, dtype=dtype)
            assert coarse.dimension == 16
            found = body.kernel.remove(coarse.solve(body.b))
            np.testing.assert_allclose(found, expected, atol=tolerance * np.abs(found).max())


def test_galerkin_energies_of_a_space_that_is_not_invariant(body):
    basis = RNG.standard_normal((body.n, 6))
    coarse = CoarseSpace(basis, matrix=body.A, dtype=np.float64)
    x = coarse.solve(body.b)
    np.testing.assert_allclose(basis.T @ (body.b - body.A @ x), 0, atol=1e-10)


def test_projection_never_sees_an_invariant_subspace(body):
    # Residuals have no component in it, and its eigenvalues may be anything.
    coarse = CoarseSpace(body.Y, energies=body.energies, dtype=np.float64)
    seen = []

    class Watched(ProjectedTwoLevel):
        def solve(self, rhs):
            seen.append(np.abs(body.Y.T @ rhs).max() / np.linalg.norm(rhs))
            return super().solve(rhs)

    projected = Watched(body.factor, coarse, body.A)
    first = pcg(body.A, body.b, preconditioner=projected, kernel=body.kernel, rtol=1e-6)
    assert max(seen) < 1e-9

    stiffer = np.linspace(2, 3, 16) * body.energies  # added to A on the modes alone
    weighted = body.laplacian.mass[:, None] * body.Y
    A = sparse.csr_array(body.A.toarray() + (weighted * stiffer) @ weighted.T)
    coarse = CoarseSpace(body.Y, energies=body.energies + stiffer, dtype=np.float64)
    projected = ProjectedTwoLevel(body.factor, coarse, A)
    second = pcg(A, body.b, preconditioner=projected, kernel=body.kernel, rtol=1e-6)
    assert second.iterations == first.iterations


def test_projection_forgives_an_inexact_inverse(body):
    # Energies wrong by 5 % would ruin plain deflation.
    right, wrong = (
        pcg(
            body.A,
            body.b,
            preconditioner=ProjectedTwoLevel(
                body.factor, CoarseSpace(body.Y, energies=energies), body.A
            ),
            kernel=body.kernel,
        ).iterations
        for energies in (body.energies, body.energies * RNG.uniform(0.95, 1.05, 16))
    )
    assert wrong <= right + 8


def test_what_is_refused(body):
    Y, energies, A = body.Y, body.energies, body.A
    eye = sparse.eye_array(3, format="csr")
    for argument, expected, basis, options in (
        ("energies", "be positive", Y, {"energies": 0 * energies}),
        ("energies", "have shape (16,)", Y, {"energies": energies[:3]}),
        ("basis", "have shape (n,", Y.T, {"energies": energies}),
        ("basis", "be finite", np.where(Y > 0, np.inf, Y), {"energies": energies}),
        ("matrix", "have shape (600,", Y, {"matrix": eye}),
        ("basis", "not lie in", np.ones((body.n, 2)), {"matrix": A}),
        ("dtype", "be float32 or", Y, {"energies": energies, "dtype": np.int32}),
    ):
        refused(argument, expected, CoarseSpace, basis, **options)
    refused("rhs", "have shape (600,)", CoarseSpace(Y, energies=energies).solve, body.b[:5])
    for call, message in (
        (lambda: CoarseSpace(Y), "must be given, got neither"),
        (lambda: CoarseSpace(Y, energies=energies, matrix=A), "must be given, got both"),
    ):
        with pytest.raises(InvalidInputError, match=message):
            call()
