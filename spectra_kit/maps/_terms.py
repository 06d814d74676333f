"""The terms of the energy that `fit_functional_map` minimises, each made dimensionless.

A term is divided by its mean over random maps: matrices C of independent entries with the norm of
an isometry, ``E |C_ij|^2 = min(k1, k2) / (k1 k2)``. So a weight of 1 makes "as bad as random"
count 1, whatever the units, the size of the map and the number of descriptors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from spectra_kit._core.types import Floats
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError

Mask = Literal["resolvent", "standard"]

_VOID = 1e-12  # relative: operators that commute with every map, but for rounding
_DROPPED = 1e-10  # share of the descriptors' energy below which a combination of them is left out


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
