"""Sparse Cholesky factorisation of a symmetric positive definite matrix."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from spectra_kit._types import Floats
from spectra_kit.errors import InvalidInputError, OutOfMemoryError
from spectra_kit.linalg._checks import check_matrix
from spectra_kit.linalg.minimum_degree import minimum_degree

_MAX_ENTRIES = 2**31 - 1  # of a matrix: 32-bit indices
_ASYMMETRY = 1e-8  # of the largest entry: more is none of rounding


@dataclass(frozen=True, eq=False, repr=False)
class Elimination:
    """All of a Cholesky factor that the pattern of a matrix decides; serves each of that pattern.

    Make one with `of`. Columns are eliminated in `order`, in runs from ``begins[s]`` on that have
    the same rows below them, ``rows[first[s]:first[s + 1]]``, counted in that order; ``above[s]``
    is the run whose columns these begin with, and the factor holds run s from ``panels[s]`` on.
    `sizes` are those of memory that the numbers need while they are made.

    Examples
    --------
    >>> from scipy import sparse
    >>> from spectra_kit.linalg import SparseCholesky
    >>> from spectra_kit.linalg.cholesky import Elimination
    >>> A = sparse.diags_array([-1.0, 3.0, -1.0], offsets=[-1, 0, 1], shape=(9, 9), format="csr")
    >>> shared = Elimination.of(A)
    >>> [SparseCholesky(matrix, elimination=shared).n for matrix in (A, 2 * A)]
    [9, 9]
    """

    starts: NDArray[np.int32]
    columns: NDArray[np.int32]
    order: NDArray[np.int32]
    begins: NDArray[np.int32]
    first: NDArray[np.int64]
    rows: NDArray[np.int32]
    above: NDArray[np.int32]
    panels: NDArray[np.int64]
    sizes: NDArray[np.int64]

    @staticmethod
    def of(matrix: sparse.csr_array) -> Elimination:
        """Find an order for the pattern of a symmetric matrix, and what follows from it.

        Parameters
        ----------
        matrix : sparse array of shape (n, n)
            Both triangles stored.
        """
        from spectra_kit.linalg import _frontal_kernels as kernels

        A = _symmetric(matrix)
        if A.nnz > _MAX_ENTRIES:
            raise InvalidInputError("matrix", f"have at most {_MAX_ENTRIES} entries", A.nnz)
        starts, columns = (np.require(part, None, "W") for part in (A.indptr, A.indices))
        order, parent, below = kernels.elimination_tree(starts, columns, minimum_degree(A))
        begins = kernels.supernodes(parent, below)
        first, rows, above, sizes = kernels.front_rows(
            starts, columns, order, parent, below, begins
        )
        width = np.diff(begins).astype(np.int64)
        entries = width * (width - 1) // 2 + width * np.diff(first)
        panels = np.append(0, np.cumsum(entries))
        return Elimination(starts, columns, order, begins, first, rows, above, panels, sizes)

    @property
    def fill(self) -> int:
        """Entries that a factor holds below its diagonal; some of them are zero."""
        return int(self.panels[-1])

    def serves(self, matrix: sparse.csr_array) -> bool:
        """Return whether `matrix` has the pattern that this was made for."""
        pattern = (self.starts, self.columns)
        return all(map(np.array_equal, pattern, (matrix.indptr, matrix.indices)))


class SparseCholesky:
    """A Cholesky factor, computed once and then applied to any number of right-hand sides.

    Parameters
    ----------
    matrix : sparse array of shape (n, n)
        Symmetric positive definite; both triangles stored.
    elimination : Elimination, optional
        Of a matrix with the same pattern. Without it, that of `matrix` is found first, which takes
        about as long as the factor itself.

    Attributes
    ----------
    n : int
        Size of the matrix.
    fill : int
        Entries of the factor below its diagonal.

    Raises
    ------
    InvalidInputError
        If `matrix` is not square and finite, not numerically positive definite, or of another
        pattern than that of `elimination`; from `solve`, if `rhs` has another number of rows.
    OutOfMemoryError
        If the factor does not fit into memory.

    Notes
    -----
    A multifrontal factorisation in the order of `minimum_degree`, in compiled loops that release
    the interpreter lock. For one right-hand side at a time; `SparseLDL` solves blocks faster.
    CHOLMOD from a wheel took five to seven times as long on operators of surfaces, kept the lock,
    and analysed the pattern anew for each matrix.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> from spectra_kit.linalg import SparseCholesky
    >>> factor = SparseCholesky(sparse.csr_array([[2.0, -1.0], [-1.0, 2.0]]))
    >>> factor.solve(np.array([1.0, 1.0]))
    array([1., 1.])
    """

    def __init__(self, matrix: sparse.csr_array, *, elimination: Elimination | None = None) -> None:
        from spectra_kit.linalg._frontal_kernels import factorise

        A = _symmetric(matrix)
        self.n: int = A.shape[0]
        if elimination is not None and not elimination.serves(A):
            raise InvalidInputError("elimination", "have the pattern of `matrix`", "another")
        try:
            self._shared = known = Elimination.of(A) if elimination is None else elimination
            self._factor, self._inverse = np.empty(known.fill), np.empty(self.n)
            bad = factorise(
                known.starts,
                known.columns,
                np.require(A.data, None, "W"),  # loops are compiled for what can be written to
                known.order,
                known.begins,
                known.first,
                known.rows,
                known.above,
                known.panels,
                known.sizes,
                self._factor,
                self._inverse,
            )
        except MemoryError as error:
            raise OutOfMemoryError(
                f"the factor of {self.n} unknowns does not fit into memory; use a method without"
                " one, such as Cascade() or geodesics.Iterative()"
            ) from error
        if bad >= 0:
            raise InvalidInputError(
                f"`matrix` must be symmetric positive definite: the pivot of row"
                f" {known.order[bad]} is negative, zero or not finite"
            )

    @property
    def fill(self) -> int:
        """Entries of the factor below its diagonal."""
        return len(self._factor)

    def solve(self, rhs: Floats) -> Floats:
        """Solve ``matrix @ x = rhs`` for `rhs` of shape (n,) or (n, s)."""
        from spectra_kit.linalg._frontal_kernels import solve_one

        rhs = np.asarray(rhs, dtype=np.float64)
        if rhs.ndim not in (1, 2) or len(rhs) != self.n:
            raise InvalidInputError("rhs", f"have shape ({self.n},) or ({self.n}, s)", rhs.shape)
        known = self._shared
        found = np.empty((rhs.size // self.n, self.n))
        columns = np.require(rhs.T, None, ["C", "W"]).reshape(found.shape)
        for b, x in zip(columns, found, strict=True):
            solve_one(
                known.order,
                known.begins,
                known.first,
                known.rows,
                known.panels,
                self._factor,
                self._inverse,
                b,
                x,
            )
        return found[0] if rhs.ndim == 1 else np.ascontiguousarray(found.T)


def _symmetric(matrix: sparse.csr_array) -> sparse.csr_array:
    """Return a matrix with the pattern of its transpose, on which the loops rely."""
    A = check_matrix(matrix)
    other = sparse.csr_array(A.T)
    other.sort_indices()
    if all(map(np.array_equal, (A.indptr, A.indices), (other.indptr, other.indices))):
        return A
    if abs(A - other).max() > _ASYMMETRY * abs(A).max():
        raise InvalidInputError("matrix", "be symmetric, both triangles stored", "another")
    return check_matrix((A + other) / 2)
