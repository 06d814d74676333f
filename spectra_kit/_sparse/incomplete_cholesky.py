"""Incomplete Cholesky factors, as preconditioners."""

from __future__ import annotations

import numpy as np
from numpy.typing import DTypeLike, NDArray
from scipy import sparse

from spectra_kit._core.clock import Clock
from spectra_kit._core.types import Floats
from spectra_kit._sparse._checks import check_matrix, check_vector
from spectra_kit._sparse.products import real_dtype
from spectra_kit.errors import InvalidInputError

_FIRST_SHIFT = 1e-3
_GROWTH = 4.0
_LARGEST_SHIFT = 2.0
_FAR = 0.05  # share of n by which neighbours are apart, on average, in an untidy order


class IncompleteCholesky:
    """``A ~ (I + L) D (I + L)^T`` with a sparse L: an approximation that is quick to invert.

    Of A, symmetric positive semi-definite, one triangle is read. Without `drop`, L has its pattern:
    that is level 0, the incomplete Cholesky factor of textbooks. With it, an entry (of ``L D``) is
    kept where it exceeds `drop` times the norm of its column of A, be it fill or, as weak ones may
    drop out too, where A has an entry; with 0, everything is kept: a complete factor.

    `relaxation` is the share in [0, 1] of every dropped entry that is taken from the diagonals of
    its row and column. With 1 the factor is exact on constants (Gustafsson's modified factor, whose
    condition grows with 1 / h in place of 1 / h^2, and which is singular if A is); a little less is
    safer. Points are eliminated in the order given, which had better not be `untidy`: that costs
    twice the iterations. The factor is computed and applied in float64, whatever it is stored in.

    A factor always exists for M-matrices (Meijerink & van der Vorst, *Math. Comp.* 31, 1977), so
    for every intrinsic Delaunay Laplacian. Elsewhere, as for cotangents of obtuse triangles, a
    pivot may come out zero or negative; then the diagonal is raised by 1e-3 of itself, and by four
    times as much again until it works (Manteuffel, *Math. Comp.* 34, 1980): the factor is that of
    ``A + shift * diag(A)``. A pivot that is zero to rounding with nothing below it is none of
    these: it ends a component of a singular matrix, whose last unknown is then held at zero.

    The threshold factor is ICT(tau) (Saad, *Iterative Methods for Sparse Linear Systems*,
    2003, section 10.8); relaxation after Gustafsson (*BIT* 18, 1978) and Axelsson & Lindskog
    (*Numer. Math.* 48, 1986). Both sweeps read rows, each from its own copy of L.

    >>> from scipy import sparse
    >>> from spectra_kit._sparse import IncompleteCholesky
    >>> path = sparse.csr_array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 2.0]])
    >>> IncompleteCholesky(path)
    IncompleteCholesky(n=3, level 0, fill=2)
    """

    def __init__(
        self,
        matrix: sparse.csr_array,
        *,
        drop: float | None = None,
        relaxation: float = 0.0,
        dtype: DTypeLike = np.float64,
    ) -> None:
        clock = Clock()
        rows = check_matrix(matrix)
        kind = real_dtype("dtype", dtype)
        self.n: int = rows.shape[0]
        self._kind = "level 0" if drop is None else f"drop={drop:g}"
        self._kind += f", relaxation={relaxation:g}" if relaxation else ""
        diagonal = rows.diagonal()
        if (diagonal < 0).any():
            raise _indefinite(f"its diagonal goes down to {diagonal.min():.3g}")
        above = sparse.triu(rows, 1, format="csr")
        above.sort_indices()
        self.shift = 0.0
        while True:
            raised = diagonal * (1 + self.shift)
            broken, upper, inverse = incomplete_factor(above, raised, drop, relaxation)
            if broken < 0:
                break
            if self.shift * _GROWTH > _LARGEST_SHIFT:
                raise _indefinite(
                    f"its incomplete factor breaks down in row {broken}, even with"
                    f" the diagonal raised by {self.shift:.3g} of itself"
                )
            self.shift = max(self.shift * _GROWTH, _FIRST_SHIFT)
        self._entries = int(upper.nnz)
        self._inverse = inverse
        lower = sparse.csr_array(upper.T.tocsr())
        self._lower, self._upper = _in_quads(lower, kind), _in_quads(upper, kind)
        self.seconds = clock.total

    def __repr__(self) -> str:
        shift = f", shift={self.shift:.1e}" if self.shift else ""
        return f"IncompleteCholesky(n={self.n}, {self._kind}, fill={self.fill}{shift})"

    @property
    def fill(self) -> int:
        """Entries of L below its diagonal."""
        return self._entries

    def solve(self, rhs: Floats) -> Floats:
        """Return the x (n,) of ``(I + L) D (I + L)^T x = rhs``."""
        from spectra_kit._sparse._incomplete_kernels import solve_factor

        out, work = np.empty(self.n), np.empty(self.n)
        values = check_vector("rhs", rhs, self.n)
        solve_factor(*self._lower, *self._upper, self._inverse, values, work, out)
        return out


def _indefinite(reason: str) -> InvalidInputError:
    return InvalidInputError(
        f"`matrix` must be positive semi-definite: {reason}; libigl's cotmatrix has the opposite"
        " sign: pass -L"
    )


def untidy(matrix: sparse.csr_array) -> bool:
    """Return whether neighbours are more than n / 20 places apart on average.

    As in a shuffled mesh, whose incomplete factors gain by another order.
    """
    n = matrix.shape[0]
    own = np.repeat(np.arange(n, dtype=matrix.indices.dtype), np.diff(matrix.indptr))
    return bool(np.abs(matrix.indices - own).mean() > _FAR * n) if matrix.nnz else False


def incomplete_factor(
    above: sparse.csr_array,
    diagonal: Floats,
    drop: float | None,
    relaxation: float,
) -> tuple[int, sparse.csr_array, Floats]:
    """Factorise, in the order given; for those who need the entries themselves.

    `above` holds A above its diagonal, columns ascending; its `diagonal` is overwritten. Returns
    the row of a breakdown (or -1), L^T above its diagonal of ones, and 1 / D.
    """
    from spectra_kit._sparse import _incomplete_kernels as kernels

    inverse = np.empty(len(diagonal))
    if drop is None:
        upper = sparse.csr_array((above.data.copy(), above.indices, above.indptr), above.shape)
        broken = kernels.factor_level_zero(
            above.indptr, above.indices, upper.data, diagonal, relaxation, inverse
        )
        return broken, upper, inverse
    squares = sparse.csr_array((above.data**2, above.indices, above.indptr), above.shape)
    smallest = drop * np.sqrt(squares.sum(axis=0) + squares.sum(axis=1) + diagonal**2)
    broken, starts, columns, values = kernels.factor_threshold(
        above.indptr, above.indices, above.data, diagonal, smallest, relaxation, inverse
    )
    end = starts[-1]
    return broken, sparse.csr_array((values[:end], columns[:end], starts), above.shape), inverse


def _in_quads(
    matrix: sparse.csr_array, kind: np.dtype[np.floating]
) -> tuple[NDArray[np.uint32], NDArray[np.uint32], NDArray[np.floating]]:
    """Return the rows of a matrix in groups of four entries, for `solve_factor`.

    What fills the last group of a row is zero, in the first column of the row, which it reads
    anyway.
    """
    counts = np.diff(matrix.indptr)
    groups = -(-counts // 4)
    quads = np.append(0, np.cumsum(groups))
    first = matrix.indices[matrix.indptr[:-1][counts > 0]].astype(np.uint32)
    columns = np.repeat(first, 4 * groups[counts > 0])
    values = np.zeros(len(columns), kind)
    place = np.arange(matrix.nnz) + np.repeat(4 * quads[:-1] - matrix.indptr[:-1], counts)
    columns[place], values[place] = matrix.indices, matrix.data
    # Unsigned: the compiled loops need not test for negative indices.
    return quads.astype(np.uint32), columns.reshape(-1, 4), values.reshape(-1, 4)
