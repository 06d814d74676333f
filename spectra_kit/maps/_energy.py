"""The energy that `fit_functional_map` minimises: its terms, made dimensionless, and its minimum.

A term is divided by its mean over random maps: matrices C of independent entries with the norm of
an isometry, ``E |C_ij|^2 = min(k1, k2) / (k1 k2)``. So a weight of 1 makes "as bad as random"
count 1, whatever the units, the size of the map and the number of descriptors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from spectra_kit._core.types import Floats
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import ConvergenceError, InvalidInputError

Mask = Literal["resolvent", "standard"]

_VOID = 1e-12  # relative: operators that commute with every map, but for rounding
_DROPPED = 1e-10  # share of the descriptors' energy below which a combination of them is left out
_DENSE = 2500  # unknowns up to which one Cholesky factor is quicker than conjugate gradients
_RTOL = 1e-10  # of the residual, in the norm of the preconditioner
_MAX_STEPS = 5000


@dataclass(frozen=True, eq=False)
class Preserved:
    """The term ``weight * |C a - b|^2``."""

    a: Floats  # (k1, p)
    b: Floats  # (k2, p)
    weight: float


@dataclass(frozen=True, eq=False)
class Commuting:
    """The term ``weight * sum_p |C source_p - target_p C|^2``, its first m rows and columns.

    m is the smaller of k1 and k2. Beyond m one side has modes that the other lacks, and the
    truncated operators do not commute with the true map.
    """

    source: Floats  # (p, k1, k1)
    target: Floats  # (p, k2, k2)
    weight: float


def laplacian_mask(kind: Mask, source: Floats, target: Floats) -> Floats:
    """Return the (k2, k1) weights of C_ij^2 in the commutativity with the Laplacian.

    ``standard``: ``(lambda_j - mu_i)^2``. ``resolvent``: the same for ``1 / (lambda^(1/2) - i)``
    with the larger of both last eigenvalues as unit, which stays bounded as the maps grow (Ren,
    Panine, Wonka and Ovsjanikov, *Structured Regularization of Functional Map Computations*, SGP
    2019).
    """
    unit = max(source[-1], target[-1])
    if unit == 0:  # constants alone
        return np.zeros((len(target), len(source)))
    if kind == "standard":
        difference = np.subtract.outer(target, source) / unit
    else:
        difference = np.subtract.outer(*(1 / (np.sqrt(x / unit) - 1j) for x in (target, source)))
    mask = np.abs(difference) ** 2
    return np.asarray(mask / (min(mask.shape) * mask.mean()))


def preserved(
    name: str, a: Floats, b: Floats, constants: tuple[Floats, Floats], weight: float
) -> Preserved:
    """Return the term that asks for C a = b; constants, which every map preserves, do not count."""
    (k1, _), (k2, _) = a.shape, b.shape
    size = sum(
        share * (np.sum(x**2) - np.sum((unit @ x) ** 2))
        for share, x, unit in ((min(k1, k2) / k1, a, constants[0]), (1.0, b, constants[1]))
    )
    if size <= _VOID * (np.sum(a**2) + np.sum(b**2)):
        raise InvalidInputError(
            f"`{name}` must not all be constant on the modes of the map, or nothing tells one point"
            " from another; pass others, or a larger `k`"
        )
    return Preserved(a, b, weight / size)


def commuting(name: str, source: Floats, target: Floats, weight: float) -> Commuting:
    """Return the term that asks for C source = target C."""
    m, k = sorted((source.shape[1], target.shape[1]))
    size = np.sum(source[:, :, :m] ** 2) + np.sum(target[:, :m] ** 2)
    trace = np.einsum("pii->p", source[:, :m, :m]) @ np.einsum("pii->p", target[:, :m, :m])
    mean = (size - 2 * trace / m) * m / k
    if mean <= _VOID * size or size == 0:
        raise InvalidInputError(
            f"`{name}` must be 0 where all descriptors are constant: their operators commute with"
            f" every map; got a weight of {weight:g}"
        )
    return Commuting(source, target, weight / mean)


def few_combinations(
    source: Spectrum, target: Spectrum, a: Floats, b: Floats
) -> tuple[Floats, Floats]:
    """Return fewer descriptors that make the same sums over pairs of operators.

    The sums do not change if the same rotation mixes the columns of both sides. Principal axes
    leave most columns of smooth descriptors (near) zero.
    """
    gram = a.T @ (source.mass[:, None] * a) + b.T @ (target.mass[:, None] * b)
    energy, axes = np.linalg.eigh(gram)
    axes = axes[:, energy > _DROPPED * energy[-1]]
    return a @ axes, b @ axes


def multiplication_operators(spectrum: Spectrum, k: int, functions: Floats) -> Floats:
    """Return ``U^T M diag(f) U`` of the first `k` modes for each column f: (p, k, k)."""
    U = spectrum.eigenvectors[:, :k]
    weighted = spectrum.mass[:, None] * U
    return np.stack([weighted.T @ (f[:, None] * U) for f in functions.T])


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
