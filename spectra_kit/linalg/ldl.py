"""Sparse LDL^T factorisation, solved with many right-hand sides at once."""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray
from scipy import sparse

from spectra_kit._types import Floats
from spectra_kit._validate import quantity
from spectra_kit.errors import InvalidInputError, OutOfMemoryError
from spectra_kit.linalg._checks import check_matrix
from spectra_kit.linalg.products import real_dtype
from spectra_kit.linalg.threads import in_threads, shares, thread_count

_WIDE = 64  # columns solved together: more gain nothing, and cost memory in each thread
_NARROW = 8  # fewer than these are not worth a thread of their own
_BALANCING = 8  # steps towards the x that makes a bound sharpest; each costs two products
_EPS = float(np.finfo(np.float64).eps)


class Inertia(NamedTuple):
    """Numbers of negative, zero and positive eigenvalues of a symmetric matrix."""

    negative: int
    zero: int
    positive: int


class SparseLDL:
    """``A = P (I + L) D (I + L)^T P^T``, computed once, solved for any number of right-hand sides.

    Parameters
    ----------
    matrix : sparse array of shape (n, n)
        A, symmetric; only its upper triangle is read.
    definite : bool, default True
        Refuse a matrix that is not positive definite. Without it, pivots of either sign are
        accepted as they come: nothing is pivoted for stability, so look at `backward_error`.

    Attributes
    ----------
    n : int
        Size of the matrix.
    pivots : ndarray of shape (n,)
        The diagonal of D, in the order of elimination.
    fill : int
        Entries of L below its diagonal.

    Raises
    ------
    InvalidInputError
        If `matrix` is not square, not finite, singular, or not positive definite where that is
        asked; from `solve`, if `rhs` has another number of rows or `dtype` is another.
    OutOfMemoryError
        If the factor does not fit into memory.

    Notes
    -----
    Ordered by approximate minimum degree and factorised by QDLDL (Stellato et al., *OSQP*, 2020);
    solved by compiled loops, with up to 64 right-hand sides in a row of memory and one such
    block for each thread. The bits of a solution depend neither on the number of threads nor on
    the other right-hand sides. For blocks; `SparseCholesky` is faster with one column at a time.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> from spectra_kit.linalg import SparseLDL
    >>> factor = SparseLDL(sparse.csr_array([[2.0, -1.0], [-1.0, 2.0]]))
    >>> factor.solve(np.array([1.0, 1.0]))
    array([1., 1.])
    >>> SparseLDL(sparse.csr_array([[1.0, 2.0], [2.0, 1.0]]), definite=False).inertia
    Inertia(negative=1, zero=0, positive=1)
    """

    def __init__(self, matrix: sparse.csr_array, *, definite: bool = True) -> None:
        import qdldl

        upper = sparse.csc_matrix(sparse.triu(check_matrix(matrix), format="csc"))
        diagonal = upper.diagonal()
        if not diagonal.all():  # qdldl wants every diagonal entry stored
            raise _singular(f"its diagonal has {quantity((diagonal == 0).sum(), 'zero')}")
        try:
            lower, pivots, order = qdldl.Solver(upper, upper=True).factors()
        except (RuntimeError, MemoryError) as error:
            if "factorization" in str(error):  # of the numbers; all else it reports is memory
                raise _singular("a pivot is zero") from error
            raise OutOfMemoryError(
                f"the factor of {matrix.shape[0]} unknowns does not fit into memory; use a method"
                " without one, such as Cascade()"
            ) from error
        self.n: int = matrix.shape[0]
        self.pivots: Floats = np.asarray(pivots)
        self._order = np.asarray(order, dtype=np.int64)
        self._starts = lower.indptr.astype(np.int64)
        self._rows = lower.indices.astype(np.uint32)  # unsigned: no test for negative indices
        self._groups = _groups(self._starts, self._rows)
        self._lower: Floats = lower.data
        with np.errstate(divide="ignore"):
            self._inverse = 1 / self.pivots
        self._diagonal = diagonal[self._order]
        if not (np.isfinite(self._inverse).all() and np.isfinite(self.pivots).all()):
            raise _singular("a pivot is infinite")
        if definite and not (self.pivots > _EPS * self._diagonal).all():
            raise InvalidInputError(
                "matrix",
                "be symmetric positive definite",
                f"{int((self.pivots <= _EPS * self._diagonal).sum())} of {self.n} pivots that are"
                f" negative or zero to rounding (smallest {self.pivots.min():.3g})",
            )

    @property
    def fill(self) -> int:
        """Entries of L below its diagonal."""
        return len(self._lower)

    @property
    def inertia(self) -> Inertia:
        """Signs of the eigenvalues of the factorised matrix, by Sylvester's law.

        A pivot within rounding of its own diagonal entry counts as zero.
        """
        zero = np.abs(self.pivots) <= _EPS * np.abs(self._diagonal)
        negative = int((~zero & (self.pivots < 0)).sum())
        return Inertia(negative, int(zero.sum()), self.n - negative - int(zero.sum()))

    def backward_error(self, weight: Floats) -> float:
        """Bound how far the product of the factors is from the matrix.

        Parameters
        ----------
        weight : ndarray of shape (n,)
            Positive: W, diagonal.

        Returns
        -------
        float
            At least ``||W^-1/2 (A - P (I + L) D (I + L)^T P^T) W^-1/2||`` (2-norm), by which
            `inertia` is certain: the negative eigenvalues of ``A + bound W`` are no more than
            those it counts, and those of ``A - bound W`` no fewer. Infinite if it overflows.

        Notes
        -----
        Each entry of the difference is at most ``c u |I + L| |D| |I + L|^T``, with the unit
        roundoff u and c a little above the longest row of L (Higham, *Accuracy and Stability of
        Numerical Algorithms*, 2002, ch. 11): large where a pivot was small. The norm of that
        non-negative matrix N is at most ``max (N x) / x`` for any x > 0 (Collatz and Wielandt).
        """
        lower = sparse.csc_array((np.abs(self._lower), self._rows, self._starts), (self.n, self.n))
        longest = int(np.bincount(self._rows, minlength=1).max())
        scale = 1 / np.sqrt(weight[self._order])
        x = 1 / scale
        bound = np.inf
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(_BALANCING):
                y = scale * x
                y = np.abs(self.pivots) * (y + lower.T @ y)
                product = scale * (y + lower @ y)
                bound = min(bound, float((product / x).max()))
                x = np.sqrt(x * product)
        # _EPS is 2 u: twice what is needed, for the rounding of this bound and of A.
        return (longest + 6) * _EPS * bound if np.isfinite(bound) else np.inf

    def solve(self, rhs: NDArray[np.floating], *, dtype: DTypeLike = np.float64) -> NDArray[Any]:
        """Solve ``A x = rhs``.

        Parameters
        ----------
        rhs : ndarray of shape (n,) or (n, s)
            C order is read as it is, any other is copied.
        dtype : {float64, float32}, default float64
            Of the arithmetic and of the solution. float32 halves memory and time; its error is
            some 1e-7 times the condition of A.

        Returns
        -------
        ndarray of the shape of `rhs`

        Raises
        ------
        InvalidInputError
            If `rhs` has another number of rows, or `dtype` is neither of the two.
        """
        from spectra_kit.linalg._kernels import solve_columns

        real = real_dtype("dtype", dtype)
        rhs = np.ascontiguousarray(rhs, dtype=real)
        if rhs.ndim not in (1, 2) or len(rhs) != self.n:
            raise InvalidInputError("rhs", f"have shape ({self.n},) or ({self.n}, s)", rhs.shape)
        lower, inverse = self._single if real == np.float32 else (self._lower, self._inverse)
        out = np.empty(rhs.shape, real)
        factor = (self._starts, self._rows, lower, inverse, self._groups, self._order)
        columns = rhs.size // self.n
        block = (rhs.reshape(self.n, columns), out.reshape(self.n, columns))
        blocks = max(-(-columns // _WIDE), min(thread_count(), -(-columns // _NARROW)))
        cuts = shares(columns, blocks) if columns else []
        in_threads(solve_columns, ((*factor, *block, *cut) for cut in cuts))
        return out

    @cached_property
    def _single(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """L and 1 / D in float32, kept after the first use."""
        return self._lower.astype(np.float32), self._inverse.astype(np.float32)


def _groups(starts: NDArray[np.int64], rows: NDArray[np.uint32]) -> NDArray[np.int64]:
    """Return where to cut the columns of L into runs, at most four long, of equal rows below."""
    n = len(starts) - 1
    counts = np.diff(starts)
    below = np.full(n, -1)
    below[counts > 0] = rows[starts[:-1][counts > 0]]
    # In an elimination tree, a parent with one row less has just these rows.
    joined = (below[:-1] == np.arange(1, n)) & (counts[:-1] == counts[1:] + 1)
    runs = np.flatnonzero(np.r_[True, ~joined])
    place = np.arange(n) - np.repeat(runs, np.diff(np.r_[runs, n]))
    return np.append(np.flatnonzero(place % 4 == 0), n)


def _singular(why: str) -> InvalidInputError:
    return InvalidInputError(
        f"`matrix` has no factor without pivoting ({why}); it is singular, or needs another shift"
    )
