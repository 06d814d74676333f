"""Sparse LDL^T factorisation, solved with many right-hand sides at once."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray
from scipy import sparse

from spectra_kit._core.threads import (
    WORTH_SHARING,
    in_threads,
    ranges,
    shares,
    single_threaded,
    single_threaded_blas,
    thread_count,
)
from spectra_kit._core.types import Floats
from spectra_kit._sparse.elimination import Elimination, analysed, no_memory, symmetric
from spectra_kit._sparse.products import real_dtype
from spectra_kit.errors import InvalidInputError

# Steps towards the x that makes a bound sharpest, at most: each costs two products. One that takes
# less than a share of it is the last: on six models what all eight take is a quarter more at most.
_BALANCING, _SHARPER = 8, 0.2
_EPS = float(np.finfo(np.float64).eps)


class Inertia(NamedTuple):
    """Numbers of negative, zero and positive eigenvalues of a symmetric matrix."""

    negative: int
    zero: int
    positive: int

    @classmethod
    def of(cls, pivots: Floats, diagonal: Floats) -> Inertia:
        """Of the pivots of a factor, each beside the diagonal entry that it was made from.

        One within rounding of that entry, n times 2e-16 of it, counts as zero.
        """
        n = len(pivots)
        zero = np.abs(pivots) <= n * _EPS * np.abs(diagonal)
        negative = int((~zero & (pivots < 0)).sum())
        return cls(negative, int(zero.sum()), n - negative - int(zero.sum()))


class SparseLDL:
    """``A = P (I + L) D (I + L)^T P^T``, computed once, solved for any number of right-hand sides.

    Both triangles of A are stored. Unless it is to be `definite`, pivots of either sign are
    accepted as they come: nothing is pivoted for stability, so look at `backward_error`. The
    `elimination` of a matrix with the same pattern saves finding it, which takes about as long as
    the factor itself. `pivots` are the diagonal of D, in the order of elimination.

    A multifrontal factorisation in the order of `minimum_degree`; eight right-hand sides take less
    than twice the time of one, so give it all there are at once. Compiled loops release the
    interpreter lock, in threads. The bits of a solution depend neither on the number of threads nor
    on the other right-hand sides. On meshes of 20,000 and 100,000 vertices, with one thread, the
    CHOLMOD of the wheel cholespy 2.2.0 takes 2.1 and 2.3 times as long for a factor.
    """

    def __init__(
        self,
        matrix: sparse.csr_array,
        *,
        definite: bool = True,
        elimination: Elimination | None = None,
    ) -> None:
        A = symmetric(matrix)
        if elimination is not None and not elimination.serves(A):
            raise InvalidInputError("elimination", "have the pattern of `matrix`", "another")
        try:
            known = analysed(A) if elimination is None else elimination
        except MemoryError as error:
            raise no_memory(A.shape[0]) from error
        self._factorise(A.data, A.diagonal(), known, definite)

    @classmethod
    def of_entries(
        cls, entries: Floats, diagonal: Floats, elimination: Elimination, *, definite: bool
    ) -> SparseLDL:
        """Factorise a symmetric matrix by its entries in the pattern of an elimination."""
        factor = cls.__new__(cls)
        factor._factorise(entries, diagonal, elimination, definite)
        return factor

    def _factorise(
        self, entries: Floats, diagonal: Floats, known: Elimination, definite: bool
    ) -> None:
        from spectra_kit._sparse._frontal_kernels import factorise

        self.n: int = len(known.order)
        self.elimination = known
        try:
            self._lower, self.pivots = np.empty(known.fill), np.empty(self.n)
            place, spots = np.empty(self.n, np.int32), known.updates
            place[known.order] = np.arange(self.n, dtype=np.int32)
            fixed = (
                known.starts,
                known.columns,
                np.require(entries, None, "W"),  # loops are compiled for what can be written to
                known.order,
                known.begins,
                known.first,
                known.rows,
                known.above,
                known.panels,
                known.subtrees,
                place,
                self._lower,
                self.pivots,
                np.empty(spots[-1]),
                spots,
            )

            def some(*which: int) -> int:
                return max(factorise(*fixed, i, *_scratch(known, i)) for i in which)

            with single_threaded_blas():  # so that no bit depends on its threads
                hands = map(tuple, known.side_by_side(thread_count()))
                bad = max(in_threads(some, hands), default=-1)
                if bad < 0:
                    bad = some(len(known.subtrees))
        except MemoryError as error:
            raise no_memory(self.n) from error
        if bad >= 0:
            raise InvalidInputError(
                "`matrix` has no factor without pivoting (the pivot of row"
                f" {known.order[bad]} is zero or not finite); it is singular, or needs another"
                " shift"
            )
        self._inverse = 1 / self.pivots
        # What elimination takes from a diagonal entry is a sum of up to n terms, no larger in all
        # than the entry where the matrix is definite (Higham, Accuracy and Stability, ch. 3).
        self._diagonal = diagonal[known.order]
        rounding = self.n * _EPS * np.abs(self._diagonal)
        if definite and (bad := int((self.pivots <= rounding).sum())):
            raise InvalidInputError(
                "matrix",
                "be symmetric positive definite",
                f"{bad} of {self.n} pivots that are negative or zero to rounding (smallest"
                f" {self.pivots.min():.3g})",
            )

    @property
    def fill(self) -> int:
        """Entries of L below its diagonal."""
        return len(self._lower)

    @property
    def lower(self) -> sparse.csc_array:
        """L without its diagonal of ones, in the order of elimination."""
        from spectra_kit._sparse._frontal_kernels import factor_columns

        known = self.elimination
        starts, rows = np.empty(self.n + 1, np.int64), np.empty(known.fill, np.int32)
        factor_columns(known.begins, known.first, known.rows, starts, rows)
        return sparse.csc_array((self._lower, rows, starts), (self.n, self.n))

    @property
    def inertia(self) -> Inertia:
        """Signs of the eigenvalues of the factorised matrix, by Sylvester's law."""
        return Inertia.of(self.pivots, self._diagonal)

    def backward_error(self, weight: Floats) -> float:
        """Bound how far the product of the factors is from the matrix.

        At least ``||W^-1/2 (A - P (I + L) D (I + L)^T P^T) W^-1/2||`` in the 2-norm, with the
        positive `weight` (n,) as diagonal W. By it `inertia` is certain: the negative eigenvalues
        of ``A + bound W`` are no more than those it counts, and those of ``A - bound W`` no fewer.
        Infinite if it overflows.

        Each entry of the difference is at most ``c u |I + L| |D| |I + L|^T``, with the unit
        roundoff u and c a little above the longest row of L (Higham, *Accuracy and Stability of
        Numerical Algorithms*, 2002, ch. 11): large where a pivot was small. The norm of that
        non-negative matrix N is at most ``max (N x) / x`` for any x > 0 (Collatz and Wielandt).
        """
        lower = abs(self.lower)
        upper = lower.T  # another object each time that it is asked for
        longest = int(np.bincount(lower.indices, minlength=1).max())
        scale = 1 / np.sqrt(weight[self.elimination.order])
        x = 1 / scale
        bound = np.inf
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(_BALANCING):
                y = scale * x
                y = np.abs(self.pivots) * (y + upper @ y)
                product = scale * (y + lower @ y)
                before, bound = bound, min(bound, float((product / x).max()))
                if bound > (1 - _SHARPER) * before:
                    break
                x = np.sqrt(x * product)
        # _EPS is 2 u: twice what is needed, for the rounding of this bound and of A.
        return (longest + 6) * _EPS * bound if np.isfinite(bound) else np.inf

    def solve(self, rhs: NDArray[np.floating], *, dtype: DTypeLike = np.float64) -> NDArray[Any]:
        """Solve for one right-hand side (n,) or several (n, s); any order but C is copied.

        In float32, of arithmetic and solution, it takes half the memory and time; the error is some
        1e-7 times the condition of A.
        """
        from spectra_kit._sparse._lane_kernels import DOWN, LANES, MEET, UP, solve_lanes

        real = real_dtype("dtype", dtype)
        if np.iscomplexobj(rhs):
            raise InvalidInputError("rhs", "be real", np.asarray(rhs).dtype)
        rhs = np.require(rhs, real, ["C", "W"])
        if rhs.ndim not in (1, 2) or len(rhs) != self.n:
            raise InvalidInputError("rhs", f"have shape ({self.n},) or ({self.n}, s)", rhs.shape)
        lower, inverse = self._single if real == np.float32 else (self._lower, self._inverse)
        out, known = np.empty(rhs.shape, real), self.elimination
        columns, rows = rhs.size // max(self.n, 1), self.n + len(known.outside)
        block = (rhs.reshape(self.n, columns), out.reshape(self.n, columns))
        fixed = (*known.runs, lower, inverse, *block)
        cuts = shares(columns, -(-columns // LANES)) if columns else []
        beside = thread_count() if columns * self.fill >= WORTH_SHARING else 1
        dealt = known.side_by_side(beside if len(cuts) < beside else 1)
        hands = [known.subtrees[which] for which in dealt]

        lanes = () if columns == 1 else (LANES,)  # one as ARPACK asks, thousands of times

        def part(y: NDArray[Any], *asked: Any) -> None:
            work = np.empty((known.longest, *lanes), real)
            solve_lanes(*(*fixed, y, y.reshape(-1), work, *asked))

        def solve(*cut: int) -> None:
            y = np.empty((rows, *lanes), real)
            y[self.n :] = 0
            for some, what in ((hands, DOWN), ([known.rest], DOWN | MEET | UP), (hands, UP)):
                in_threads(part, ((y, one, what, *cut) for one in some))

        if beside == 1 or len(hands) > 1:
            for cut in cuts:
                solve(*cut)
        else:
            in_threads(solve, cuts)
        return out

    def solve_rows(self, rhs: Floats) -> Floats:
        """Do the same for right-hand sides that are rows, (s, n), to the bit.

        Eight of them turned are at hand for their solve, which takes a third less time.
        """
        from spectra_kit._sparse._lane_kernels import LANES

        out = np.empty(rhs.shape)

        def some(left: int, right: int) -> None:
            with single_threaded():
                out[left:right] = self.solve(rhs[left:right].T).T

        in_threads(some, ranges(len(rhs), LANES))
        return out

    @cached_property
    def _single(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """L and 1 / D in float32, kept after the first use."""
        return self._lower.astype(np.float32), self._inverse.astype(np.float32)


def _scratch(known: Elimination, subtree: int) -> tuple[NDArray[Any], ...]:
    """Return arrays for `factorise` to work in, each kind of which would take long to compile."""
    from spectra_kit._sparse._frontal_kernels import WIDE

    front, waiting = map(np.empty, known.sizes[subtree])
    longest = math.isqrt(len(front))
    local, behind = np.empty((2, len(known.order)), np.int32)
    parts = np.empty((3, WIDE * longest))
    return (local, behind, front, waiting, np.empty((4, longest)), *parts)
