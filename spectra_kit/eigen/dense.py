"""LAPACK on the full matrix: exact, for small n."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import sparse
from scipy.linalg import eigh
from scipy.linalg.lapack import dormqr, dstevd, dsytrd

from spectra_kit._core.checked import checked
from spectra_kit._core.clock import Clock
from spectra_kit._core.threads import blas_threads_for
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count
from spectra_kit.eigen.base import Eigenpairs, NotConvergedError, Promise
from spectra_kit.errors import InvalidInputError
from spectra_kit.operators.laplacian import Laplacian

#: Times the spacing of eigenvalues up to which rounding of the largest leaves ten digits of that.
SPREAD = 1e6
_ORTHONORMAL = 1e-10  # LAPACK's is far better where it is right
# Times as many points as modes from which on LAPACK finds these in less time than all of them.
_FEW_OF_ALL = 10
_WIDE = 64  # columns that LAPACK takes together, at most


@checked
@dataclass(frozen=True, kw_only=True)
class Dense:
    """LAPACK on the dense ``M^-1/2 L M^-1/2``: O(n^3) time, 8 n^2 bytes; twice for a full M.

    Parameters
    ----------
    max_points : int, default 20_000
        Refuse larger components (3.2 GB a matrix at 20,000) rather than exhaust the memory.

    Examples
    --------
    >>> from spectra_kit import Dense, eigensolve, robust_laplacian
    >>> from spectra_kit.geometry import sphere
    >>> laplacian = robust_laplacian(sphere(subdivisions=2).geometry)
    >>> eigensolve(laplacian, 4, Dense()).eigenvalues[1:].round(1)
    array([2., 2., 2.])
    """

    promise: ClassVar[Promise] = "exact"
    #: Points up to which others go on densely where they give up: some ten seconds.
    few: ClassVar[int] = 4000
    max_points: int = 20_000

    def __post_init__(self) -> None:
        check_count("max_points", self.max_points, low=1)

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Eigenpairs:
        """See `Eigensolver.eigenpairs`."""
        if laplacian.n > self.max_points:
            raise InvalidInputError(
                "laplacian",
                f"have at most {self.max_points} points for Dense",
                laplacian.n,
                advice=("use {}", "raise `{}`"),
                remedies=("Arpack", "max_points"),
            )
        clock = Clock()
        root, M = np.sqrt(laplacian.mass), laplacian.consistent_mass
        with blas_threads_for(laplacian.n**2):
            if M is None:
                values, vectors = _lowest(laplacian.stiffness, root, k)
            else:
                both = _standard(laplacian.stiffness, root), _standard(M, root)
                values, vectors = eigh(*both, overwrite_a=True, overwrite_b=True)
                values, vectors = values[:k], vectors[:, :k]
        return Eigenpairs(values, vectors / root[:, None], {"dense": clock.total})


def _lowest(stiffness: sparse.csr_array, root: Floats, k: int) -> tuple[Floats, Floats]:
    """Return the k lowest pairs of the standard form.

    LAPACK's way to compute no others, quicker where they are few, may fail or lose orthogonality
    where parts hardly touch; divide and conquer computes all, and does not.
    """
    if _FEW_OF_ALL * k <= len(root):
        with suppress(np.linalg.LinAlgError):
            some = [0, k - 1]
            values, vectors = eigh(
                _standard(stiffness, root), subset_by_index=some, overwrite_a=True
            )
            if np.abs(vectors.T @ vectors - np.eye(k)).max() < _ORTHONORMAL:
                return values, vectors
    n, A = len(root), _standard(stiffness, root)
    reduced, d, e, tau, _ = dsytrd(A, lower=1, lwork=_WIDE * n, overwrite_a=1)
    values, vectors, failed = dstevd(d, e if n > 1 else np.zeros(1))
    if failed:
        raise NotConvergedError("LAPACK's divide and conquer did not converge")
    vectors = vectors[:, :k]  # of a tridiagonal matrix; only these are turned back
    if n > 1:
        below = np.array(vectors[1:], order="F")
        turned, *_ = dormqr("L", "N", reduced[1:, :-1], tau, below, _WIDE * k, overwrite_c=1)
        vectors = np.vstack([vectors[:1], turned])
    return values[:k], vectors


def _standard(stiffness: sparse.csr_array, root: Floats) -> Floats:
    scaled = stiffness.copy()
    scaled.data /= np.repeat(root, np.diff(scaled.indptr)) * root[scaled.indices]
    return np.asarray(scaled.toarray(order="F"))
