"""The lowest eigenpairs of a coarse level."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.linalg import eigh

from spectra_kit._core.threads import single_threaded_blas
from spectra_kit._core.types import Floats
from spectra_kit._sparse.ldl import SparseLDL
from spectra_kit._sparse.products import spmm
from spectra_kit._sparse.ritz import ritz_pairs
from spectra_kit.eigen.multigrid.coarse import Coarse

_DENSE = 1500  # points whose dense eigenproblem takes no longer than sweeps
_SWEEPS = 20  # at most; three or four settle random columns
_DEGREE = 4  # of the filter: solves of each column in a sweep
_RIDGE = 1e-13  # of the diagonal, added to it in the factor, for what is carried to nothing
_RANK_TOL = 1e-6  # of its functions: what is carried to less is rounding of the mass
_SHIFT = 1 / 8  # of the guard eigenvalue, below the spectrum


def coarse_pairs(
    level: Coarse, block: int, k: int, *, rtol: float = 0.01, seed: int = 0
) -> tuple[Floats, Floats]:
    """Return the lowest eigenpairs of a coarse level; of a large one, Ritz pairs near them.

    Parameters
    ----------
    level : Coarse
        On n points.
    block : int
        Pairs to return, if the level has as many: those beyond k guard the last wanted ones.
    k : int
        Wanted pairs.
    rtol : float, default 0.01
        On more than 1,500 points, stop when a sweep changes the wanted Ritz values by less than
        this share of them: no need to go below what the level itself is off by.
    seed : int, default 0
        Of the random columns that sweeps begin with.

    Returns
    -------
    eigenvalues : ndarray of shape (block,)
        Ascending; no smaller than those of the finest level.
    eigenvectors : ndarray of shape (n, block)
        On the subset, orthonormal in ``P^T M P``.

    Raises
    ------
    InvalidInputError
        If the functions of the level span fewer than k dimensions.

    Notes
    -----
    Each sweep filters the columns by a Chebyshev polynomial of ``(L - sigma M)^-1 M`` that is
    small beyond the guard, as `_sparse.shift_invert.shift_invert_iteration` does for a diagonal
    mass.

    Examples
    --------
    >>> from spectra_kit import robust_laplacian
    >>> from spectra_kit.geometry import sphere
    >>> from spectra_kit.eigen.multigrid import coarse_pairs, coarsen
    >>> level = coarsen(robust_laplacian(sphere(subdivisions=4).geometry), 600)
    >>> coarse_pairs(level, 9, 4)[0][1:4].round(1)
    array([2., 2., 2.])
    """
    L, M = level.stiffness, level.mass
    if level.n <= _DENSE:
        try:
            with single_threaded_blas():
                some = [0, min(block, level.n) - 1]
                values, X = eigh(L.toarray(), M.toarray(), subset_by_index=some)
            return values, np.ascontiguousarray(X)
        except np.linalg.LinAlgError:  # some points are carried to what others are
            own = np.eye(level.n)
            return ritz_pairs(L, M, own, block, least=k, rank_tol=_RANK_TOL)[:2]
    noise = np.random.default_rng(seed).standard_normal((level.n, block))
    values, X, _ = ritz_pairs(L, M, noise, block, least=k)
    factor: SparseLDL | None = None
    sigma = 0.0
    for _ in range(_SWEEPS):
        guard = max(float(values[-1]), level.eigenvalue_spacing)
        if factor is None or -sigma > 4 * _SHIFT * guard:
            # The Ritz values of a random start say nothing: not above what Weyl's law suggests.
            sigma = -_SHIFT * min(guard, 2 * block * level.eigenvalue_spacing)
            shifted = L - sigma * M
            ridge = sparse.diags_array(_RIDGE * shifted.diagonal())
            factor = SparseLDL(sparse.csr_array(shifted + ridge))
        # The Chebyshev polynomial that is at most 1 on the eigenvalues of T below 1 / edge.
        edge = guard - sigma
        previous, X = X, 2 * edge * factor.solve(spmm(M, X)) - X
        for _ in range(_DEGREE - 1):
            previous, X = X, 4 * edge * factor.solve(spmm(M, X)) - 2 * X - previous
        before = values[:k]
        values, X, _ = ritz_pairs(L, M, X, block, least=1)
        change = np.abs(values[:k] - before[: len(values)])
        if (change <= rtol * np.maximum(values[:k], level.eigenvalue_spacing)).all():
            break
    return values, X
