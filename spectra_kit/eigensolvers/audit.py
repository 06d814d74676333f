"""Hold estimated errors against counts of the eigenvalues: what coarse levels lack shows there."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from spectra_kit._types import Floats
from spectra_kit.eigensolvers.bounds import rounding
from spectra_kit.errors import InvalidInputError
from spectra_kit.linalg import SparseLDL
from spectra_kit.linalg.memory import factor_gigabytes
from spectra_kit.operators.laplacian import Laplacian

_WORK = 2**16  # points times counts: a tenth of a second, where smoothing takes some
_FEW = 10_000  # points up to which any operator is counted on
_GIGABYTES = 8.0  # of a factor, at most
_TRUST = 3  # times too low that estimates may be, as solvers say of themselves
_WIDER = (1, 10, 100)  # times that, to look for what holds before a gap is all that is known
_WEAK = 1e-3  # of the diagonal entries at its ends: an edge that coarse levels may not see as weak
_DECADES = 6  # that masses span where triangles are of one kind


def is_hard(laplacian: Laplacian) -> bool:
    """Whether modes may live where no coarse level looks: counts are worth a factor then.

    Where rows do not sum to zero (a potential, or fixed points beside), masses span many decades,
    or parts hang together by edges that are weak at both ends.
    """
    if not laplacian.kernel_dimension or np.ptp(np.log10(laplacian.mass)) > _DECADES:
        return True
    L = sparse.coo_array(laplacian.stiffness)
    root = np.sqrt(np.maximum(laplacian.stiffness.diagonal(), 0.0))
    strong = np.abs(L.data) > _WEAK * root[L.row] * root[L.col]
    graph = sparse.csr_array((strong[strong], (L.row[strong], L.col[strong])), shape=L.shape)
    return bool(connected_components(graph, directed=False)[0] > laplacian.n_components)


def counted_errors(laplacian: Laplacian, values: Floats, errors: Floats) -> Floats:
    """Return the errors estimated, raised to what counts leave open where these refute them.

    Parameters
    ----------
    laplacian : Laplacian
        Connected, on n points.
    values : ndarray of shape (k,)
        Ritz values, ascending: no eigenvalue is higher.
    errors : ndarray of shape (k,)
        How far they are above, as estimated, in the unit of the values.

    Returns
    -------
    ndarray of shape (k,)
        The same, if no count refutes three times as much. Else each is at least as large as the
        highest shift below which too few eigenvalues were counted leaves open.

    Notes
    -----
    Estimates know nothing of a mode that the columns lack. By Sylvester's law, the negative pivots
    of a factor of ``L - sigma M`` are as many as eigenvalues below sigma: if more than j lie below
    ``values[j] - 3 errors[j]``, the estimate is wrong. Of many modes on many points, only some are
    held against counts, evenly spread.
    """
    n, k = laplacian.n, len(values)
    counts = min(k, _WORK // n)
    if n > _FEW:
        if not is_hard(laplacian) or factor_gigabytes(n) > _GIGABYTES:
            return errors
        counts = max(counts, 2)
    claims = values - _TRUST * errors - rounding(laplacian)
    floors, numbers = [0.0], [0]  # below each floor, so many eigenvalues at most
    refuted, shared = np.zeros(k, dtype=bool), None
    # Above a mode that is missing, each gap has one more below it; within a cluster none tells.
    gaps = np.flatnonzero(claims > np.append(-np.inf, values[:-1]))
    some = gaps if counts < k else np.arange(k)
    for j in some[np.unique(np.linspace(0, len(some) - 1, counts).round().astype(int))[::-1]]:
        if refuted[j]:
            continue
        for shift in values[j] - np.array(_WIDER) * (values[j] - claims[j]):
            if shift <= 0:
                break
            A = sparse.csr_array(laplacian.stiffness - shift * sparse.diags_array(laplacian.mass))
            try:
                factor = SparseLDL(A, definite=False, elimination=shared)
            except InvalidInputError:  # a zero pivot: this shift is as good as an eigenvalue
                break
            shared, inertia, off = factor.elimination, factor.inertia, 0.0
            if inertia.negative > j:  # what refutes must be no rounding
                off = factor.backward_error(laplacian.mass)
                below = np.arange(k) < inertia.negative
                refuted |= below & (claims > shift + off)
                refuted[j] |= shift + off < values[j]
            floors.append(shift - off)
            numbers.append(inertia.negative + inertia.zero)
            if inertia.negative <= j:
                break
    if not refuted.any():
        return errors
    below = np.array(numbers)[:, None] <= np.arange(k)  # none of these is lower than that floor
    lowest = np.where(below, np.array(floors)[:, None], 0.0).max(axis=0)
    held = np.array(numbers)[np.array(numbers) <= refuted.argmax()]  # what is lower lacks nothing
    return np.where(np.arange(k) < held.max(), errors, np.maximum(errors, values - lowest))
