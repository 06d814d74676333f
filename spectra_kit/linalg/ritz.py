"""Rayleigh-Ritz: the best eigenpairs inside the span of given columns."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import eigh

from spectra_kit._types import Floats
from spectra_kit.errors import InvalidInputError
from spectra_kit.linalg.orthonormal import RankError, orthonormalize
from spectra_kit.linalg.threads import in_threads, ranges, single_threaded_blas

_ROWS = 4_096  # of one task: in the cache, and fixed, so that no sum depends on the threads
_WELL_CONDITIONED = 1e-12  # of the Gram matrix: above it, one float64 Gram matrix tells all
_WELL_SPREAD = 1e-3  # lowest eigenvalue of a scaled Gram matrix that needs no second round
_ROUNDING = 1e-11  # deviation from M-orthonormality that is not worth a correction


class RitzPairs(NamedTuple):
    """The lowest eigenpairs inside a subspace, M-orthonormal, and the rank of the basis."""

    eigenvalues: Floats
    eigenvectors: Floats
    rank: int


@single_threaded_blas()
def ritz_pairs(
    stiffness: sparse.csr_array,
    mass: Floats,
    basis: NDArray[np.floating],
    k: int,
    *,
    least: int = 0,
    rank_tol: float = 1e-10,
) -> RitzPairs:
    """Return the k lowest Ritz pairs of ``L u = lambda M u`` in the span of `basis`.

    Or as many as it has dimensions; fewer than `least` are refused. Its columns are of any scale,
    and may be dependent; see `orthonormalize` for `rank_tol`. The long side of the basis is read
    three times: for the Gram matrix ``Y^T M Y``, for ``Y^T L Y``, and to lift the k wanted vectors.
    Where rounding of the first left these short of orthonormal, their own k x k problem takes it
    out. Only a badly conditioned basis, of which more is wanted than one Gram matrix resolves
    (`rank_tol` below 1e-6), is orthonormalised first.
    """
    Y = np.ascontiguousarray(basis, dtype=np.float64)
    gram = weighted_gram(Y, mass)
    scale = np.sqrt(np.diag(gram))
    if not np.isfinite(scale).all() or not scale.all():
        Y = orthonormalize(Y[:, scale != 0], mass, rank_tol=rank_tol)  # says what is wrong with it
        whitener = np.eye(Y.shape[1])
    else:
        values, vectors = np.linalg.eigh(gram / scale / scale[:, None])
        kept = values > max(_WELL_CONDITIONED, rank_tol**2) * values[-1]
        if kept.all() or rank_tol**2 >= _WELL_CONDITIONED:
            whitener = vectors[:, kept] / np.sqrt(values[kept]) / scale[:, None]
        else:  # directions that matter drown in the rounding of this Gram matrix
            Y = orthonormalize(Y, mass, rank_tol=rank_tol)
            whitener = np.eye(Y.shape[1])
    rank = whitener.shape[1]
    if rank < least:
        raise RankError(
            f"`basis` must span at least k = {least} dimensions, got numerical rank {rank} of"
            f" {basis.shape[1]} columns; ask for fewer modes or use a larger basis",
            rank,
        )
    k = min(k, rank)
    inside, rotation = np.linalg.eigh(whitener.T @ projected(stiffness, Y) @ whitener)
    U = lifted(Y, whitener @ rotation[:, :k])
    error = np.abs(weighted_gram(U, mass) - np.eye(k)).max()
    if error > _ROUNDING:
        return RitzPairs(*ritz_rotation(stiffness, mass, U), rank)
    return RitzPairs(inside[:k], U, rank)


@single_threaded_blas()
def ritz_rotation(stiffness: sparse.csr_array, mass: Floats, X: Floats) -> tuple[Floats, Floats]:
    """Return all Ritz pairs in the span of columns that are far from dependent.

    Such as M-orthonormal ones that were corrected a little; dependent ones are refused.
    """
    for _ in range(2):  # rounding in a Gram matrix grows by the inverse of its lowest eigenvalue
        inside, gram = projected(stiffness, X), weighted_gram(X, mass)
        scale = np.sqrt(np.diag(gram))
        try:
            values, rotation = eigh(inside, gram)
            lowest = np.linalg.eigvalsh(gram / scale / scale[:, None]).min(initial=1.0)
        except np.linalg.LinAlgError as error:
            raise InvalidInputError(
                "X",
                "have columns that are far from dependent",
                f"{X.shape[1]} with a Gram matrix that is not positive definite ({error})",
                advice="use `ritz_pairs`",
            ) from error
        X = lifted(X, rotation)
        if lowest > _WELL_SPREAD:
            break
    return values, X


def weighted_gram(Y: Floats, mass: Floats) -> Floats:
    """Return ``Y^T M Y``."""

    def part(rows: slice) -> Floats:
        weighted = np.sqrt(mass[rows, None]) * Y[rows]
        return np.asarray(weighted.T @ weighted)

    return _sum_of(part, len(Y))


def projected(stiffness: sparse.csr_array, Y: Floats) -> Floats:
    """Return ``Y^T L Y``, symmetric."""
    inside = _sum_of(lambda rows: Y[rows].T @ (stiffness[rows] @ Y), len(Y))
    return (inside + inside.T) / 2


def lifted(Y: Floats, rotation: Floats) -> Floats:
    """Return ``Y @ rotation``."""
    U = np.empty((len(Y), rotation.shape[1]))

    def fill(rows: slice) -> None:
        np.matmul(Y[rows], rotation, out=U[rows])

    in_threads(fill, ((slice(*rows),) for rows in ranges(len(Y), _ROWS)))
    return U


def _sum_of(part: Callable[[slice], Floats], n: int) -> Floats:
    """Return the sum of `part` over blocks of n rows, the same bits on any number of threads."""
    with single_threaded_blas():
        parts = in_threads(part, ((slice(*rows),) for rows in ranges(n, _ROWS)))
    total: Floats = parts[0].copy()
    for other in parts[1:]:
        total += other
    return total
