"""Shift-invert Lanczos on sparse factors, exact to rounding: ARPACK, and blocks of our own."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import ArpackError, ArpackNoConvergence, LinearOperator, eigsh

from spectra_kit._core.checked import checked
from spectra_kit._core.clock import Clock
from spectra_kit._core.threads import blas_threads_for
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count, check_positive, quantity
from spectra_kit._sparse.ldl import SparseLDL
from spectra_kit._sparse.memory import factor_gigabytes
from spectra_kit._sparse.shift_invert import shifted_factor
from spectra_kit._sparse.slicing import (
    MOST,
    WIDE,
    Sliced,
    sliced_eigenpairs,
    vectors_for,
    vectors_held,
)
from spectra_kit.eigen.base import Eigenpairs, NotConvergedError, Promise
from spectra_kit.eigen.dense import SPREAD, Dense
from spectra_kit.errors import InvalidInputError
from spectra_kit.operators.laplacian import Laplacian

# Lanczos needs a subspace well above k; below this multiple of it the dense solver is as fast.
_DENSE_RATIO = 3
# Up to so many points, and so many more for each mode, LAPACK is quicker than either on a factor:
# as quick for 24 modes of 250 points, 48 of 350, 96 of 550.
_DENSELY = 150, 4.0
# Modes from which on blocks are faster than one vector at a time, which finds them in a smaller
# space; and modes times points: as fast for 35 modes of 1,500 points, 18 of 2,900, 9 of 6,000.
_MANY, _WORTH = 40, 50_000
_SHIFT = 0.1  # of the spacing of eigenvalues, below the spectrum
_FEWEST = 2 * MOST  # points on which blocks have all the room that they can use
_LEAST, _ROOMY = 500, 2.5  # fewer will do, and so many times as many as vectors find the modes
_WITHIN = 10  # times its error that a negative eigenvalue is zero
_BEYOND = 4  # modes in a gap between which those that are loose are counted
_CLOSE = 1e-6  # residuals up to which counts and bounds tell more of errors than their squares


class _ShiftInvert:
    """What both have: a tolerance, and LAPACK in their place where they have no room."""

    tol: float

    @property
    def promise(self) -> Promise:
        """See `Eigensolver`."""
        return "to tolerance" if self.tol else "exact"

    def _check(self, seed: int) -> None:
        check_count("seed", seed, low=0)
        if not 0 <= self.tol < 1:
            raise InvalidInputError("tol", "be in [0, 1)", self.tol)


class _Inverse(LinearOperator):  # type: ignore[misc]
    """``D A^-1 R`` by a factor of A, of diagonals; hundreds of vectors come, none is looked at."""

    def __init__(self, factor: SparseLDL, right: Floats, left: Floats) -> None:
        super().__init__(np.float64, (factor.n, factor.n))
        self._factor, self._right, self._left = factor, right, left

    def matvec(self, x: Floats) -> Floats:
        """Apply it."""
        return np.asarray(self._left * self._factor.solve(self._right * x))

    _matvec = matvec


@checked
@dataclass(frozen=True, kw_only=True)
class Arpack(_ShiftInvert):
    """ARPACK's Lanczos on a sparse factor, one vector at a time: the reference, for a few modes.

    Where k is more than a third of n, or a cluster stalls one vector on few points, LAPACK solves
    the dense problem instead, and `Lanczos` on many. ``provenance`` says what ran, and why.

    Parameters
    ----------
    tol : float, default 0.0
        Relative accuracy of the eigenvalues of the shift-inverted operator; 0 is machine precision.
    shift : float, default 0.1
        Sigma is -shift * `Laplacian.eigenvalue_spacing`, below the spectrum, and the same for a
        shape in millimetres or metres, at any resolution.
    seed : int, default 0
        Of the start vector: same input and number of threads, same output.
    max_restarts : int, default 1000
        Of Lanczos, before giving up.

    Raises
    ------
    ConvergenceError
        (from `eigensolve`) if `max_restarts` did not suffice; ``partial`` holds what converged.

    Notes
    -----
    Works on the standard form ``M^1/2 (L - sigma M)^-1 M^1/2``, whose largest eigenvalues are
    ``1 / (lambda - sigma)``; where M is no diagonal, in its inner product. Lehoucq, Sorensen and
    Yang, *ARPACK Users' Guide*, 1998.

    Examples
    --------
    >>> from spectra_kit import Arpack, eigensolve, robust_laplacian
    >>> from spectra_kit.geometry import sphere
    >>> laplacian = robust_laplacian(sphere(subdivisions=3).geometry)
    >>> eigensolve(laplacian, 4, Arpack()).eigenvalues[1:].round(2)
    array([2., 2., 2.])
    """

    tol: float = 0.0
    shift: float = _SHIFT
    seed: int = 0
    max_restarts: int = 1000

    def __post_init__(self) -> None:
        check_positive("shift", self.shift)
        check_count("max_restarts", self.max_restarts, low=1)
        self._check(self.seed)

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Eigenpairs:
        """See `Eigensolver.eigenpairs`."""
        if _DENSE_RATIO * k >= laplacian.n:
            return _crowded(laplacian, k)
        sigma = -self.shift * laplacian.eigenvalue_spacing
        clock = Clock()
        weights, elimination = laplacian._weights, laplacian._elimination
        factor = shifted_factor(laplacian.stiffness, weights, sigma, elimination)
        clock.stage("factor")
        # ARPACK takes a Ritz value below eps^(2/3) = 4e-11 for converged when it is so absolutely,
        # not relatively: in units of the spacing they are all far above that, whatever the input's.
        # A power of two near the spacing changes no digit.
        unit = 2.0 ** np.rint(np.log2(laplacian.eigenvalue_spacing))
        root, M = np.sqrt(laplacian.mass), laplacian.consistent_mass
        inverse = _Inverse(factor, root, unit * root)
        asked: dict[str, Any] = {"which": "LA"}
        if M is not None:  # in its inner product, scaled: values come back as lambda / unit
            scale = sparse.diags_array(1 / root)
            asked = {"M": scale @ M @ scale, "OPinv": inverse, "sigma": sigma / unit}

        def told(values: Floats) -> Floats:
            return np.asarray(unit / values + sigma if M is None else unit * values)

        v0 = np.random.default_rng(self.seed).standard_normal(laplacian.n)
        ncv = min(laplacian.n, max(2 * k, k + 20)) if k < _MANY else k + k // 2 + 10
        try:
            with blas_threads_for(laplacian.n * ncv):
                values, vectors = eigsh(
                    inverse,
                    k,
                    v0=v0,
                    ncv=ncv,
                    tol=self.tol,
                    maxiter=self.max_restarts,
                    **asked,
                )
        except ArpackNoConvergence as error:
            values = told(error.eigenvalues)
            pairs = Eigenpairs(values, error.eigenvectors / root[:, None])
            raise NotConvergedError(
                f"ARPACK found {len(error.eigenvalues)} of {quantity(k, 'mode')} in"
                f" {quantity(self.max_restarts, 'restart')}",
                pairs,
                advice=("raise {}", "loosen {}", "use {}"),
                remedies=("max_restarts", "tol", "Refined"),
            ) from error
        except ArpackError:
            why = "ARPACK finds no shift that it could apply, within a wide cluster"
            if laplacian.n < _FEWEST:
                return _densely(laplacian, k, why)
            blocks = Lanczos(tol=self.tol, seed=self.seed)
            return blocks.eigenpairs(laplacian, k)._replace(reason=why)
        clock.stage("lanczos")
        vectors = vectors / root[:, None]
        return Eigenpairs(told(values), vectors, clock.seconds, solver=self)


@checked
@dataclass(frozen=True, kw_only=True)
class Lanczos(_ShiftInvert):
    """Block Lanczos on sparse factors around several shifts: many modes, exact to rounding.

    Spectrum slicing: blocks of vectors are iterated on, around as many shifts as that takes, whose
    factors count the modes between them. Where k is more than a third of n, and on few points,
    LAPACK solves the dense problem instead: blocks have no room there.

    Parameters
    ----------
    tol : float, default 0.0
        Residuals of the shift-inverted operators, relative to their eigenvalues; 0 is machine
        precision, and more than 1e-2 is taken for that. Errors of eigenvalues are about its square:
        1e-2 finds them to 1e-4 and better, in half the time. Where a count finds that modes were
        passed over, it is 1e-6.
    seed : int, default 0
        Of the start vectors: same input, same output.
    max_shifts : int, default 1000
        Factors before giving up.

    Raises
    ------
    ConvergenceError
        (from `eigensolve`) if `max_shifts` did not suffice; ``partial`` holds what converged.

    Notes
    -----
    See `_sparse.slicing.sliced_eigenpairs`, after Grimes, Lewis and Simon, *A shifted block Lanczos
    algorithm for solving sparse symmetric generalized eigenproblems*, 1994.

    Examples
    --------
    >>> from spectra_kit import Lanczos, eigensolve, robust_laplacian
    >>> from spectra_kit.geometry import sphere
    >>> laplacian = robust_laplacian(sphere(subdivisions=4).geometry)
    >>> eigensolve(laplacian, 60, Lanczos()).eigenvalues[1:4].round(2)
    array([2., 2., 2.])
    """

    tol: float = 0.0
    seed: int = 0
    max_shifts: int = 1000

    def __post_init__(self) -> None:
        check_count("max_shifts", self.max_shifts, low=1)
        self._check(self.seed)

    @staticmethod
    def memory(n: int, k: int, dimension: int = 2) -> float:
        """Estimate the memory, in GiB, that k modes on n points of one component take; or `Arpack`.

        Factor, vectors and modes together, the operator not. Of several components it is the
        largest of theirs, of small ones the sum over as many as there are threads, and 8 bytes for
        each number of the modes of the others. Factors
        in a volume, whose `dimension` is 3, are much larger.
        """
        if _DENSE_RATIO * k >= n:
            return 3 * 8 * n**2 / 2**30  # the matrix, its copy in LAPACK, eigenvectors
        return factor_gigabytes(n, dimension) + 8 * n * vectors_held(k) / 2**30

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Eigenpairs:
        """See `Eigensolver.eigenpairs`."""
        if _DENSE_RATIO * k >= laplacian.n:
            return _crowded(laplacian, k)
        if not _has_room(laplacian.n, k):
            return _densely(laplacian, k, f"{laplacian.n} points are few")
        clock, elimination = Clock(), laplacian._elimination
        clock.stage("factor")
        solved = partial(
            sliced_eigenpairs,
            laplacian.stiffness,
            laplacian._weights,
            below=-_SHIFT * laplacian.eigenvalue_spacing,
            spacing=laplacian.eigenvalue_spacing,
            most_shifts=self.max_shifts,
            seed=self.seed,
            elimination=elimination,
            power=2 / laplacian.dimension,
        )
        seconds = Counter(clock.seconds)
        if self.tol > _CLOSE:
            found, clock = solved(k + _BEYOND, tol=self.tol), Clock()
            whole = _has_all(found, k)
            clock.stage("count")
            seconds += Counter(found.seconds) + Counter(clock.seconds)
            if whole:
                pairs = _estimated(found, k, laplacian.eigenvalue_spacing)
                return pairs._replace(seconds=dict(seconds), solver=self)
        tol = min(self.tol, _CLOSE)
        found = solved(k, tol=tol)
        seconds += Counter(found.seconds)
        if len(found.eigenvalues) < k and found.shifts < self.max_shifts:  # a cluster stops it
            found = solved(k, tol=tol, block=WIDE)
            seconds += Counter(found.seconds)
        pairs = Eigenpairs(found.eigenvalues, found.eigenvectors, dict(seconds), solver=self)
        if len(pairs.eigenvalues) == k:
            return pairs
        told = (
            f"Lanczos found {len(pairs.eigenvalues)} of {quantity(k, 'mode')} around"
            f" {quantity(found.shifts, 'shift')}"
        )
        if found.shifts < self.max_shifts:
            told += "; more equal eigenvalues than it has room for do this"
            if laplacian.n < _FEWEST:
                return _densely(laplacian, k, told)
            raise NotConvergedError(told, pairs, advice="use {}", remedies=("Dense",))
        raise NotConvergedError(
            told, pairs, advice=("raise {}", "use {}"), remedies=("max_shifts", "Refined")
        )


def _has_all(found: Sliced, k: int) -> bool:
    """Whether the first k modes are surely all there are, by a count in the widest gap beyond.

    The squares of residuals tell nothing of a copy of an eigenvalue that was passed over.
    """
    values = found.eigenvalues
    if len(values) < k + _BEYOND:
        return False
    number = k + int(np.diff(values[k - 1 :]).argmax())
    factor = found.pencil.factor(float(values[number - 1 : number + 1].mean()))
    return factor is not None and factor.inertia.negative == number


def _estimated(found: Sliced, k: int, spacing: float) -> Eigenpairs:
    """Return the first k of loose modes with their errors, which put none below the spectrum."""
    values, off = found.eigenvalues[:k], found.errors[:k]
    values = np.where((values < 0) & (-values <= _WITHIN * off), 0.0, values)
    vectors = np.ascontiguousarray(found.eigenvectors[:, :k])
    return Eigenpairs(values, vectors, errors=off / np.maximum(values, spacing))


def _has_room(n: int, k: int) -> bool:
    """Return whether blocks have room on n points."""
    return n >= min(_FEWEST, max(_LEAST, _ROOMY * vectors_for(k, 0.0)))


def _crowded(laplacian: Laplacian, k: int) -> Eigenpairs:
    """Return the modes where they are so many that Lanczos has no room."""
    if laplacian.n > Dense.max_points:
        raise InvalidInputError(
            "k",
            f"be less than a third of the {laplacian.n} points, where Lanczos has room",
            k,
            advice="ask for fewer modes",
        )
    return _densely(laplacian, k, f"{laplacian.n} points are few for {quantity(k, 'mode')}")


def _densely(laplacian: Laplacian, k: int, reason: str) -> Eigenpairs:
    """Return what LAPACK finds instead, and say so."""
    dense = Dense()
    return dense.eigenpairs(laplacian, k)._replace(solver=dense, reason=reason)


def cheapest(n: int, k: int, *, tol: float = 0.0, seed: int = 0) -> Dense | Arpack | Lanczos:
    """Return what is quickest: LAPACK on few points, one vector for few modes, else blocks."""
    few, each = _DENSELY
    if n <= few + each * k and not tol:
        return Dense()
    return _on_factor(n, k, tol=tol, seed=seed)


def _on_factor(n: int, k: int, *, tol: float = 0.0, seed: int = 0) -> Arpack | Lanczos:
    if (k >= _MANY or n * k >= _WORTH) and _has_room(n, k):
        return Lanczos(tol=tol, seed=seed)
    return Arpack(tol=tol, seed=seed)


def or_densely(
    solver: Dense | Arpack | Lanczos, laplacian: Laplacian, k: int, reason: str, *, seed: int = 0
) -> Eigenpairs:
    """Return what the `cheapest` finds, or another where that is better; says which, and why.

    LAPACK where Lanczos gives up on few points; not where it would round the lowest eigenvalues by
    what the largest are.
    """
    if isinstance(solver, Dense):
        largest = 2 * float((laplacian.stiffness.diagonal() / laplacian._diagonal).max())
        if largest <= SPREAD * laplacian.eigenvalue_spacing:
            return solver.eigenpairs(laplacian, k)._replace(solver=solver, reason=reason)
        solver = _on_factor(laplacian.n, k, seed=seed)
    try:
        pairs = solver.eigenpairs(laplacian, k)
    except NotConvergedError as error:
        if laplacian.n > Dense.few:
            raise
        why = f"{laplacian.n} points are few, and Lanczos gave up ({error})"
        return _densely(laplacian, k, why)
    return pairs._replace(reason=reason) if pairs.solver is solver else pairs
