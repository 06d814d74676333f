"""Sparse Cholesky factorisation of a symmetric positive definite matrix."""

from __future__ import annotations

import cholespy
import numpy as np
from scipy import sparse

from spectra_kit._types import Floats
from spectra_kit.errors import InvalidInputError
from spectra_kit.linalg._checks import check_matrix

_MAX_ENTRIES = 2**31 - 1  # cholespy indexes with 32-bit integers


class SparseCholesky:
    """A Cholesky factor, computed once and then applied to any number of right-hand sides.

    Parameters
    ----------
    matrix : sparse array of shape (n, n)
        Symmetric positive definite; both triangles stored.

    Raises
    ------
    InvalidInputError
        If `matrix` is not square and finite, or not numerically positive definite.

    Notes
    -----
    The factorisation is CHOLMOD's, through cholespy. For one right-hand side at a time; `SparseLDL`
    solves blocks faster.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> from spectra_kit.linalg import SparseCholesky
    >>> factor = SparseCholesky(sparse.csr_array([[2.0, -1.0], [-1.0, 2.0]]))
    >>> factor.solve(np.array([1.0, 1.0]))
    array([1., 1.])
    """

    def __init__(self, matrix: sparse.csr_array) -> None:
        rows = check_matrix(matrix)
        if rows.nnz > _MAX_ENTRIES:
            raise InvalidInputError("matrix", f"have at most {_MAX_ENTRIES} entries", rows.nnz)
        self.n: int = rows.shape[0]
        parts = (np.require(part, None, "W") for part in (rows.indptr, rows.indices, rows.data))
        try:
            self._factor = cholespy.CholeskySolverD(self.n, *parts, cholespy.MatrixType.CSR)
        except ValueError as error:
            raise InvalidInputError(
                f"`matrix` could not be factorised ({error});"
                " it must be symmetric positive definite"
            ) from error

    def solve(self, rhs: Floats) -> Floats:
        """Solve ``matrix @ x = rhs`` for `rhs` of shape (n,) or (n, s)."""
        rhs = np.require(rhs, np.float64, ["C", "W"])  # cholespy takes no read-only array
        solution = np.empty_like(rhs)
        self._factor.solve(rhs, solution)
        return solution
