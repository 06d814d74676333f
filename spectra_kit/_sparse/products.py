"""Products of a sparse matrix with many columns at once."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray
from scipy import sparse

from spectra_kit._core.records import frozen
from spectra_kit._core.threads import in_threads, shares
from spectra_kit.errors import InvalidInputError

_SMALL = 200_000  # multiplications below which a thread costs more than it saves


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
