"""`nested_dissection`: an order of elimination for which factors of surfaces stay sparse."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

_LANDMARKS = 6  # more find shorter separators, and take as long as they save
_PASSES = 3  # over a separator, that shorten it
_SIDE = 0.3  # share of the points that lies on each side, unless there is no such separator
_HUB = 10.0  # times the square root of n: neighbours of a point that is left for the end


def nested_dissection(matrix: sparse.csr_array) -> NDArray[np.int32]:
    """Order points so that eliminating them one by one fills in little.

    Parameters
    ----------
    matrix : sparse array of shape (n, n)
        Symmetric; its pattern is the graph. 32-bit indices.

    Returns
    -------
    ndarray of shape (n,), int32
        The points, first eliminated first.

    Notes
    -----
    Few points are found that separate the others into two sides, which are ordered first, in the
    same way (George, *Nested Dissection of a Regular Finite Element Mesh*, SIAM J. Numer. Anal. 10,
    1973); 64 points or fewer by minimum degree. Edges do not jump in the number of hops from a
    landmark, so the points at one number separate the nearer from the farther ones: the best number
    of several landmarks is taken, then shortened (Fiduccia and Mattheyses, *A Linear-Time Heuristic
    for Improving Network Partitions*, DAC 1982).

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> from spectra_kit.linalg.dissection import nested_dissection
    >>> path = sparse.diags_array([1.0, 2.0, 1.0], offsets=[-1, 0, 1], shape=(5, 5), format="csr")
    >>> sorted(nested_dissection(path).tolist())
    [0, 1, 2, 3, 4]
    """
    from spectra_kit.linalg._dissection_kernels import dissect, hops

    degrees = np.diff(matrix.indptr)
    if not len(degrees):
        return np.empty(0, dtype=np.int32)
    hubs = np.flatnonzero(degrees > 16 + _HUB * np.sqrt(len(degrees)))
    if len(hubs):
        others = np.setdiff1d(np.arange(len(degrees)), hubs)
        rest = others[nested_dissection(sparse.csr_array(matrix[others][:, others]))]
        return np.append(rest, hubs).astype(np.int32)
    levels = hops(matrix.indptr, matrix.indices, _LANDMARKS)
    return dissect(matrix.indptr, matrix.indices, levels, _PASSES, _SIDE)
