"""Residuals of eigenpairs, one pass over the matrix for all of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from spectra_kit._core.records import frozen
from spectra_kit._core.threads import in_threads, ranges
from spectra_kit._core.types import Floats, Singles

_ROWS = 8_192  # of one task: fixed, so that no sum depends on the threads


def residuals(
    stiffness: sparse.csr_array, mass: Floats, values: Floats, vectors: Floats
) -> tuple[Singles, Floats]:
    """Return ``R = L U - M U diag(values)`` and the M^-1 norms of its columns.

    R in float32, but computed, like the norms, in float64.
    """
    from spectra_kit._sparse._kernels import residual_rows

    U = np.ascontiguousarray(vectors)
    R = np.empty(U.shape, np.float32)
    blocks = ranges(len(U), _ROWS)
    squares = np.empty((len(blocks), U.shape[1]))
    given = (stiffness.indptr, stiffness.indices, stiffness.data, mass, U, values)
    fixed = (*map(frozen, given), R)  # frozen or not, one loop is compiled
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
