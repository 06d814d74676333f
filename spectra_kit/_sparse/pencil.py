"""``L - sigma M`` for one shift after the other: what they share is found once."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from spectra_kit._core.types import Floats
from spectra_kit._sparse.elimination import analysed, no_memory, symmetric
from spectra_kit._sparse.ldl import SparseLDL
from spectra_kit.errors import InvalidInputError


class Pencil:
    """Factors of ``L - sigma M`` for a symmetric L and a diagonal M (n,) that is positive."""

    def __init__(self, stiffness: sparse.csr_array, mass: Floats) -> None:
        shifted = symmetric(sparse.csr_array(stiffness + sparse.diags_array(mass)))
        n = shifted.shape[0]
        rows = np.repeat(np.arange(n), np.diff(shifted.indptr))
        self._diagonal = np.flatnonzero(shifted.indices == rows)
        self._entries, self._mass = shifted.data.copy(), mass
        self._entries[self._diagonal] = stiffness.diagonal()
        try:
            self._elimination = analysed(shifted)
        except MemoryError as error:
            raise no_memory(n) from error

    def factor(self, sigma: float) -> SparseLDL | None:
        """Factorise ``L - sigma M``; nothing where a pivot is zero, as close to an eigenvalue."""
        entries = self._entries.copy()
        diagonal = entries[self._diagonal] - sigma * self._mass
        entries[self._diagonal] = diagonal
        try:
            return SparseLDL.of_entries(entries, diagonal, self._elimination, definite=False)
        except InvalidInputError:
            return None
