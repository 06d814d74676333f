"""`Elimination`: all of a sparse factor that the pattern of a matrix decides."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from spectra_kit._core.threads import thread_count
from spectra_kit._sparse._checks import check_matrix, check_symmetric
from spectra_kit.errors import InvalidInputError, OutOfMemoryError

# Neighbours of a point that is left for the end: times the square root of n, and at least. As in
# AMD (Amestoy, Davis and Duff, Algorithm 837, ACM TOMS 30, 2004).
_HUB, _FEWEST = 10.0, 16
# Of what a solve does at most, a subtree does so much. Two threads have 1.6 to 1.75 times the speed
# of one then, four 2.3 to 2.8, eight 3.0 to 3.4, counted on four models; with twice as much two
# have 1.7 to 1.76, eight 2.7 to 3.0. None where all of it takes a fraction of a millisecond.
_SHARE, _WORTH = 1 / 8, 1 << 17


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
    order, lists = np.empty(n, np.int32), np.empty(2 * matrix.nnz + n, np.int32)
    longs, ints = np.zeros((4, n), np.int64), np.full((11, n + 1), -1, np.int32)
    state = np.zeros(5, np.int64)
    while needed := eliminate(*pattern(matrix), order, lists, longs, ints, state):
        lists = np.concatenate([lists, np.empty(2 * needed - len(lists), np.int32)])
    return order


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
    `subtrees`, of shape (t, 2), are ranges of runs that need nothing of the others, which threads
    may do side by side. `work` is what a solve does in each, and `sizes`, of shape (t + 1, 2), are
    those of memory that the numbers need while they are made, in each, and last in all one after
    the other. What they add to rows outside of them is kept apart: `places` are the rows of their
    runs, where those `outside` are counted from n on.
    """

    starts: NDArray[np.int32]
    columns: NDArray[np.int32]
    order: NDArray[np.int32]
    begins: NDArray[np.int32]
    first: NDArray[np.int64]
    rows: NDArray[np.int32]
    above: NDArray[np.int32]
    panels: NDArray[np.int64]
    subtrees: NDArray[np.int64]
    work: NDArray[np.int64]
    sizes: NDArray[np.int64]
    places: NDArray[np.int32]

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
        shared = sum(int(getattr(self, part.name).nbytes) for part in fields(self))
        from spectra_kit._sparse._frontal_kernels import WIDE

        n, own = len(self.order), self.sizes.sum(axis=1)
        own += n + ((4 + 3 * WIDE) * np.sqrt(self.sizes[:, 0])).astype(np.int64)
        beside = int(np.sort(own[:-1])[-thread_count() :].sum())
        numbers = self.fill + 4 * n + max(beside, int(own[-1])) + int(self.updates[-1])
        return (8 * numbers + shared) / 2**30

    @property
    def fill(self) -> int:
        """Entries that a factor holds below its diagonal; some of them are zero."""
        return int(self.panels[-1])

    @property
    def longest(self) -> int:
        """The most rows that a front has."""
        return math.isqrt(int(self.sizes[-1, 0]))

    @cached_property
    def runs(self) -> tuple[Any, ...]:
        """Arrays that a solve asks for, for which there is no other word than their names."""
        return self.order, self.begins, self.first, self.places, self.panels, self.outside

    @property
    def _heads(self) -> NDArray[np.int64]:
        """The last run of each subtree, whose rows are all that are outside of it."""
        return self.subtrees[:, 1] - 1

    @cached_property
    def outside(self) -> NDArray[np.int32]:
        """Rows outside of subtrees, one after the other."""
        none = np.zeros(0, np.int32)
        return np.concatenate(
            [none, *(self.rows[self.first[s] : self.first[s + 1]] for s in self._heads)]
        )

    @cached_property
    def updates(self) -> NDArray[np.int64]:
        """Where the numbers begin that each subtree has for the runs above it; (t + 1,)."""
        rows = np.diff(self.first)[self._heads]
        return np.append(0, np.cumsum(rows * (rows + 1) // 2))

    @cached_property
    def rest(self) -> NDArray[np.int64]:
        """Ranges of runs that are in no subtree; (t + 1, 2)."""
        ends = np.concatenate([[0], self.subtrees.ravel(), [len(self.begins) - 1]])
        return ends.reshape(-1, 2).astype(np.int64)

    def side_by_side(self, count: int) -> list[NDArray[np.intp]]:
        """Deal the subtrees out to so many threads, which then have about the same to do.

        Returns which each has; none where there is none.
        """
        hands: list[list[int]] = [[] for _ in range(count)]
        held = [0] * count
        for i in np.argsort(-self.work, kind="stable").tolist():
            least = held.index(min(held))
            hands[least].append(i)
            held[least] += int(self.work[i])
        return [np.array(sorted(hand)) for hand in hands if hand]

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
    from spectra_kit._sparse import _tree_kernels as kernels

    if A.nnz > _MAX_ENTRIES:
        raise InvalidInputError("matrix", f"have at most {_MAX_ENTRIES} entries", A.nnz)
    starts, columns = pattern(A)
    n = A.shape[0]
    order, parent, below = (np.empty(n, np.int32) for _ in range(3))
    kernels.elimination_tree(
        starts, columns, minimum_degree(A), order, parent, below, *np.empty((6, n), np.int32)
    )
    kept = np.empty((2, n + 1), np.int32)
    begins = kept[1, : kernels.supernodes(parent, below, *kept)][::-1].copy()
    ends = begins[1:] - 1  # the last column of each
    width = np.diff(begins).astype(np.int64)
    first = np.append(0, np.cumsum(below[ends], dtype=np.int64))
    rows, above = np.empty(first[-1], np.int32), np.empty(len(width), np.int32)
    kernels.front_rows(
        starts,
        columns,
        order,
        parent,
        begins,
        rows,
        above,
        first.copy(),
        *np.empty((3, n), np.int32),
    )
    under = np.diff(first)
    updates = under * (under + 1) // 2
    taken = np.bincount(above + 1, updates, len(width) + 1)[1:]  # from those below
    fronts, waiting = (width + under) ** 2, updates - taken.astype(np.int64)
    panels = np.append(0, np.cumsum(width * (width - 1) // 2 + width * under))
    whole = np.diff(panels) + 3 * (width + under)  # rows are fetched and put back
    most = int(_SHARE * whole.sum()) if whole.sum() >= _WORTH else 0
    places, found = rows.copy(), np.empty((len(width), 2), np.int64)
    fixed = (begins, first, rows, above, whole, most, found, places, *np.empty((2, n), np.int64))
    subtrees = found[: kernels.find_subtrees(*fixed)].copy()
    sizes = np.array(
        [
            [part.max(initial=0) for part in (fronts[a:b], waiting[a:b].cumsum())]
            for a, b in [*subtrees.tolist(), (0, len(width))]
        ]
    )
    own = whole[subtrees[:, 1] - 1]
    head = (starts, columns, order, begins, first, rows, above, panels)
    return Elimination(*head, subtrees, own, sizes, places)


def no_memory(n: int) -> OutOfMemoryError:
    """Return the error of a factor that is too large."""
    return OutOfMemoryError(
        f"the factor of {n} unknowns does not fit into memory; use a method without one, such as"
        " Cascade() or geodesics.Iterative()"
    )
