"""Residuals of eigenpairs, one pass over the matrix for all of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from spectra_kit._types import Floats, Singles
from spectra_kit.linalg.threads import in_threads, ranges

_ROWS = 8_192  # of one task: fixed, so that no sum depends on the threads


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
    >>> import numpy as np
    >>> from scipy import sparse
    >>> from spectra_kit.linalg.residuals import residuals
    >>> path = sparse.csr_array([[1.0, -1.0], [-1.0, 1.0]])
    >>> residuals(path, np.ones(2), np.array([0.0]), np.ones((2, 1)))[1]
    array([0.])
    """
    from spectra_kit.linalg._filter_kernels import residual_rows

    U = np.ascontiguousarray(vectors)
    R = np.empty(U.shape, np.float32)
    blocks = ranges(len(U), _ROWS)
    squares = np.empty((len(blocks), U.shape[1]))
    fixed = (stiffness.indptr, stiffness.indices, stiffness.data, mass, U, values, R)
    in_threads(residual_rows, ((*fixed, squares[i], *ends) for i, ends in enumerate(blocks)))
    return R, np.asarray(np.sqrt(squares.sum(axis=0)))


def residual_norms(
    stiffness: sparse.csr_array,
    mass: Floats,
    values: Floats,
    vectors: Floats,
    *,
    left_out: NDArray[np.int64] | None = None,
) -> Floats:
    """Return the norms that `residuals` does, without the rows `left_out` and without R.

    By SciPy and NumPy alone: every spectrum is certified, also where nothing can be compiled.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> from spectra_kit.linalg.residuals import residual_norms
    >>> path = sparse.csr_array([[1.0, -1.0], [-1.0, 1.0]])
    >>> residual_norms(path, np.ones(2), np.array([0.0]), np.array([[0.0], [1.0]]))
    array([1.4142...])
    >>> residual_norms(path, np.ones(2), np.zeros(1), np.eye(2)[:, 1:], left_out=np.array([0]))
    array([1.])
    """
    U = np.ascontiguousarray(vectors)
    # In units of the largest entry of M^-1 L, squares neither overflow nor vanish.
    unit = float((np.abs(stiffness.diagonal()) / mass).max(initial=0.0)) or 1.0
    weights = 1 / (np.sqrt(mass) * unit)
    if left_out is not None:
        weights[left_out] = 0.0
    blocks = ranges(len(U), _ROWS)
    squares = np.empty((len(blocks), U.shape[1]))

    def measure(i: int, start: int, stop: int) -> None:
        rows = slice(start, stop)
        r = stiffness[rows] @ U
        r -= mass[rows, None] * U[rows] * values
        r *= weights[rows, None]
        squares[i] = np.einsum("ij,ij->j", r, r)

    in_threads(measure, ((i, *ends) for i, ends in enumerate(blocks)))
    return np.asarray(unit * np.sqrt(squares.sum(axis=0)))
