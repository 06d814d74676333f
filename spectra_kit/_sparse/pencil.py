"""``L - sigma M`` for one shift after the other: what they share is found once."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from spectra_kit._core.threads import in_threads, ranges
from spectra_kit._core.types import Floats, Ints
from spectra_kit._sparse.elimination import Elimination, analysed, no_memory, symmetric
from spectra_kit._sparse.ldl import Inertia, SparseLDL
from spectra_kit.errors import InvalidInputError

_LONGEST = 256  # rows of a front, above which BLAS takes one shift after the other in less time


class Pencil:
    """Factors of ``L - sigma M`` for symmetric L and M; of a diagonal M, (n,), that is positive.

    The `elimination` of a pencil with the same pattern saves finding it.
    """

    def __init__(
        self,
        stiffness: sparse.csr_array,
        mass: Floats | sparse.csr_array,
        elimination: Elimination | None = None,
    ) -> None:
        n = stiffness.shape[0]
        if isinstance(mass, sparse.csr_array):
            pattern = symmetric(sparse.csr_array(abs(stiffness) + abs(mass)))
            self._entries = _entries_in(pattern, stiffness)
            self._mass, self._place = _entries_in(pattern, mass), np.arange(pattern.nnz)
            self._diagonal = _diagonal_of(pattern)
        else:
            known = elimination is not None and elimination.serves(stiffness)
            pattern = stiffness if known else symmetric(stiffness)
            self._place = _diagonal_of(pattern)
            if len(self._place) < n:
                lift = 1 + np.abs(stiffness.diagonal() / mass).max()  # no entry becomes zero
                pattern = symmetric(sparse.csr_array(stiffness + lift * sparse.diags_array(mass)))
                self._place = _diagonal_of(pattern)
            self._mass, self._entries = mass, pattern.data.copy()
            self._entries[self._place] = stiffness.diagonal()
            self._diagonal = self._place
        self._pattern = pattern
        try:
            if elimination is None or not elimination.serves(pattern):
                elimination = analysed(pattern)
        except MemoryError as error:
            raise no_memory(n) from error
        self.elimination = elimination

    def shifted(self, sigma: float) -> sparse.csr_array:
        """Return ``L - sigma M``, with an entry for each that the pattern has."""
        shifted = self._pattern.copy()
        shifted.data = self._at(sigma)
        return shifted

    def factor(self, sigma: float) -> SparseLDL | None:
        """Factorise ``L - sigma M``; nothing where a pivot is zero, as close to an eigenvalue."""
        entries = self._at(sigma)
        diagonal = entries[self._diagonal]
        try:
            return SparseLDL.of_entries(entries, diagonal, self.elimination, definite=False)
        except InvalidInputError:
            return None

    @property
    def quick(self) -> bool:
        """Whether `inertias` takes less time than a factor for each shift."""
        return self.elimination.longest <= _LONGEST

    def inertias(self, shifts: Floats) -> list[Inertia | None]:
        """Return the inertia of ``L - sigma M`` at each shift; nothing where a pivot is zero.

        Eight of them take little longer than one factor, where this is `quick`.
        """
        from spectra_kit._sparse._lane_kernels import LANES, shifted_pivots

        known, n = self.elimination, len(self._diagonal)
        order, place, mass = known.order, np.empty(n, np.int32), np.zeros_like(self._entries)
        place[order], mass[self._place] = np.arange(n, dtype=np.int32), self._mass
        stiff, heavy = (entries[self._diagonal][order] for entries in (self._entries, mass))
        pattern = known.starts, known.columns, self._entries, mass, order
        runs = known.begins, known.first, known.rows, known.above, place

        def some(left: int, right: int) -> list[Inertia | None]:
            lanes, pivots = np.zeros((3, LANES)), np.empty((n, LANES))
            lanes[0, : right - left], lanes[1] = shifts[left:right], 1.0
            held = (np.empty((size, LANES)) for size in known.sizes[-1])
            shifted_pivots(*pattern, *runs, lanes, pivots, *np.empty((2, n), np.int32), *held)
            found = zip(shifts[left:right], pivots.T, strict=False)
            good = (np.isfinite(pivots) & (pivots != 0)).all(axis=0)
            return [
                Inertia.of(own, stiff - sigma * heavy) if fine else None
                for fine, (sigma, own) in zip(good, found, strict=False)
            ]

        return [one for part in in_threads(some, ranges(len(shifts), LANES)) for one in part]

    def _at(self, sigma: float) -> Floats:
        entries: Floats = self._entries.copy()
        entries[self._place] -= sigma * self._mass
        return entries


def _entries_in(pattern: sparse.csr_array, matrix: sparse.csr_array) -> Floats:
    """Return the entries of a matrix in a pattern that holds its own, zeros elsewhere."""
    n, found = pattern.shape[0], np.zeros(pattern.nnz)
    keys, own = (
        np.repeat(np.arange(n), np.diff(one.indptr)) * n + one.indices for one in (pattern, matrix)
    )
    found[np.searchsorted(keys, own)] = matrix.data
    return found


def _diagonal_of(matrix: sparse.csr_array) -> Ints:
    """Return where diagonal entries are stored."""
    rows = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    return np.flatnonzero(matrix.indices == rows)
