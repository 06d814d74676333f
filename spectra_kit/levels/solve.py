"""Eigenpairs of a coarse level, from any start."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from spectra_kit._types import Floats
from spectra_kit.levels.coarse import Coarse
from spectra_kit.linalg.ldl import SparseLDL
from spectra_kit.linalg.products import spmm
from spectra_kit.linalg.ritz import ritz_pairs

_RIDGE = 1e-13  # of the diagonal, added to it in the factor, for what is carried to nothing
_SHIFT = 1 / 8  # of the guard eigenvalue, below the spectrum


class CoarsePairs(NamedTuple):
    """Ritz pairs of a coarse level.

    Attributes
    ----------
    eigenvalues : ndarray of shape (b,)
        Ascending; no smaller than those of the finest level.
    eigenvectors : ndarray of shape (n, b)
        On the subset, orthonormal in ``P^T M P``.
    """

    eigenvalues: Floats
    eigenvectors: Floats


def coarse_ritz(
    level: Coarse, basis: NDArray[np.floating], k: int, *, guard: int = 0
) -> CoarsePairs:
    """Return the lowest Ritz pairs of a coarse level in the span of `basis`.

    Parameters
    ----------
    level : Coarse
        On n points.
    basis : ndarray of shape (n, m)
        Columns of any scale, dependent ones allowed.
    k : int
        Pairs to return at least.
    guard : int, default 0
        Pairs to return beyond these, as far as the rank allows.

    Returns
    -------
    CoarsePairs
        Between k and ``k + guard`` of them.

    Raises
    ------
    InvalidInputError
        If the numerical rank of `basis` is below k, or it holds NaN, infinity or only zeros.
    """
    values, vectors, _ = ritz_pairs(level.stiffness, level.mass, basis, k + guard, least=k)
    return CoarsePairs(values, vectors)


def coarse_iteration(
    level: Coarse,
    start: CoarsePairs,
    k: int,
    *,
    rtol: float = 0.0,
    max_sweeps: int = 20,
    degree: int = 4,
    least: int | None = None,
) -> CoarsePairs:
    """Drive Ritz pairs of a coarse level towards its lowest eigenpairs.

    Parameters
    ----------
    level : Coarse
        On n points.
    start : CoarsePairs
        Of b > k columns: those beyond k guard the last wanted ones.
    k : int
        Wanted pairs.
    rtol : float, default 0.0
        Stop when a sweep changes the wanted Ritz values by less than this share of them: no need
        to go below what the level itself is off by.
    max_sweeps : int, default 20
        Stop after so many in any case.
    degree : int, default 4
        Of the filter: solves of each column in a sweep.
    least : int, optional
        Rank to which a sweep may fall, k without it: a start for more sweeps needs none.

    Returns
    -------
    CoarsePairs
        All b of them, unless the rank fell.

    Notes
    -----
    Each sweep filters the columns by a Chebyshev polynomial of ``(L - sigma M)^-1 M`` that is
    small beyond the guard; see `linalg.shift_invert.shift_invert_iteration`, the same method for
    a diagonal mass.
    """
    block = len(start.eigenvalues)
    least = k if least is None else least
    pairs = start
    factor: SparseLDL | None = None
    sigma = 0.0
    for _ in range(max_sweeps):
        guard = max(float(pairs.eigenvalues[-1]), level.eigenvalue_spacing)
        if factor is None or -sigma > 4 * _SHIFT * guard:
            # The Ritz values of a random start say nothing: not above what Weyl's law suggests.
            sigma = -_SHIFT * min(guard, 2 * block * level.eigenvalue_spacing)
            shifted = level.stiffness - sigma * level.mass
            ridge = sparse.diags_array(_RIDGE * shifted.diagonal())
            factor = SparseLDL(sparse.csr_array(shifted + ridge))
        filtered = _filtered(level, factor, pairs.eigenvectors, guard - sigma, degree)
        before = pairs.eigenvalues[:k]
        pairs = coarse_ritz(level, filtered, least, guard=block - least)
        values = pairs.eigenvalues[:k]
        change = np.abs(values - before[: len(values)])
        if (change <= rtol * np.maximum(values, level.eigenvalue_spacing)).all():
            break
    return pairs


def _filtered(level: Coarse, factor: SparseLDL, X: Floats, guard: float, degree: int) -> Floats:
    """Apply the Chebyshev polynomial that is at most 1 on the eigenvalues of T below 1 / guard."""
    previous = X
    current = 2 * guard * factor.solve(spmm(level.mass, X)) - X
    for _ in range(degree - 1):
        solved = factor.solve(spmm(level.mass, current))
        previous, current = current, 4 * guard * solved - 2 * current - previous
    return current
