"""An order of the points in which neighbours are near in memory, too."""

from __future__ import annotations

import numpy as np
from scipy.sparse.csgraph import reverse_cuthill_mckee

from spectra_kit._core.types import Ints
from spectra_kit.operators.laplacian import Laplacian

_WORTH = 2  # times nearer: points of a mesh are in a good order as a rule, those of a cloud in none


def gathered(laplacian: Laplacian) -> tuple[Laplacian, Ints | None]:
    """Return the operator with its points in another order, and which they are.

    By reverse Cuthill-McKee; as it came, and None, where this brings neighbours hardly nearer.

    Examples
    --------
    >>> from spectra_kit import robust_laplacian
    >>> from spectra_kit.geometry import creature, sample
    >>> from spectra_kit.eigen.multigrid.ordering import gathered
    >>> _, order = gathered(robust_laplacian(sample(creature(2000, seed=0), 2000, seed=0)))
    >>> order is None
    False
    """
    matrix = laplacian.stiffness
    rows = np.repeat(np.arange(laplacian.n), np.diff(matrix.indptr))
    order = np.asarray(reverse_cuthill_mckee(matrix, symmetric_mode=True), dtype=np.int64)
    place = np.empty_like(order)
    place[order] = np.arange(laplacian.n)
    before = np.abs(matrix.indices - rows).sum()
    after = np.abs(place[matrix.indices] - place[rows]).sum()
    if before < _WORTH * after:
        return laplacian, None
    return laplacian.restricted(order), order
