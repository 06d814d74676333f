"""The minimum of a quadratic energy of a functional map, by its normal equations."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from spectra_kit._core.types import Floats
from spectra_kit.errors import ConvergenceError, InvalidInputError
from spectra_kit.maps._terms import Commuting, Preserved

_DENSE = 2500  # unknowns up to which one Cholesky factor is quicker than conjugate gradients
_RTOL = 1e-10  # of the residual, in the norm of the preconditioner
_MAX_STEPS = 5000


def minimise(
    mask: Floats,
    preserved: Sequence[Preserved],
    commuting: Sequence[Commuting],
    constants: tuple[Floats, Floats],
    *,
    dense: int = _DENSE,
) -> Floats:
    """Return the C of shape (k2, k1) of least energy with ``C @ constants[0] = constants[1]``.

    The energy is ``sum mask C^2`` and the other terms; systems with operators of more than `dense`
    unknowns go to conjugate gradients. `constants` are the coefficients of the function 1.
    """
    k2, k1 = mask.shape
    # A reflection of the source's coefficients makes constants the first of them: C = Y Q, and
    # the constraint says what the first column of Y is.
    Q, length = _reflection(constants[0])
    fixed = constants[1] / length
    m = min(k1, k2)
    shared = Q[:, :m] @ Q[:m]  # of the source's coefficients, those below m
    terms = []
    for c in commuting:
        target = c.target.copy()
        target[:, m:] = 0
        terms.append(Commuting(Q @ c.source[:, :, :m] @ Q[:m], target, c.weight))
    gram, linear = np.zeros((k1, k1)), np.zeros((k2, k1))
    for p in preserved:
        a = Q @ p.a
        gram += p.weight * a @ a.T
        linear += p.weight * p.b @ a.T
    # The energy couples the entries of each row by a matrix of their own, ...
    rows = gram + np.einsum("ij,aj,bj->iab", mask, Q, Q, optimize=True)
    for c in terms:
        rows[:m] += c.weight * np.einsum("pij,pkj->ik", c.source, c.source, optimize=True)
    # ... and those of each column by one for all, besides the cross terms of the operators.
    columns = np.zeros((k2, k2))
    for c in terms:
        columns += c.weight * np.einsum("pji,pjk->ik", c.target, c.target, optimize=True)

    def gradient(Y: Floats) -> Floats:
        out = np.einsum("iab,ib->ia", rows, Y, optimize=True) + columns @ Y @ shared
        for c in terms:
            out -= c.weight * _cross(c.target, Y, c.source)
        return np.asarray(out)

    Y = np.zeros((k2, k1))
    Y[:, 0] = fixed
    if k1 == 1:
        return np.asarray(Y @ Q)
    right = (linear - gradient(Y))[:, 1:]
    if terms and right.size <= dense:
        Y[:, 1:] = _dense(rows, columns, shared, terms, right)
    else:
        blocks = rows[:, 1:, 1:] + np.einsum("ii,ab->iab", columns, shared[1:, 1:])

        def apply(X: Floats) -> Floats:
            return gradient(np.pad(X, ((0, 0), (1, 0))))[:, 1:]

        Y[:, 1:] = _conjugate_gradients(apply, blocks, right) if terms else _by_rows(blocks)(right)
    return np.asarray(Y @ Q)


def _reflection(first: Floats) -> tuple[Floats, float]:
    """Return the reflection that takes the first axis to the direction of `first`, and a length."""
    length = float(np.linalg.norm(first))
    v = first / length
    v[0] += 1.0 if v[0] >= 0 else -1.0
    Q = np.eye(len(v)) - 2 * np.outer(v, v) / (v @ v)
    return Q, length if first[0] < 0 else -length


def _cross(left: Floats, Y: Floats, right: Floats) -> Floats:
    """Return ``sum_p left_p^T Y right_p + left_p Y right_p^T``."""
    p, k1 = len(right), Y.shape[1]
    one = np.matmul(left.transpose(0, 2, 1), Y).transpose(1, 0, 2).reshape(-1, p * k1)
    other = np.matmul(left, Y).transpose(1, 0, 2).reshape(-1, p * k1)
    return np.asarray(
        one @ right.reshape(p * k1, k1) + other @ right.transpose(0, 2, 1).reshape(p * k1, k1)
    )


def _dense(
    rows: Floats, columns: Floats, shared: Floats, terms: Sequence[Commuting], right: Floats
) -> Floats:
    """Solve by one Cholesky factor for all free entries, row by row."""
    k2, free = right.shape
    normal = np.zeros((k2, k2, free, free))
    for c in terms:
        p = len(c.source)
        source = c.source[:, 1:, 1:].reshape(p, -1)
        normal -= c.weight * (c.target.reshape(p, -1).T @ source).reshape(normal.shape)
    normal += normal.transpose(1, 0, 3, 2).copy()
    diagonal = np.arange(k2)
    normal[diagonal, diagonal] += rows[:, 1:, 1:]
    normal += columns[:, :, None, None] * shared[1:, 1:]
    matrix = normal.transpose(0, 2, 1, 3).reshape(right.size, right.size)
    return np.asarray(cho_solve(_factor(matrix), right.ravel()).reshape(right.shape))


def _factor(matrix: Floats) -> tuple[Floats, bool]:
    try:
        return cho_factor(matrix, lower=True)  # type: ignore[no-any-return]
    except LinAlgError as error:
        raise InvalidInputError(
            "weights",
            "leave the fit well conditioned",
            "a singular system",
            advice="bring them nearer to each other",
        ) from error


def _by_rows(blocks: Floats) -> Callable[[Floats], Floats]:
    factors = [_factor(block) for block in blocks]

    def solve(right: Floats) -> Floats:
        return np.stack([cho_solve(f, r) for f, r in zip(factors, right, strict=True)])

    return solve


def _conjugate_gradients(
    apply: Callable[[Floats], Floats], blocks: Floats, right: Floats
) -> Floats:
    """Solve ``apply(X) = right``, preconditioned by the rows."""
    precondition = _by_rows(blocks)
    X, R = np.zeros_like(right), right
    Z = precondition(R)
    D, square = Z, float(np.vdot(R, Z))
    goal = _RTOL**2 * square
    for _ in range(_MAX_STEPS):
        if square <= goal:
            return X
        W = apply(D)
        step = square / float(np.vdot(D, W))
        X, R = X + step * D, R - step * W
        Z = precondition(R)
        previous, square = square, float(np.vdot(R, Z))
        D = Z + square / previous * D
    raise ConvergenceError(
        f"the fit must reach a relative residual of {_RTOL:g}, got"
        f" {(square / goal) ** 0.5 * _RTOL:.1e} after {_MAX_STEPS} steps; raise `commutativity`"
    )
