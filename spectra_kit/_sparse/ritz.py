"""Rayleigh-Ritz: the best eigenpairs inside the span of given columns, on the host or a device."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import eigh
from scipy.linalg.lapack import dpotrf, dtrtri

from spectra_kit._core.threads import single_threaded_blas
from spectra_kit._core.types import Floats
from spectra_kit._sparse.blocks import operations
from spectra_kit._sparse.orthonormal import RankError, orthonormalize
from spectra_kit.errors import InvalidInputError

_WELL_CONDITIONED = 1e-12  # of the Gram matrix: above it, one float64 Gram matrix tells all
_WELL_SPREAD = 1e-3  # lowest eigenvalue of a scaled Gram matrix that needs no second round
_ROUNDING = 1e-11  # deviation from M-orthonormality that is not worth a correction


class RitzPairs(NamedTuple):
    """The lowest eigenpairs inside a subspace, M-orthonormal, and the rank of the basis."""

    eigenvalues: Floats
    eigenvectors: Any  # an array or a tensor, as the basis
    rank: int


@single_threaded_blas()
def ritz_pairs(
    stiffness: Any,
    mass: Any,
    basis: Any,
    k: int,
    *,
    least: int = 0,
    rank_tol: float = 1e-10,
) -> RitzPairs:
    """Return the k lowest Ritz pairs of ``L u = lambda M u`` in the span of `basis`.

    `mass` is the diagonal of M, or M itself as a sparse matrix; all are arrays, or all tensors. Of
    pairs there are as many as the span has dimensions; fewer than `least` are refused. Columns are
    of any scale, and may be dependent; see `orthonormalize` for `rank_tol`.

    The long side of the basis is read three times: for the Gram matrix ``Y^T M Y``, for
    ``Y^T L Y``, and to lift the k wanted vectors. Where rounding of the first left these short of
    orthonormal, their own k x k problem takes it out. Only a badly conditioned basis, of which more
    is wanted than one Gram matrix resolves (`rank_tol` below 1e-6), is orthonormalised first.
    """
    ops, Y = operations(basis), basis
    gram = ops.gram(mass, Y)
    scale = np.sqrt(np.maximum(np.diag(gram), 0.0))
    if not np.isfinite(scale).all() or not scale.all():
        Y = orthonormalize(Y, mass, rank_tol=rank_tol)  # says what is wrong with it
        whitener = np.eye(Y.shape[1])
    elif (root := _inverse_root(gram / scale / scale[:, None], rank_tol)) is not None:
        whitener = root / scale[:, None]
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
    inside, rotation = np.linalg.eigh(whitener.T @ ops.projected(stiffness, Y) @ whitener)
    U = ops.lifted(Y, whitener @ rotation[:, :k])
    error = np.abs(ops.gram(mass, U) - np.eye(k)).max(initial=0.0)
    if error > _ROUNDING:
        return RitzPairs(*ritz_rotation(stiffness, mass, U), rank)
    return RitzPairs(inside[:k], U, rank)


def _inverse_root(gram: Floats, rank_tol: float) -> Floats | None:
    """Return W with ``W^T G W = I`` of a Gram matrix of unit columns, whose rank is not in doubt.

    By a Cholesky factor, which takes a tenth of the time of eigenvectors and leaves less rounding.
    The inverse W of the factor tells whether a cut could drop anything: the highest eigenvalue of G
    is at most m, the lowest at least ``1 / |W|^2`` in the Frobenius norm.
    """
    factor, failed = dpotrf(gram)
    if failed:
        return None
    root = np.triu(dtrtri(factor)[0])
    cut = max(_WELL_CONDITIONED, rank_tol**2)
    return root if len(gram) * np.square(root).sum() < 1 / cut else None


@single_threaded_blas()
def ritz_rotation(stiffness: Any, mass: Any, X: Any) -> tuple[Floats, Any]:
    """Return all Ritz pairs in the span of columns that are far from dependent.

    Such as M-orthonormal ones that were corrected a little; dependent ones are refused.
    """
    ops = operations(X)
    for _ in range(2):  # rounding in a Gram matrix grows by the inverse of its lowest eigenvalue
        inside, gram = ops.projected(stiffness, X), ops.gram(mass, X)
        scale = np.sqrt(np.maximum(np.diag(gram), 0.0))  # rounding of what is carried to nothing
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
        X = ops.lifted(X, rotation)
        if lowest > _WELL_SPREAD:
            break
    return values, X
