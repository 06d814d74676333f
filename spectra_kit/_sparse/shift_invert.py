"""Chebyshev-accelerated block shift-invert iterations: any start, driven to any residual."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from spectra_kit._core.clock import Clock
from spectra_kit._core.threads import in_threads, shares, single_threaded_blas
from spectra_kit._core.types import Floats, Singles
from spectra_kit._sparse.elimination import Elimination
from spectra_kit._sparse.inverse_norms import inverse_squares, least_eigenvalue
from spectra_kit._sparse.ldl import SparseLDL
from spectra_kit._sparse.orthonormal import RankError
from spectra_kit._sparse.pencil import Pencil
from spectra_kit._sparse.products import residuals, spmm, weighed
from spectra_kit._sparse.ritz import ritz_pairs, ritz_rotation
from spectra_kit.errors import InvalidInputError

_COLUMNS = 80  # filtered together, at most: bounds the temporaries
_SHIFT = 1 / 8  # of the guard eigenvalue: strong on the last modes, kind to float32 on the first
_STALLED = 0.7  # a sweep that leaves more than this of the best residuals gains nothing,
_STILL = 1e-12  # unless it lowers the sum of the Ritz values by more than this share: a mode rises
_RANK_TOL = 1e-6  # of a start: one Gram matrix tells, sweeps do the rest
_FILTERED_TOL = 1e-12  # of what was filtered: what little is left of a mode far up is all there is
_ZERO = 1e-8  # of the spacing: a block of Ritz values below it may be rounding, of any sign
_PROBES = 8  # random columns that bring in modes of which the start has nothing
_OUTGROWN = 1 / 4  # a shift this many times larger than wanted, or smaller, wants a new factor


class Refinement(NamedTuple):
    """What `shift_invert_iteration` reached, and whether it `stalled` at rounding."""

    eigenvalues: Floats
    eigenvectors: Floats
    residuals: Floats  # ||L u - lambda M u|| in the M^-1 norm
    sweeps: int
    stalled: bool
    seconds: dict[str, float]


def shifted_factor(
    stiffness: sparse.csr_array,
    mass: Floats | sparse.csr_array,
    sigma: float,
    elimination: Elimination | None = None,
) -> SparseLDL:
    """Factorise ``L - sigma M``, positive definite for sigma < 0."""
    if isinstance(mass, sparse.csr_array):
        shifted = Pencil(stiffness, mass, elimination).shifted(sigma)
    else:
        shifted = sparse.csr_array(stiffness - sigma * sparse.diags_array(mass))
    try:
        return SparseLDL(shifted, elimination=elimination)
    except InvalidInputError as error:
        raise InvalidInputError(
            "stiffness",
            f"be positive semi-definite, but with {-sigma:.3g} M added to it a Cholesky factor does"
            " not exist",
            advice="is its sign right, and is it symmetric?",
        ) from error


def shift_invert_iteration(
    stiffness: sparse.csr_array,
    mass: Floats | sparse.csr_array,
    start: NDArray[np.floating],
    k: int,
    *,
    tolerance: Callable[[Floats], Floats],
    spacing: float,
    block: int,
    degree: int = 4,
    max_sweeps: int = 30,
    seed: int = 0,
    elimination: Elimination | None = None,
) -> Refinement:
    """Drive the span of `start` to the k lowest eigenpairs of ``L u = lambda M u``.

    Until the residual norm of each Ritz value is at most `tolerance` of it. Of the `block` Ritz
    vectors those beyond k guard the last wanted ones; random columns make up for what the start
    lacks. At least one filter of this `degree`, which is
    the number of solves of each column, is applied to whatever start. Eigenvalues far below the
    `spacing` are taken for zero.

    A sweep applies a Chebyshev polynomial p of ``T = (L - sigma M)^-1 M`` that is small on the
    eigenvalues of T beyond the guard and large on the wanted ones (Zhou, Saad, Tiago and
    Chelikowsky, *Self-consistent-field calculations using Chebyshev-filtered subspace iteration*,
    2006, with T in place of the operator), then Rayleigh-Ritz. For a Ritz pair
    (theta, x) with residual r, ``p(T) x / p(mu) = x + f`` with ``mu = 1 / (theta - sigma)``, and f
    obeys the three-term recurrence of p driven by ``-mu (L - sigma M)^-1 r``. Only f is computed
    by the factor: its relative accuracy is all that counts, so float32 suffices down to the
    last digit of float64.

    Residuals do not tell whether a mode is missing of which the start holds nothing: so the first
    sweep also filters a few random columns, at twice the degree, and lets them join the block.
    """
    clock = Clock()
    # With a mean mass of one, float32 holds every unit of length. Eigenvalues are times `unit`.
    diagonal = mass if isinstance(mass, np.ndarray) else mass.diagonal()
    unit = float(diagonal.mean())
    mass = mass / unit
    norms_of = _Residuals(stiffness, mass)
    factor: SparseLDL | None = None
    sigma = 0.0  # below the spectrum, with a factor
    rng = np.random.default_rng(seed)

    def ritz(columns: NDArray[np.floating], rank_tol: float) -> tuple[Floats, Floats]:
        """Return the Ritz pairs of a whole block; noise makes up for what the columns lack.

        Where the eigenvalues jump within the block, the filter drowns columns in the modes below.
        """
        try:
            values, X, _ = ritz_pairs(stiffness, mass, columns, block, rank_tol=rank_tol)
        except RankError:  # zeros alone, such as columns that live on another component
            X = np.empty((len(diagonal), 0))
        if X.shape[1] < block:
            X = np.hstack([X, _noise(rng, mass, block - X.shape[1])])
            values, X = ritz_rotation(stiffness, mass, X)
        return values, X

    values, X = ritz(start, _RANK_TOL)
    clock.stage("rayleigh_ritz")
    R, norms = norms_of(values, X)
    clock.stage("residuals")
    best, sweeps, idle = norms[:k], 0, 0
    while True:
        open_modes = norms[:k] > unit * tolerance(values[:k] / unit)
        done = not open_modes.any() and sweeps > 0
        if done or sweeps == max(max_sweeps, 1) or idle == 2:
            break
        # A little above the last Ritz value: the cluster that it may belong to must grow.
        # And not among values that are zero to rounding: a shift must be below them all.
        guard = max(float(values[-1]), _ZERO * unit * spacing) * (1 + 2 / block)
        wanted = _SHIFT * guard
        if factor is None or not _OUTGROWN < wanted / -sigma < 1 / _OUTGROWN:
            factor, sigma = shifted_factor(stiffness, mass, -wanted, elimination), -wanted
            elimination = factor.elimination
            clock.stage("factor")
        shifted = factor, sigma, guard, degree
        probes = _filtered_noise(*shifted, mass, X, rng) if sweeps == 0 else None
        # Guard columns move with the wanted ones; wanted ones that have converged stay.
        active = np.flatnonzero(np.concatenate([open_modes, np.full(block - k, True)]))
        for part in np.array_split(active, -(-len(active) // _COLUMNS)):
            X[:, part] += _correction(*shifted, mass, R[:, part], values[part])
        clock.stage("filter")
        trace = values[:k].sum()
        try:
            if probes is not None:  # they may lie in the corrected block up to little
                values, X = ritz(np.hstack([X, probes]), _RANK_TOL)
            else:
                values, X = ritz_rotation(stiffness, mass, X)
        except InvalidInputError:
            values, X = ritz(X, _FILTERED_TOL)
        clock.stage("rayleigh_ritz")
        R, norms = norms_of(values, X)
        clock.stage("residuals")
        sweeps += 1
        fell = values[:k].sum() < (1 - _STILL) * trace
        # Against the best so far: where they are rounding, residuals fall as often as they rise.
        gained = (norms[:k] <= _STALLED * best)[open_modes].any()
        # Where the values fell, other modes may have moved into these places.
        best = norms[:k] if fell else np.minimum(best, norms[:k])
        idle = 0 if fell or gained else idle + 1
    return Refinement(
        values[:k] / unit,
        X[:, :k] / np.sqrt(unit),
        norms[:k] / unit,
        sweeps,
        idle == 2,
        clock.seconds,
    )


class _Residuals:
    """Residuals of pairs, in float32, and their norms."""

    def __init__(self, stiffness: sparse.csr_array, mass: Floats | sparse.csr_array) -> None:
        self._stiffness, self._mass = stiffness, mass
        self._least = 1.0
        if isinstance(mass, sparse.csr_array):
            self._least = least_eigenvalue(mass)

    def __call__(self, values: Floats, X: Floats) -> tuple[Singles, Floats]:
        if isinstance(self._mass, np.ndarray):
            return residuals(self._stiffness, self._mass, values, X)
        R = spmm(self._stiffness, X) - spmm(self._mass, X) * values
        squares = inverse_squares(self._mass, R, self._least)
        return R.astype(np.float32), np.sqrt(squares)


def _unit_columns(mass: Floats | sparse.csr_array, X: Floats) -> Floats:
    """Return columns of unit M-norm."""
    return np.asarray(X / np.sqrt(np.einsum("ij,ij->j", X, weighed(mass, X))))


def _noise(rng: np.random.Generator, mass: Floats | sparse.csr_array, columns: int) -> Floats:
    """Return random columns of unit M-norm."""
    return _unit_columns(mass, rng.standard_normal((mass.shape[0], columns)))


def _filtered_noise(
    factor: SparseLDL,
    sigma: float,
    guard: float,
    degree: int,
    mass: Floats | sparse.csr_array,
    X: Floats,
    rng: np.random.Generator,
) -> Floats:
    """Return the low modes in a few random columns, of unit norm and orthogonal to X."""
    gain = np.float32(2 * (guard - sigma))
    columns = _noise(rng, mass, _PROBES)
    for _ in range(2):  # in between, what grew most is taken out: float32 drowns in it
        old = columns.astype(np.float32)
        new = gain * factor.solve(weighed(mass, old), dtype=np.float32) - old
        for _ in range(degree - 1):
            solved = factor.solve(weighed(mass, new), dtype=np.float32)
            old, new = new, 2 * (gain * solved - new) - old
        columns = new.astype(np.float64)
        with single_threaded_blas():
            for _ in range(2):  # once leaves what cancellation leaves
                columns -= X @ (X.T @ weighed(mass, columns))
            columns = _unit_columns(mass, columns)
    return columns


def _correction(
    factor: SparseLDL,
    sigma: float,
    guard: float,
    degree: int,
    mass: Floats | sparse.csr_array,
    R: Singles,
    values: Floats,
) -> Singles:
    """Return what the filter of this `degree`, normalised to 1 at `values`, adds to each column."""
    from spectra_kit._sparse._kernels import chebyshev_step

    gain = 2 * (guard - sigma)  # T is mapped so that [0, 1 / (guard - sigma)] becomes [-1, 1]
    mu = 1 / (values - sigma)
    x = gain * mu - 1
    p_before, p = np.ones_like(x), x  # Chebyshev polynomials of degree j - 1 and j at x
    solved = factor.solve(R, dtype=np.float32)
    first = np.float32(-gain * mu) * solved
    correction = first / np.float32(x)
    previous = np.zeros_like(first)
    diagonal = isinstance(mass, np.ndarray)
    weights = mass.astype(np.float32) if diagonal else np.ones(len(R), np.float32)
    solved = weighed(mass, correction)
    cuts = shares(len(R))
    for _ in range(degree - 1):
        solved = factor.solve(solved, dtype=np.float32)
        p_next = 2 * x * p - p_before
        a, b, c = (np.float32(q / p_next) for q in (2 * p, p_before, 2 * p))
        fixed = (solved, correction, previous, first, weights, gain, a, b, c)
        in_threads(chebyshev_step, ((*fixed, *rows) for rows in cuts))
        if not diagonal:
            solved = weighed(mass, solved)
        p_before, p = p, p_next
    return correction
