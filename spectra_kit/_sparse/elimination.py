"""`Elimination`: all of a sparse factor that the pattern of a matrix decides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from spectra_kit._sparse._checks import check_matrix, check_symmetric
from spectra_kit.errors import InvalidInputError, OutOfMemoryError

# Neighbours of a point that is left for the end: times the square root of n, and at least. As in
# AMD (Amestoy, Davis and Duff, Algorithm 837, ACM TOMS 30, 2004).
_HUB, _FEWEST = 10.0, 16


def minimum_degree(matrix: sparse.csr_array) -> NDArray[np.int32]:
    """Return the points of a symmetric pattern in an order of elimination that fills in little.

    Next is always one with about the fewest neighbours that are left (Amestoy, Davis and Duff, *An
    Approximate Minimum Degree Ordering Algorithm*, SIAM J. Matrix Anal. Appl. 17, 1996). Where
    triangles are of one size, nested dissection needs a third fewer operations; where they are not,
    or there are many parts, up to three times as many.
    """
    from spectra_kit._sparse._degree_kernels import eliminate

    degrees = np.diff(matrix.indptr)
    hubs = np.flatnonzero(degrees > max(_FEWEST, _HUB * np.sqrt(len(degrees))))
    if len(hubs):
        others = np.setdiff1d(np.arange(len(degrees)), hubs)
        rest = others[minimum_degree(sparse.csr_array(matrix[others][:, others]))]
        return np.append(rest, hubs).astype(np.int32)
    n = len(degrees)
    lists = np.empty(2 * matrix.nnz + n, np.int32)
    longs, ints = np.zeros((4, n), np.int64), np.full((11, n + 1), -1, np.int32)
    return eliminate(*pattern(matrix), lists, longs, ints)


def pattern(matrix: sparse.csr_array) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return starts and columns that can be written to: loops are compiled for such alone."""
    return np.require(matrix.indptr, None, "W"), np.require(matrix.indices, None, "W")


_MAX_ENTRIES = 2**31 - 1  # of a matrix: 32-bit indices


@dataclass(frozen=True, eq=False, repr=False)
class Elimination:
    """All of a factor that the pattern of a matrix decides; serves each of that pattern.

    Make one with `of`. Columns are eliminated in `order`, in runs from ``begins[s]`` on that have
    the same rows below them, ``rows[first[s]:first[s + 1]]``, counted in that order; ``above[s]``
    is the run whose columns these begin with, and the factor holds run s from ``panels[s]`` on.
    `sizes` are those of memory that the numbers need while they are made.
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
        """Find an order for a symmetric pattern, stored whole, and what follows from it."""
        A = symmetric(matrix)
        try:
            return analysed(A)
        except MemoryError as error:
            raise no_memory(A.shape[0]) from error

    @property
    def gigabytes(self) -> float:
        """What a factor takes in GiB, and all that is held while it is made."""
        shared = sum(int(part.nbytes) for part in vars(self).values())
        numbers = self.fill + 2 * len(self.order) + int(self.sizes.sum())
        return (8 * numbers + shared) / 2**30

    @property
    def fill(self) -> int:
        """Entries that a factor holds below its diagonal; some of them are zero."""
        return int(self.panels[-1])

    def serves(self, matrix: sparse.csr_array) -> bool:
        """Return whether `matrix` has the pattern that this was made for."""
        pattern = (self.starts, self.columns)
        return all(map(np.array_equal, pattern, (matrix.indptr, matrix.indices)))


def symmetric(matrix: sparse.csr_array) -> sparse.csr_array:
    """Return a matrix with the pattern of its transpose, on which the loops rely."""
    A = check_matrix(matrix)
    other = sparse.csr_array(A.T)
    other.sort_indices()
    alike = all(map(np.array_equal, (A.indptr, A.indices), (other.indptr, other.indices)))
    if not (alike and np.array_equal(A.data, other.data)):
        check_symmetric(A)
    return A if alike else check_matrix((A + other) / 2)


def analysed(A: sparse.csr_array) -> Elimination:
    """Return the elimination of what `symmetric` returned."""
    from spectra_kit._sparse import _frontal_kernels as kernels

    if A.nnz > _MAX_ENTRIES:
        raise InvalidInputError("matrix", f"have at most {_MAX_ENTRIES} entries", A.nnz)
    starts, columns = pattern(A)
    order, parent, below = kernels.elimination_tree(starts, columns, minimum_degree(A))
    begins = kernels.supernodes(parent, below)
    first, rows, above, sizes = kernels.front_rows(starts, columns, order, parent, below, begins)
    width = np.diff(begins).astype(np.int64)
    entries = width * (width - 1) // 2 + width * np.diff(first)
    panels = np.append(0, np.cumsum(entries))
    return Elimination(starts, columns, order, begins, first, rows, above, panels, sizes)


def no_memory(n: int) -> OutOfMemoryError:
    """Return the error of a factor that is too large."""
    return OutOfMemoryError(
        f"the factor of {n} unknowns does not fit into memory; use a method without one, such as"
        " Cascade() or geodesics.Iterative()"
    )
