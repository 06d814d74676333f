"""``L - sigma M`` for one shift after the other: what they share is found once."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from spectra_kit._core.types import Floats, Ints
from spectra_kit._sparse.elimination import Elimination, analysed, no_memory, symmetric
from spectra_kit._sparse.ldl import SparseLDL
from spectra_kit.errors import InvalidInputError


class Pencil:
    """Factors of ``L - sigma M`` for a symmetric L and a diagonal M (n,) that is positive.

    The `elimination` of a pencil with the same pattern saves finding it.
    """

    def __init__(
        self, stiffness: sparse.csr_array, mass: Floats, elimination: Elimination | None = None
    ) -> None:
        n = stiffness.shape[0]
        known = elimination is not None and elimination.serves(stiffness)
        pattern = stiffness if known else symmetric(stiffness)
        self._diagonal = _diagonal_of(pattern)
        if len(self._diagonal) < n:
            lift = 1 + np.abs(stiffness.diagonal() / mass).max()  # no entry becomes zero
            pattern = symmetric(sparse.csr_array(stiffness + lift * sparse.diags_array(mass)))
            self._diagonal = _diagonal_of(pattern)
        self._pattern, self._mass = pattern, mass
        self._entries = pattern.data.copy()
        self._entries[self._diagonal] = stiffness.diagonal()
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
        entries[self._diagonal] -= sigma * self._mass
        return entries


def _diagonal_of(matrix: sparse.csr_array) -> Ints:
    """Return where diagonal entries are stored."""
    rows = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    return np.flatnonzero(matrix.indices == rows)
