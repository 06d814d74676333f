"""Residuals of eigenpairs, one pass over the matrix for all of them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from spectra_kit.linalg.threads import in_threads

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

_ROWS = 8_192  # of one task: fixed, so that sums do not depend on the number of threads


def residuals(
    stiffness: sparse.csr_array, mass: Floats, values: Floats, vectors: Floats
) -> tuple[Singles, Floats]:
    """Return ``R = L U - M U diag(values)`` and the M^-1 norms of its columns.

    Parameters
    ----------
    stiffness : sparse array of shape (n, n)
        L, in CSR form.
    mass : ndarray of shape (n,)
        Diagonal of M, positive.
    values : ndarray of shape (k,)
    vectors : ndarray of shape (n, k)
        U.

    Returns
    -------
    ndarray of shape (n, k), float32
        R, computed in float64 and rounded.
    ndarray of shape (k,)
        ``||r||`` in the M^-1 norm, of the R before rounding.

    Examples
    --------
    >>> path = sparse.csr_array([[1.0, -1.0], [-1.0, 1.0]])
    >>> residuals(path, np.ones(2), np.array([0.0]), np.ones((2, 1)))[1]
    array([0.])
    """
    R = np.empty(vectors.shape, np.float32)
    return R, _norms(stiffness, mass, 1 / mass, values, vectors, R)


def residual_norms(
    stiffness: sparse.csr_array,
    mass: Floats,
    values: Floats,
    vectors: Floats,
    *,
    left_out: NDArray[np.int64] | None = None,
) -> Floats:
    """Return the norms that `residuals` does, without the rows `left_out` and without R.

    Examples
    --------
    >>> path = sparse.csr_array([[1.0, -1.0], [-1.0, 1.0]])
    >>> residual_norms(path, np.ones(2), np.array([0.0]), np.array([[0.0], [1.0]]))
    array([1.4142...])
    >>> residual_norms(path, np.ones(2), np.zeros(1), np.eye(2)[:, 1:], left_out=np.array([0]))
    array([1.])
    """
    weights = 1 / mass
    if left_out is not None:
        weights[left_out] = 0.0
    return _norms(stiffness, mass, weights, values, vectors, np.empty((0, 0), np.float32))


def _norms(
    stiffness: sparse.csr_array,
    mass: Floats,
    weights: Floats,
    values: Floats,
    vectors: Floats,
    out: Singles,
) -> Floats:
    """Return the weighted norms of the residuals, and write these to `out` if it has rows."""
    from spectra_kit.linalg._filter_kernels import residual_rows

    U = np.ascontiguousarray(vectors)
    cuts = list(range(0, len(U), _ROWS)) + [len(U)]
    squares = np.empty((len(cuts) - 1, U.shape[1]))
    fixed = (stiffness.indptr, stiffness.indices, stiffness.data, mass, weights, U, values)
    in_threads(
        residual_rows,
        ((*fixed, out, squares[i], start, stop) for i, (start, stop) in enumerate(pairwise(cuts))),
    )
    return np.asarray(np.sqrt(squares.sum(axis=0)))
