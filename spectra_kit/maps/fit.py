"""`fit_functional_map`: the functional map that descriptors and operators ask for, exactly.

It minimises an energy whose terms are made dimensionless: each is divided by its mean over random
maps, matrices C of independent entries with the norm of an isometry, ``E |C_ij|^2 = min(k1, k2) /
(k1 k2)``. So a weight of 1 makes "as bad as random" count 1, whatever the units, the size of the
map and the number of descriptors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_indices, check_weights, real_array
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import ConvergenceError, InvalidInputError
from spectra_kit.maps.convert import at_unit_area, check_components, check_sizes
from spectra_kit.operators.oriented import OrientedTriangles, orientation_operator

_RIDGE = 1e-12  # of |C|^2, where all else is of order 1: decides what nothing else does
_VOID = 1e-12  # relative: operators that commute with every map, but for rounding
_DROPPED = 1e-10  # share of the descriptors' energy below which a combination of them is left out
_DENSE = 2500  # unknowns up to which one Cholesky factor is quicker than conjugate gradients
_RTOL = 1e-10  # of the residual, in the norm of the preconditioner
_MAX_STEPS = 5000

Landmarks = tuple[ArrayLike, ArrayLike]
Mask = Literal["resolvent", "standard"]


@checked
@dataclass(frozen=True, kw_only=True)
class FitWeights:
    """Weights of the terms of `fit_functional_map` beside the descriptors, which have 1.

    Parameters
    ----------
    commutativity : float, default 1.0
        With the Laplacians, ``|C Lambda_1 - Lambda_2 C|^2``, masked.
    multiplication : float, default 1.0
        With multiplication by each descriptor; 0 leaves it out.
    orientation : float, default 0.0
        With the orientation operator of each descriptor, which only maps that keep the orientation
        do; 0 leaves it out.
    landmarks : float, default 1.0
        Of carrying the delta function of each landmark to that of the other.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> sk.maps.FitWeights(orientation=1.0).multiplication
    1.0
    """

    commutativity: float = 1.0
    multiplication: float = 1.0
    orientation: float = 0.0
    landmarks: float = 1.0

    def __post_init__(self) -> None:
        check_weights(vars(self))


@checked
def fit_functional_map(
    source: Spectrum,
    target: Spectrum,
    source_descriptors: ArrayLike,
    target_descriptors: ArrayLike,
    *,
    k: int | tuple[int, int] = 30,
    mask: Mask = "resolvent",
    weights: FitWeights = FitWeights(),
    oriented: tuple[OrientedTriangles, OrientedTriangles] | None = None,
    mirrored: bool = False,
    landmarks: Landmarks | None = None,
) -> Floats:
    """Fit a functional map to descriptors that two surfaces have in common.

    Parameters
    ----------
    source, target : Spectrum
        Of the two surfaces, in any units, of as many components.
    source_descriptors, target_descriptors : array_like of shape (n1, p) and (n2, p)
        Functions that correspond, column by column, in one unit. What is constant in them does not
        matter. They weigh as they are: where columns should count alike, or the surfaces are in
        different units, pass them through `features.normalize_descriptors` first.
    k : int or (int, int), default 30
        Size of the map, or (source's, target's).
    mask : {"resolvent", "standard"}, default "resolvent"
        Commute with the resolvent of the Laplacian's square root, or with the Laplacian itself,
        which punishes the high modes most.
    weights : FitWeights
        Of all that counts beside the descriptors.
    oriented : (OrientedTriangles, OrientedTriangles), optional
        Of the source and of the target; needed for a positive weight of the orientation.
    mirrored : bool, default False
        Ask for a map that turns the orientation round instead, as between left and right.
    landmarks : (array_like of shape (l,), array_like of shape (l,)), optional
        Points of the source and the points of the target that correspond to them.

    Returns
    -------
    ndarray of shape (k2, k1)
        Between the surfaces at unit area. Constants go to constants exactly.

    Raises
    ------
    ConvergenceError
        If a large fit with operators is too badly conditioned for conjugate gradients.

    Notes
    -----
    Minimises, with A and B the coefficients of the descriptors, and each sum divided by its mean
    over random maps of the norm of an isometry, so that the weights have no unit::

                         |C A - B|^2
        + commutativity  sum_ij mask_ij C_ij^2
        + multiplication sum_p |C U1^T M1 diag(f_p) U1  -  U2^T M2 diag(g_p) U2 C|^2
        + orientation    sum_p |C O1(f_p)  -+  O2(g_p) C|^2,    O(f)_ij = integral of u_i df ^ du_j

    (Ovsjanikov et al. 2012; Nogneng and Ovsjanikov, *Informative Descriptor Preservation*, 2017;
    Ren et al. 2018 for the orientation, 2019 for the resolvent.) The energy is quadratic: the
    normal equations are solved by Cholesky factors, or above 2500 unknowns with operators by
    conjugate gradients to a relative residual of 1e-10. What no term decides, such as the sign of
    odd functions on a symmetric surface without an orientation term, is 0: the energy holds
    ``1e-12 |C|^2`` besides. The operators of descriptors count where both surfaces have modes, in
    the first ``min(k1, k2)`` rows and columns: a rectangular cut of the true map does not commute
    with them beyond.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> mesh = sk.geometry.creature(800)
    >>> spectrum, f = sk.spectrum(mesh, 20), np.sin(3 * mesh.points)
    >>> copy = sk.spectrum(mesh.with_points(1000 * mesh.points), 20)
    >>> C = sk.maps.fit_functional_map(spectrum, copy, f, f, k=20)
    >>> bool(np.allclose(np.abs(C), np.eye(20), atol=1e-5))
    True
    """
    k1, k2 = check_sizes(k, source, target)
    check_components(source, target)
    source, target = at_unit_area(source), at_unit_area(target)
    f = _descriptors("source_descriptors", source_descriptors, source)
    g = _descriptors("target_descriptors", target_descriptors, target)
    if f.shape[1] != g.shape[1]:
        raise InvalidInputError(
            "`source_descriptors` and `target_descriptors` must have the same number of columns,"
            f" got {f.shape[1]} and {g.shape[1]}"
        )
    one, other = source.truncate(k1), target.truncate(k2)
    constants = one.project(np.ones(source.n)), other.project(np.ones(target.n))
    terms = [preserved("descriptors", one.project(f), other.project(g), constants, 1.0)]
    if landmarks is not None:
        here, there = check_landmarks(landmarks, source.n, target.n)
        deltas = one.eigenvectors[here].T, other.eigenvectors[there].T
        terms.append(preserved("landmarks", *deltas, constants, weights.landmarks))
    operators = []
    if weights.multiplication or weights.orientation:
        f, g = few_combinations(source, target, f, g)
    if weights.multiplication:
        pair = multiplication_operators(one, k1, f), multiplication_operators(other, k2, g)
        operators.append(commuting("multiplication", *pair, weights.multiplication))
    if weights.orientation:
        first, second = _checked_triangles(oriented, source.n, target.n)
        pair = (
            orientation_operator(first, one.eigenvectors, f),
            orientation_operator(second, other.eigenvectors, g) * (-1 if mirrored else 1),
        )
        operators.append(commuting("orientation", *pair, weights.orientation))
    masked = laplacian_mask(mask, one.eigenvalues, other.eigenvalues)
    return minimise(weights.commutativity * masked + _RIDGE, terms, operators, constants)


def _descriptors(name: str, values: ArrayLike, spectrum: Spectrum) -> Floats:
    """Return `values` less their averages: multiplication by a constant commutes with any map."""
    f = real_array(name, values)
    if f.ndim != 2 or len(f) != spectrum.n or f.shape[1] == 0:
        raise InvalidInputError(
            name,
            f"have shape ({spectrum.n}, p), p >= 1 functions on the points of the spectrum",
            f.shape,
        )
    varying = f - spectrum.mass @ f / spectrum.area
    # A constant that rounding has left some noise of is still a constant.
    varying[:, spectrum.mass @ varying**2 <= 1e-24 * (spectrum.mass @ f**2)] = 0.0
    return np.asarray(varying)


def check_landmarks(
    landmarks: Landmarks, n_source: int, n_target: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the landmarks as checked indices of the source and of the target."""
    if not isinstance(landmarks, tuple) or len(landmarks) != 2:
        raise InvalidInputError(
            "landmarks",
            "be a pair (points of the source, points of the target), as a tuple",
            type(landmarks).__name__,
        )
    shapes = np.shape(landmarks[0]), np.shape(landmarks[1])
    if shapes[0] != shapes[1] or len(shapes[0]) != 1 or shapes[0] == (0,):
        raise InvalidInputError(
            "landmarks",
            "be two lists of one length, at least 1",
            f"shapes {shapes[0]} and {shapes[1]}",
            advice="pass None for no landmarks",
        )
    here = check_indices("landmarks of the source", landmarks[0], n_source)
    there = check_indices("landmarks of the target", landmarks[1], n_target)
    return here, there


def _checked_triangles(
    oriented: tuple[OrientedTriangles, OrientedTriangles] | None, n_source: int, n_target: int
) -> tuple[OrientedTriangles, OrientedTriangles]:
    if oriented is None:
        raise InvalidInputError(
            "oriented",
            "be given where the weight of the orientation is positive",
            "None",
            advice="pass oriented_triangles of both geometries",
        )
    if (counts := (oriented[0].n, oriented[1].n)) != (n_source, n_target):
        expected = f"be on the {n_source} and {n_target} points of the spectra"
        raise InvalidInputError("oriented", expected, f"{counts[0]} and {counts[1]}")
    return oriented


# --- the energy -----------------------------------------------------------------------------


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
    gram = a.T @ source._weighed(a) + b.T @ target._weighed(b)
    energy, axes = np.linalg.eigh(gram)
    axes = axes[:, energy > _DROPPED * energy[-1]]
    return a @ axes, b @ axes


def multiplication_operators(spectrum: Spectrum, k: int, functions: Floats) -> Floats:
    """Return ``U^T M diag(f) U`` of the first `k` modes for each column f: (p, k, k)."""
    U = spectrum.eigenvectors[:, :k]
    weighted = spectrum._weighed(U)
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
