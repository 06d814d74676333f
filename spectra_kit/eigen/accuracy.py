"""How far eigenvalues are off: proved by smoothing and by gaps, estimates held against counts."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import quantity
from spectra_kit._core.warn import warn
from spectra_kit._sparse.host import inner
from spectra_kit._sparse.ldl import Inertia
from spectra_kit._sparse.memory import factor_gigabytes
from spectra_kit._sparse.pencil import Pencil
from spectra_kit._sparse.products import spmm
from spectra_kit._sparse.ritz import ritz_pairs
from spectra_kit.eigen.base import Eigensolver
from spectra_kit.eigen.certificate import Certificate
from spectra_kit.eigen.multigrid.estimates import in_order
from spectra_kit.eigen.multigrid.smoothing import smoothed
from spectra_kit.eigen.spectrum import Spectrum
from spectra_kit.errors import DoubtfulSpectrumWarning
from spectra_kit.operators.laplacian import Laplacian

#: Eigenvalues that are too high by more than this, relative to the true ones, are told.
DOUBTFUL = 0.1
_ESTIMATED = 0.03  # errors estimated to be below need no proof: estimates are better than this
_DEGREE = 12  # sparse products; twice as many prove hardly more
_SMOOTHED = 32  # smoothed at a time, for the sake of memory


def with_excess(certificate: Certificate, spectrum: Spectrum, laplacian: Laplacian) -> Certificate:
    """Return the certificate of a spectrum with its `excess`, where it leaves doubts without it."""
    if certificate.errors is not None and (certificate.errors <= _ESTIMATED).all():
        return certificate  # these come from smoothing, too
    # Some true eigenvalue lies within the residual of each: smaller ones leave nothing to prove.
    if not (certificate.relative_residuals > DOUBTFUL).any():
        return certificate
    return replace(certificate, excess=proved_excess(spectrum, laplacian))


def proved_excess(spectrum: Spectrum, laplacian: Laplacian) -> Floats:
    """Return by how much each eigenvalue is too high at least, relative to the true one; (k,).

    The j-th Ritz value of *any* functions is at least the j-th eigenvalue (Courant and Fischer).
    So where those of the smoothed modes are lower, the modes were too high by the difference, if
    not by more: what smoothing does not find, such as a mode that is missing altogether, is not
    proved.
    """
    values, vectors = spectrum.eigenvalues, spectrum.eigenvectors
    if len(laplacian.fixed):
        vectors = vectors[laplacian.free]
        laplacian = laplacian.restricted(laplacian.free)
    smooth = np.empty(vectors.shape)
    for start in range(0, spectrum.k, _SMOOTHED):
        block = slice(start, start + _SMOOTHED)
        smooth[:, block] = smoothed(laplacian, values[block], vectors[:, block], degree=_DEGREE)
    lower = ritz_pairs(laplacian.stiffness, laplacian._weights, smooth, spectrum.k).eigenvalues
    excess = np.zeros(spectrum.k)
    told = slice(laplacian.kernel_dimension, len(lower))
    excess[told] = np.maximum(values[told] / lower[told] - 1, 0.0)
    return excess


def verdict(spectrum: Spectrum) -> str:
    """Say in a line which eigenvalues are far too high, proved or estimated; nothing if none is."""
    certificate = spectrum.certificate
    if certificate is None:
        return ""
    for known, by in (("proved", certificate.excess), ("estimated", certificate.errors)):
        if by is not None and (high := by > DOUBTFUL).any():
            worst = int(by.argmax())
            return (
                f"{known} to be more than {DOUBTFUL:.0%} too high: {high.sum()} of"
                f" {quantity(spectrum.k, 'eigenvalue')}, that of mode {worst} by {by[worst]:.0%}"
                f" {'or more' if known == 'proved' else 'or so'}"
            )
    return ""


def warn_of_doubts(spectrum: Spectrum, solver: Eigensolver, *, where: str = "") -> None:
    """Warn of what is doubtful of a solver's spectrum, if it is approximate.

    That is what `verdict` says, and that the solver's target was missed. Of many spectra, `where`
    says which it is.
    """
    if spectrum.provenance.accuracy in ("exact", "to tolerance"):
        return
    if told := verdict(spectrum):
        warn(
            told,
            DoubtfulSpectrumWarning,
            advice="smooth it by {}, go on from it by {}, or take an exact solver such as {}",
            remedies=("Cascade", "Refined", "Arpack"),
            where=where,
        )
    certificate = spectrum.certificate
    errors = None if certificate is None else certificate.errors
    target, steps = getattr(solver, "target", None), spectrum.provenance.iterations
    if target is None or errors is None or not steps:  # without steps nothing was aimed at
        return
    if (left := float(errors.mean())) > target:
        warn(
            f"target = {target:g} was not reached: {quantity(steps, 'step')} of smoothing left"
            " errors that are"
            f" estimated at {left:.1e} in the mean",
            DoubtfulSpectrumWarning,
            advice=("raise {}", "use {}"),
            remedies=("max_steps", "Arpack"),
            where=where,
        )


_EPS = float(np.finfo(np.float64).eps)
_CLUSTER = 4  # times their residuals: eigenvalues that are closer are one cluster
_COLUMNS = 64  # of L @ U at once, about


def with_bounds(certificate: Certificate, spectrum: Spectrum, laplacian: Laplacian) -> Certificate:
    """Return the certificate of a spectrum with its `errors`, unless it knows them better.

    Of modes that a count has verified they are bounds. It stays as it is where residuals are as
    large as those of predictions, which tell nothing.

    Of eigenvalues in a cluster with residuals R of Frobenius norm ``|R|`` and Rayleigh quotients in
    the matrix G, none is off by more than ``|G - diag(theta)| + |R|^2 / gap``, with the gap to
    all eigenvalues of the operator outside of the cluster (Kato and Temple; for clusters, Mathias,
    *Quadratic residual bounds for the Hermitian eigenvalue problem*, 1998). Those that were found
    are within ``radius`` of true ones, and these within ``|R|`` of those of the complement: both
    are taken off the gap. Where none is left, the bound is the linear one.
    """
    if not spectrum.k or certificate.relative_residuals.max() > DOUBTFUL:
        return certificate
    least = error_units(certificate, spectrum.eigenvalues, laplacian)
    bounded, errors = np.arange(spectrum.k) < certificate.n_verified, certificate.errors
    if errors is None or bounded.any():
        own = _absolute(certificate, spectrum, laplacian) / least
        bounded &= True if errors is None else own < errors
        errors = own if errors is None else np.where(bounded, own, errors)
    mixed = in_order(spectrum.eigenvalues, errors * least) / least
    errors = np.where(bounded, errors, mixed)
    return replace(certificate, errors=errors, bounded=bounded)


def error_units(certificate: Certificate, values: Floats, laplacian: Laplacian) -> Floats:
    """Return what errors of the eigenvalues are relative to, as residuals are, in 1/length^2."""
    relative = certificate.relative_residuals
    some = np.where(relative > 0, relative, 1.0)
    known, least = certificate.residuals / some, laplacian.eigenvalue_spacing
    return np.where(relative > 0, known, np.maximum(values, least))


def _absolute(certificate: Certificate, spectrum: Spectrum, laplacian: Laplacian) -> Floats:
    """Return how far the eigenvalues are off, in 1/length^2."""
    values, k = spectrum.eigenvalues, spectrum.k
    count, residuals = certificate.count, certificate.residuals
    verified = certificate.n_verified
    radius = count.radius if count else 0.0
    least = laplacian._rounding
    alone = np.diff(values) > _CLUSTER * (residuals[1:] + residuals[:-1])
    last = np.append(np.flatnonzero(alone) + 1, k)  # of each cluster, and one more
    first = np.append(0, last[:-1])
    skew, apart = _inexactness(first, last, spectrum, laplacian)
    skew += (1 + apart) ** 2 * apart * values[last - 1]
    size = (1 + apart) * np.sqrt(np.add.reduceat(residuals**2, first))
    # What no count has told is taken to be no nearer than it is on average, here or in all.
    room = min(laplacian.eigenvalue_spacing, (values[-1] - values[0]) / max(k - 1, 1))
    floor = count.floor if count and verified else values[-1] + room
    below = np.append(np.inf, values[first[1:]] - values[first[1:] - 1])
    higher = np.where(last < (verified or k), values[np.minimum(last, k - 1)], floor)
    gap = np.minimum(below, higher - values[last - 1]) - radius - size
    quadratic = np.full(len(gap), np.inf)
    np.divide(size**2, gap, out=quadratic, where=gap > 0)
    cluster = np.repeat(np.arange(len(first)), last - first)
    sure = np.arange(k) < verified
    linear = np.where(sure, radius, residuals)
    # Of a cluster that was counted in part, nothing quadratic is proved.
    unproved = sure & (last[cluster] > verified)
    quadratics = np.where(unproved, np.inf, (skew + quadratic)[cluster])
    return np.asarray(np.minimum(linear, quadratics) + least * sure)


def _inexactness(
    first: Ints, last: Ints, spectrum: Spectrum, laplacian: Laplacian
) -> tuple[Floats, Floats]:
    """Return ``|U^T L U - diag(theta)|`` and ``|U^T M U - I|`` of each cluster."""
    values, products = spectrum.eigenvalues, spectrum._products
    # Each mode by itself, as most are: what clusters have is written over it.
    longer = products.diagonal()[first] - 1
    apart = np.abs(longer)
    skew = np.abs(values[first] * longer + spectrum._rest_along(laplacian)[first])
    cluster, many = np.repeat(np.arange(len(first)), last - first), np.flatnonzero(last - first > 1)
    cuts = np.flatnonzero(np.diff(first[many] // _COLUMNS)) + 1
    for some in np.split(many, cuts) if len(many) else ():  # clusters that are looked at together
        columns = np.flatnonzero(np.isin(cluster, some))
        inside, U = cluster[columns], np.ascontiguousarray(spectrum.eigenvectors[:, columns])
        off = inner(U, spmm(laplacian.stiffness, U)) - np.diag(values[columns])
        unlike = products[np.ix_(columns, columns)] - np.eye(len(columns))
        within, starts = inside[:, None] == inside, np.searchsorted(inside, some)
        for error, sums in ((off, skew), (unlike, apart)):
            rows = np.where(within, error**2, 0.0).sum(axis=1)
            sums[some] = np.sqrt(np.add.reduceat(rows, starts))
    return skew, apart


_WORK = 2**16  # points times counts: a tenth of a second, or twice as many in a half of it
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

    The operator is connected. The values are Ritz values, ascending: no eigenvalue is higher. Their
    errors (k,), in the same unit, stay as they are if no count refutes three times as much. Else
    they become as many times as large as counts allow; and from the first on that no multiple
    explains, what the highest shift leaves open below which few enough eigenvalues were counted.

    Estimates know nothing of a mode that the columns lack. By Sylvester's law, the negative pivots
    of a factor of ``L - sigma M`` are as many as eigenvalues below sigma: if more than j lie below
    ``values[j] - 3 errors[j]``, the estimate is wrong; if j at most lie below ``values[j] - 30
    errors[j]``, it is by ten times that at most. Of many modes on many points, only some are
    held against counts, evenly spread, and speak for those below them; where memory ends, no more.
    """
    n, k = laplacian.n, len(values)
    many = n > _FEW
    if many and (not is_hard(laplacian) or factor_gigabytes(n, laplacian.dimension) > _GIGABYTES):
        return errors
    try:
        pencil = Pencil(laplacian.stiffness, laplacian._weights)
    except MemoryError:
        return errors
    counts = max(min(k, _WORK // n * (1 + pencil.quick)), 2 * many)
    off = laplacian._rounding
    claims = values - _TIMES[0] * errors - off
    # Above a mode that is missing, each gap has one more below it; within a cluster none tells.
    some = np.arange(k)
    if counts < k:
        some = np.flatnonzero(claims > np.append(-np.inf, values[:-1]))
    some = some[np.unique(np.linspace(0, len(some) - 1, counts).round().astype(int))]
    floors, numbers = [0.0], [0]  # below each floor, so many eigenvalues at most
    times, i, refuted = np.ones(len(some)), 0, False  # as large as estimated each may be
    try:
        together: dict[int, Inertia | None] = {}
        if pencil.quick:
            positive = some[claims[some] > 0]
            with suppress(MemoryError):  # one by one they take less
                inertias = pencil.inertias(claims[positive])
                together = dict(zip(positive.tolist(), inertias, strict=True))
        for i, j in enumerate(some):
            refuted = False
            for more in _TIMES if np.isfinite(times).all() else _TIMES[:1]:
                shift = values[j] - more * errors[j] - off
                if shift <= 0:
                    times[i], refuted = more if more > _TIMES[0] else 1.0, False
                    break
                inertia, backward = together.get(j) if more == _TIMES[0] else None, 0.0
                if inertia is None or inertia.negative > j:
                    if (factor := pencil.factor(shift)) is None:
                        continue
                    inertia = factor.inertia
                    if inertia.negative > j:
                        backward = factor.backward_error(laplacian._diagonal)
                        backward /= laplacian._least_weight
                floors.append(shift - backward)
                numbers.append(inertia.negative + inertia.zero)
                refuted = inertia.negative > j and shift + backward < values[j]  # by no rounding
                if inertia.negative <= j:
                    times[i] = more if more > _TIMES[0] else 1.0
                    break
            if refuted:
                times[i] = np.inf
    except MemoryError:  # the modes are there, and must not be lost for it; what is counted holds
        some, times = some[: i + refuted], times[: i + refuted]
        times[i:] = np.inf
    if (times == 1).all():
        return errors
    missing = some[np.isinf(times)].min(initial=k)
    sound = some[some < missing].max(initial=-1)  # up to here nothing is missing
    own = np.minimum(np.searchsorted(some, np.arange(k)), len(some) - 1)
    raised = errors * np.where(np.isfinite(times), times, 1.0)[own]
    below = np.array(numbers)[:, None] <= np.arange(k)  # none of these is lower than that floor
    lowest = np.where(below, np.array(floors)[:, None], 0.0).max(axis=0)
    return np.where(np.arange(k) <= sound, raised, np.maximum(errors, values - lowest))
