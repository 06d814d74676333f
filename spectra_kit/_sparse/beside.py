"""``python -m spectra_kit._sparse.beside``: compile what a factor needs, while it is ordered.

On the smallest matrix whose elimination is known without the loops that find it.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from spectra_kit._sparse.elimination import Elimination
from spectra_kit._sparse.ldl import SparseLDL
from spectra_kit._sparse.products import spmm


def main() -> None:
    """Do it, in the order in which the loops are needed; solves are compiled where they are."""
    matrix = sparse.csr_array(np.ones((1, 1)))
    none, one = np.empty(0, np.int32), np.array([0, 1], np.int32)
    known = Elimination(
        starts=one,
        columns=one[:1].copy(),
        order=one[:1].copy(),
        begins=one,
        first=np.zeros(2, np.int64),
        rows=none,
        above=np.full(1, -1, np.int32),
        panels=np.zeros(2, np.int64),
        sizes=np.array([1, 0]),
    )
    factor = SparseLDL(matrix, elimination=known)
    spmm(matrix, np.ones((1, 2)))
    _ = factor.lower


if __name__ == "__main__":
    main()
