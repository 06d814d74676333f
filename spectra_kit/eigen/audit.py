"""Hold estimated errors against counts of the eigenvalues: what coarse levels lack shows there."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from spectra_kit._core.types import Floats
from spectra_kit._sparse import SparseLDL
from spectra_kit._sparse.memory import factor_gigabytes
from spectra_kit.eigen.bounds import rounding
from spectra_kit.errors import InvalidInputError
from spectra_kit.operators.laplacian import Laplacian

_WORK = 2**16  # points times counts: a tenth of a second, where smoothing takes some
_FEW = 10_000  # points up to which any operator is counted on
_GIGABYTES = 8.0  # of a factor, at most
_TIMES = (3, 30, 300)  # as large as estimated: what solvers say of themselves, and what is tried
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
        The same, if no count refutes three times as much. Else as many times as counts allow; and
        from the first on that no multiple explains, what the highest shift leaves open below which
        few enough eigenvalues were counted.

    Notes
    -----
    Estimates know nothing of a mode that the columns lack. By Sylvester's law, the negative pivots
    of a factor of ``L - sigma M`` are as many as eigenvalues below sigma: if more than j lie below
    ``values[j] - 3 errors[j]``, the estimate is wrong; if j at most lie below ``values[j] - 30
    errors[j]``, it is by ten times that at most. Of many modes on many points, only some are
    held against counts, evenly spread, and speak for those below them.
    """
    n, k = laplacian.n, len(values)
    counts = min(k, _WORK // n)
    if n > _FEW:
        if not is_hard(laplacian) or factor_gigabytes(n) > _GIGABYTES:
            return errors
        counts = max(counts, 2)
    off = rounding(laplacian)
    claims = values - _TIMES[0] * errors - off
    # Above a mode that is missing, each gap has one more below it; within a cluster none tells.
    some = np.arange(k)
    if counts < k:
        some = np.flatnonzero(claims > np.append(-np.inf, values[:-1]))
    some = some[np.unique(np.linspace(0, len(some) - 1, counts).round().astype(int))]
    floors, numbers = [0.0], [0]  # below each floor, so many eigenvalues at most
    times, shared = np.ones(len(some)), None  # as large as estimated each may be
    for i, j in enumerate(some):
        refuted = False
        for more in _TIMES if np.isfinite(times).all() else _TIMES[:1]:
            shift = values[j] - more * errors[j] - off
            if shift <= 0:
                times[i], refuted = more if more > _TIMES[0] else 1.0, False
                break
            A = sparse.csr_array(laplacian.stiffness - shift * sparse.diags_array(laplacian.mass))
            try:
                factor = SparseLDL(A, definite=False, elimination=shared)
            except InvalidInputError:  # a zero pivot: this shift is as good as an eigenvalue
                continue
            shared, inertia = factor.elimination, factor.inertia
            backward = factor.backward_error(laplacian.mass) if inertia.negative > j else 0.0
            floors.append(shift - backward)
            numbers.append(inertia.negative + inertia.zero)
            refuted = inertia.negative > j and shift + backward < values[j]  # by no rounding
            if inertia.negative <= j:
                times[i] = more if more > _TIMES[0] else 1.0
                break
        if refuted:
            times[i] = np.inf
    if (times == 1).all():
        return errors
    missing = some[np.isinf(times)].min(initial=k)
    sound = some[some < missing].max(initial=-1)  # up to here nothing is missing
    own = np.minimum(np.searchsorted(some, np.arange(k)), len(some) - 1)
    raised = errors * np.where(np.isfinite(times), times, 1.0)[own]
    below = np.array(numbers)[:, None] <= np.arange(k)  # none of these is lower than that floor
    lowest = np.where(below, np.array(floors)[:, None], 0.0).max(axis=0)
    return np.where(np.arange(k) <= sound, raised, np.maximum(errors, values - lowest))
