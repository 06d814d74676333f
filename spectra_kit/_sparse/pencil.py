"""``L - sigma M`` for one shift after the other: what they share is found once."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from spectra_kit._core.types import Floats, Ints
from spectra_kit._sparse.elimination import Elimination, analysed, no_memory, symmetric
from spectra_kit._sparse.ldl import SparseLDL
from spectra_kit.errors import InvalidInputError


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
