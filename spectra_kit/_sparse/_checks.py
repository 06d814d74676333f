"""Checks of a linear system at the border: matrix, right-hand side, kernel."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from spectra_kit._core.types import Floats
from spectra_kit._core.validate import quantity, real_array
from spectra_kit._sparse.constant_kernel import ConstantKernel
from spectra_kit.errors import InvalidInputError

#: Share of the sum of magnitudes below which a sum counts as zero: rounding of n terms.
_ROUNDING = 1e-9


def check_matrix(matrix: Any) -> sparse.csr_array:
    """Return `matrix` as a finite csr_array in float64, with 32-bit indices if they do."""
    rows = sparse.csr_array(matrix, dtype=np.float64)
    if not rows.has_canonical_format:
        rows = rows.copy()
        rows.sum_duplicates()
    if not np.isfinite(rows.data).all():
        raise InvalidInputError(
            "matrix", "be finite", f"{int((~np.isfinite(rows.data)).sum())} NaN or infinite entries"
        )
    if rows.nnz < 2**31 and rows.indices.dtype != np.int32:
        rows = sparse.csr_array(
            (rows.data, rows.indices.astype(np.int32), rows.indptr.astype(np.int32)), rows.shape
        )
    return rows


def check_vector(name: str, values: Any, n: int) -> Floats:
    """Return `values` as n contiguous float64 numbers: compiled loops do not look where they read.

    Finite or not: this is called in every iteration.
    """
    if np.shape(values) != (n,):
        raise InvalidInputError(name, f"have shape ({n},)", np.shape(values))
    return np.ascontiguousarray(values, dtype=np.float64)


def asymmetry(matrix: sparse.csr_array) -> float:
    """Return the largest entry of ``|A - A.T|``, 0 if it is rounding."""
    turned = matrix.T.tocsr()
    alike = np.array_equal(turned.indptr, matrix.indptr) and matrix.has_sorted_indices
    if alike and np.array_equal(turned.indices, matrix.indices):
        found = float(np.abs(matrix.data - turned.data).max(initial=0.0))
    else:
        found = float(abs(matrix - turned).max())
    return found if found > 1e-8 * np.abs(matrix.data).max(initial=0.0) else 0.0


def check_symmetric(matrix: sparse.csr_array) -> None:
    """Raise unless `matrix` equals its transpose to rounding."""
    if (found := asymmetry(matrix)) > 0:
        raise InvalidInputError(
            "matrix",
            "be symmetric",
            f"|A - A.T| up to {found:.2e}",
            advice="pass (A + A.T) / 2 if that is meant",
        )


def check_kernel(kernel: ConstantKernel | None, matrix: sparse.csr_array) -> ConstantKernel | None:
    """Return `kernel` if `matrix` maps its functions to zero."""
    if kernel is None:
        return None
    marks = kernel.labels + 1.0  # one number for each component: a link between two shows
    image = np.abs(matrix @ marks)
    scale = matrix.diagonal() * marks.max()
    bad = np.flatnonzero(image > _ROUNDING * scale)
    if len(bad):
        raise InvalidInputError(
            "`kernel` must hold constants that `matrix` maps to zero, but it does not in"
            f" {quantity(len(bad), 'row')}, the first {bad[0]}"
        )
    return kernel


def check_rhs(rhs: ArrayLike, n: int, kernel: ConstantKernel | None) -> Floats:
    """Return `rhs` less its rounding error in the kernel, if it is in the range otherwise."""
    values = real_array("rhs", check_vector("rhs", rhs, n))
    if kernel is None:
        return values
    means, sizes = kernel.means(values), kernel.means(np.abs(values))
    bad = np.flatnonzero(np.abs(means) > _ROUNDING * sizes)
    if len(bad):
        raise InvalidInputError(
            "rhs",
            "sum to zero on each component of the kernel",
            f"a mean of {means[bad[0]]:.3g} on component {bad[0]} (of values of size "
            f"{sizes[bad[0]]:.3g})",
            advice="subtract it with `kernel.remove(rhs)` if a least-squares solution is meant",
        )
    return kernel.remove(values)
