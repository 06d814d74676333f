"""Products of a sparse matrix with many columns at once, and residuals of eigenpairs."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray
from scipy import sparse

from spectra_kit._core.records import frozen
from spectra_kit._core.threads import WORTH_SHARING, in_threads, ranges, shares
from spectra_kit._core.types import Floats, Singles
from spectra_kit.errors import InvalidInputError

_SMALL = 200_000  # multiplications below which a thread costs more than it saves
_ROWS = 8_192  # of one task: fixed, so that no sum depends on the threads
_CACHED = 1_024  # rows of which NumPy's temporaries stay in the cache


def spmm(
    matrix: sparse.csr_array, dense: NDArray[np.floating], *, dtype: DTypeLike | None = None
) -> NDArray[Any]:
    """Return ``matrix @ dense``, on all cores; the same bits whatever the number of threads.

    In CSR form and C order; anything else is converted first. `dtype` is that of the sums and the
    result, by default that of `dense`. scipy's product runs on one core and only in the wider of
    the two types.
    """
    from spectra_kit._sparse._kernels import multiply_rows

    dense = np.ascontiguousarray(dense)
    result = real_dtype("dtype", dense.dtype if dtype is None else dtype)
    real_dtype("dense", dense.dtype)
    if dense.ndim != 2 or matrix.shape[1] != len(dense):
        raise InvalidInputError(
            "dense",
            f"have shape ({matrix.shape[1]}, s) to be multiplied by a matrix of shape "
            f"{matrix.shape}",
            dense.shape,
        )
    rows = sparse.csr_array(matrix)
    values = rows.data.astype(result, copy=False)
    n = rows.shape[0]
    out = np.empty((n, dense.shape[1]), result)
    cuts = shares(n, None if rows.nnz * dense.shape[1] > _SMALL else 1)
    given = (frozen(array) for array in (rows.indptr, rows.indices, values, dense))
    fixed = (*given, out)  # frozen or not, one loop is compiled
    in_threads(multiply_rows, ((*fixed, *cut) for cut in cuts))
    return out


def rows_of(
    matrix: sparse.csr_array, dtype: DTypeLike = np.float64
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[Any]]:
    """Return where the rows of a matrix begin, their columns and their values.

    Read-only, and of one kind: numba compiles anew for others.
    """
    starts, columns = (
        frozen(np.asarray(a, dtype=np.int32)) for a in (matrix.indptr, matrix.indices)
    )
    return starts, columns, frozen(np.asarray(matrix.data, dtype=dtype))


def real_dtype(name: str, dtype: DTypeLike) -> np.dtype[np.floating]:
    """Return `dtype` if it is float32 or float64."""
    resolved: np.dtype[Any] = np.dtype(dtype)
    if resolved not in (np.float32, np.float64):
        raise InvalidInputError(name, "be float32 or float64", resolved)
    return resolved


def weighed(mass: Floats | sparse.csr_array, X: NDArray[Any]) -> NDArray[Any]:
    """Return ``M X``, of the type of X, by the diagonal of M or all of it."""
    if isinstance(mass, sparse.csr_array):
        return spmm(mass, X)
    return np.asarray(mass.astype(X.dtype, copy=False)[:, None] * X)


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
) -> tuple[Floats, Floats]:
    """Return the norms that `residuals` does, without the rows `left_out`, and not R but ``u^T r``.

    By SciPy and NumPy alone: every spectrum is certified, also where nothing can be compiled.
    """
    U = np.ascontiguousarray(vectors)
    # In units of the largest entry of M^-1 L, squares neither overflow nor vanish.
    unit = float((np.abs(stiffness.diagonal()) / mass).max(initial=0.0)) or 1.0
    weights = 1 / (np.sqrt(mass) * unit)
    if left_out is not None:
        weights[left_out] = 0.0
    # To cut rows from a small matrix takes longer than to multiply them.
    whole = stiffness @ U if U.size <= WORTH_SHARING else None
    blocks = ranges(len(U), _CACHED)
    squares, along = np.empty((2, len(blocks), U.shape[1]))

    def measure(i: int, start: int, stop: int) -> None:
        rows = slice(start, stop)
        r = stiffness[rows] @ U if whole is None else whole[rows]
        r -= mass[rows, None] * U[rows] * values
        along[i] = np.einsum("ij,ij->j", U[rows], r)
        r *= weights[rows, None]
        squares[i] = np.einsum("ij,ij->j", r, r)

    in_threads(measure, ((i, *ends) for i, ends in enumerate(blocks)))
    return np.asarray(unit * np.sqrt(squares.sum(axis=0))), np.asarray(along.sum(axis=0))
