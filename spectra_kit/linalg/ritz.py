"""Rayleigh-Ritz: the best eigenpairs inside the span of given columns."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import eigh

from spectra_kit.errors import InvalidInputError
from spectra_kit.linalg.orthonormal import orthonormalize
from spectra_kit.linalg.products import spmm

Floats = NDArray[np.float64]

_ROWS = 16_384  # rows handled at once: bounds the temporaries and keeps them in the cache
_WELL_CONDITIONED = 1e-12  # of the Gram matrix: above it, one float64 Gram matrix tells all
_ROUNDING = 1e-12  # deviation from M-orthonormality that is not worth a correction


class RitzPairs(NamedTuple):
    """The lowest eigenpairs inside a subspace.

    Attributes
    ----------
    eigenvalues : ndarray of shape (k,)
        Ascending.
    eigenvectors : ndarray of shape (n, k)
        M-orthonormal columns.
    rank : int
        Numerical rank of the basis.
    """

    eigenvalues: Floats
    eigenvectors: Floats
    rank: int


def ritz_pairs(
    stiffness: sparse.csr_array,
    mass: Floats,
    basis: NDArray[np.floating],
    k: int,
    *,
    rank_tol: float = 1e-10,
) -> RitzPairs:
    """Return the k lowest Ritz pairs of ``L u = lambda M u`` in the span of `basis`.

    Parameters
    ----------
    stiffness : sparse array of shape (n, n)
        L, symmetric positive semi-definite.
    mass : ndarray of shape (n,)
        Diagonal of M, positive.
    basis : ndarray of shape (n, m)
        Columns of any scale, dependent ones allowed.
    k : int
        Pairs to return.
    rank_tol : float, default 1e-10
        Relative cut on the singular values of the basis; see `orthonormalize`.

    Returns
    -------
    RitzPairs

    Raises
    ------
    InvalidInputError
        If the numerical rank of `basis` is below k, or it holds NaN, infinity or only zeros.

    Notes
    -----
    The long side of the basis is read three times: for the Gram matrix ``Y^T M Y``, for
    ``Y^T L Y``, and to lift the k wanted vectors. Where rounding of the first left these short of
    orthonormal, their own k x k problem takes it out. Only a badly conditioned basis is
    orthonormalised first, as a whole.

    Examples
    --------
    >>> path = sparse.csr_array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    >>> ritz_pairs(path, np.ones(3), np.eye(3), 2).eigenvalues.round(6)
    array([0., 1.])
    """
    pairs = ritz_pairs_at_most(stiffness, mass, basis, k, rank_tol=rank_tol)
    if pairs.rank < k:
        raise InvalidInputError(
            f"`basis` must span at least k = {k} dimensions, got numerical rank {pairs.rank} of"
            f" {basis.shape[1]} columns; ask for fewer modes or use a larger basis"
        )
    return pairs


def ritz_pairs_at_most(
    stiffness: sparse.csr_array,
    mass: Floats,
    basis: NDArray[np.floating],
    k: int,
    *,
    rank_tol: float = 1e-10,
) -> RitzPairs:
    """Return what `ritz_pairs` does, or as many pairs as the basis has dimensions."""
    Y = np.ascontiguousarray(basis, dtype=np.float64)
    gram = weighted_gram(Y, mass)
    scale = np.sqrt(np.diag(gram))
    if not np.isfinite(scale).all() or not scale.all():
        Y = orthonormalize(Y[:, scale != 0], mass, rank_tol=rank_tol)  # says what is wrong with it
        whitener = np.eye(Y.shape[1])
    else:
        values, vectors = np.linalg.eigh(gram / scale / scale[:, None])
        if values[0] > max(_WELL_CONDITIONED, rank_tol**2) * values[-1]:
            whitener = vectors / np.sqrt(values) / scale[:, None]
        else:
            Y = orthonormalize(Y, mass, rank_tol=rank_tol)
            whitener = np.eye(Y.shape[1])
    rank = whitener.shape[1]
    k = min(k, rank)
    inside, rotation = np.linalg.eigh(whitener.T @ projected(stiffness, Y) @ whitener)
    U = Y @ (whitener @ rotation[:, :k])
    error = np.abs(weighted_gram(U, mass) - np.eye(k)).max()
    if error > _ROUNDING:
        return RitzPairs(*ritz_rotation(stiffness, mass, U), rank)
    return RitzPairs(inside[:k], U, rank)


def ritz_rotation(stiffness: sparse.csr_array, mass: Floats, X: Floats) -> tuple[Floats, Floats]:
    """Return all Ritz pairs in the span of columns that are far from dependent.

    Parameters
    ----------
    stiffness, mass
        As in `ritz_pairs`.
    X : ndarray of shape (n, b)
        Columns with a Gram matrix of moderate condition, such as M-orthonormal ones that were
        corrected a little.

    Returns
    -------
    eigenvalues (b,), eigenvectors (n, b)
    """
    values, rotation = eigh(projected(stiffness, X), weighted_gram(X, mass))
    return values, X @ rotation


def weighted_gram(Y: Floats, mass: Floats) -> Floats:
    """Return ``Y^T M Y``, a block of rows at a time."""
    gram = np.zeros((Y.shape[1], Y.shape[1]))
    for start in range(0, len(Y), _ROWS):
        rows = slice(start, start + _ROWS)
        weighted = np.sqrt(mass[rows, None]) * Y[rows]
        gram += weighted.T @ weighted
    return gram


def projected(stiffness: sparse.csr_array, Y: Floats) -> Floats:
    """Return ``Y^T L Y``, symmetric, a block of rows at a time."""
    inside = np.zeros((Y.shape[1], Y.shape[1]))
    for start in range(0, len(Y), _ROWS):
        rows = slice(start, start + _ROWS)
        inside += Y[rows].T @ spmm(stiffness[rows], Y)
    return (inside + inside.T) / 2
