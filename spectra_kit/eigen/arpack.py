"""Shift-invert Lanczos on sparse factors: the reference backend."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.sparse.linalg import ArpackError, ArpackNoConvergence, LinearOperator, eigsh

from spectra_kit._core.checked import checked
from spectra_kit._core.clock import Clock
from spectra_kit._core.threads import blas_threads_for
from spectra_kit._core.validate import check_count, check_positive, quantity
from spectra_kit._sparse.memory import factor_gigabytes
from spectra_kit._sparse.shift_invert import shifted_factor
from spectra_kit._sparse.slicing import MOST, WIDE, sliced_eigenpairs, vectors_held
from spectra_kit.eigen.base import Eigenpairs, NotConvergedError, Promise
from spectra_kit.eigen.dense import Dense
from spectra_kit.errors import InvalidInputError
from spectra_kit.operators.laplacian import Laplacian

# Lanczos needs a subspace well above k; below this multiple of it the dense solver is as fast.
_DENSE_RATIO = 3
# Modes from which on blocks are faster than one vector at a time. For 20 both cost the same, and
# one vector finds room on any number of points.
_MANY = 40


@checked
@dataclass(frozen=True, kw_only=True)
class Arpack:
    """Shift-invert Lanczos, exact to rounding: ARPACK for a few modes, spectrum slicing for many.

    From 40 modes on, blocks of vectors are iterated on, around as many shifts as that takes, whose
    factors count the modes between them. Where k is more than a third of n, or a cluster stalls one
    vector on few points, LAPACK solves the dense problem instead: Lanczos has no room there, and
    the answer is the same.

    Parameters
    ----------
    tol : float, default 0.0
        Relative accuracy of the eigenvalues of the shift-inverted operator; 0 is machine precision.
        From 40 modes on 1e-6 at most, whatever is asked for: with looser residuals, what is found
        around one shift would not be orthogonal to what is found around the next.
    shift : float, default 0.1
        Of a few modes: sigma is -shift * `Laplacian.eigenvalue_spacing`, below the spectrum, and
        the same for a shape in millimetres or metres, at any resolution. The shifts of many modes
        are amid these, and all above that one.
    seed : int, default 0
        Of the start vectors: same input and number of threads, same output.
    max_restarts : int, default 1000
        Lanczos restarts, of many modes shifts, before giving up.

    Raises
    ------
    InvalidInputError
        If a parameter is out of range.
    ConvergenceError
        (from `eigensolve`) if `max_restarts` did not suffice; ``partial`` holds what converged.

    Notes
    -----
    Works on the standard form ``M^1/2 (L - sigma M)^-1 M^1/2``, whose largest eigenvalues are
    ``1 / (lambda - sigma)``. ARPACK: Lehoucq, Sorensen and Yang, *ARPACK Users' Guide*, 1998. Many
    modes: see `_sparse.slicing.sliced_eigenpairs`, after Grimes, Lewis and Simon, 1994.

    Examples
    --------
    >>> from spectra_kit import Arpack, eigensolve, robust_laplacian
    >>> from spectra_kit.geometry import sphere
    >>> laplacian = robust_laplacian(sphere(subdivisions=3).geometry)
    >>> eigensolve(laplacian, 4, Arpack()).eigenvalues[1:].round(2)
    array([2., 2., 2.])
    """

    tol: float = 0.0
    shift: float = 0.1
    seed: int = 0
    max_restarts: int = 1000

    @property
    def promise(self) -> Promise:
        """See `Eigensolver`."""
        return "to tolerance" if self.tol else "exact"

    def __post_init__(self) -> None:
        check_positive("shift", self.shift)
        check_count("max_restarts", self.max_restarts, low=1)
        check_count("seed", self.seed, low=0)
        if not 0 <= self.tol < 1:
            raise InvalidInputError("tol", "be in [0, 1)", self.tol)

    @staticmethod
    def memory(n: int, k: int) -> float:
        """Estimate the memory, in GiB, that k modes on n points of one component take.

        Factor, vectors and modes together, the operator not. For components one after the other it
        is the largest of theirs, and 8 bytes for each number of the modes of the others.

        Parameters
        ----------
        n : int
            Points.
        k : int
            Modes.

        Returns
        -------
        float
            GiB.

        Examples
        --------
        >>> from spectra_kit import Arpack
        >>> 1 < Arpack.memory(100_000, 300) < 2
        True
        """
        if _DENSE_RATIO * k >= n:
            return 3 * 8 * n**2 / 2**30  # the matrix, its copy in LAPACK, eigenvectors
        return factor_gigabytes(n) + 8 * n * vectors_held(k) / 2**30

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Eigenpairs:
        """See `Eigensolver.eigenpairs`."""
        if _DENSE_RATIO * k >= laplacian.n:
            if laplacian.n > Dense.max_points:
                raise InvalidInputError(
                    "k",
                    f"be less than a third of the {laplacian.n} points, where Lanczos has room",
                    k,
                    advice="ask for fewer modes",
                )
            return Dense().eigenpairs(laplacian, k)
        sigma = -self.shift * laplacian.eigenvalue_spacing
        if k >= _MANY and laplacian.n >= 2 * MOST:
            return self._sliced(laplacian, k, sigma)
        clock = Clock()
        factor = shifted_factor(laplacian.stiffness, laplacian.mass, sigma)
        clock.stage("factor")
        # ARPACK takes a Ritz value below eps^(2/3) = 4e-11 for converged when it is so absolutely,
        # not relatively: in units of the spacing they are all far above that, whatever the input's.
        # A power of two near the spacing changes no digit.
        unit = 2.0 ** np.rint(np.log2(laplacian.eigenvalue_spacing))
        root = np.sqrt(laplacian.mass)
        inverse = LinearOperator(
            laplacian.stiffness.shape,
            matvec=lambda x: unit * root * factor.solve(root * x.ravel()),
            dtype=np.float64,
        )
        v0 = np.random.default_rng(self.seed).standard_normal(laplacian.n)
        ncv = min(laplacian.n, max(2 * k, k + 20)) if k < _MANY else k + k // 2 + 10
        try:
            with blas_threads_for(laplacian.n * ncv):
                values, vectors = eigsh(
                    inverse,
                    k,
                    which="LA",
                    v0=v0,
                    ncv=ncv,
                    tol=self.tol,
                    maxiter=self.max_restarts,
                )
        except ArpackNoConvergence as error:
            pairs = Eigenpairs(unit / error.eigenvalues + sigma, error.eigenvectors / root[:, None])
            raise NotConvergedError(
                f"ARPACK found {len(error.eigenvalues)} of {quantity(k, 'mode')} in"
                f" {quantity(self.max_restarts, 'restart')}",
                pairs,
                advice=("raise {}", "loosen {}", "use {}"),
                remedies=("max_restarts", "tol", "Refined"),
            ) from error
        except ArpackError:  # no shift that it could apply, within a wide cluster
            if laplacian.n >= 2 * MOST:
                return self._sliced(laplacian, k, sigma)
            return Dense().eigenpairs(laplacian, k)
        clock.stage("lanczos")
        return Eigenpairs(unit / values + sigma, vectors / root[:, None], clock.seconds)

    def _sliced(self, laplacian: Laplacian, k: int, sigma: float) -> Eigenpairs:
        """Return many modes, from block Lanczos around several shifts."""
        solved = partial(
            sliced_eigenpairs,
            laplacian.stiffness,
            laplacian.mass,
            k,
            below=sigma,
            spacing=laplacian.eigenvalue_spacing,
            tol=self.tol,
            most_shifts=self.max_restarts,
            seed=self.seed,
        )
        found = solved()
        seconds = found.seconds
        if len(found.eigenvalues) < k and found.shifts < self.max_restarts:  # a cluster stops it
            found = solved(block=WIDE)
            seconds = dict(Counter(seconds) + Counter(found.seconds))
        pairs = Eigenpairs(found.eigenvalues, found.eigenvectors, seconds)
        if len(pairs.eigenvalues) == k:
            return pairs
        told = (
            f"Lanczos found {len(pairs.eigenvalues)} of {quantity(k, 'mode')} around"
            f" {quantity(found.shifts, 'shift')}"
        )
        if found.shifts < self.max_restarts:
            told += "; more equal eigenvalues than it has room for do this"
            raise NotConvergedError(told, pairs, advice="use {}", remedies=("Dense",))
        raise NotConvergedError(
            told, pairs, advice=("raise {}", "use {}"), remedies=("max_restarts", "Refined")
        )


def or_densely(solver: Arpack, laplacian: Laplacian, k: int, reason: str) -> Eigenpairs:
    """Return what Lanczos finds, or LAPACK where it gives up on few points; says which, and why."""
    try:
        return solver.eigenpairs(laplacian, k)._replace(solver=solver, reason=reason)
    except NotConvergedError as error:
        if laplacian.n > Dense.few:
            raise
        dense, why = Dense(), f"{laplacian.n} points are few, and Lanczos gave up ({error})"
        return dense.eigenpairs(laplacian, k)._replace(solver=dense, reason=why)
