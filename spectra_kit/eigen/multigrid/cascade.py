"""Cascadic multigrid: modes of a coarse level, prolonged and smoothed level by level."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import eigh

from spectra_kit._core.clock import Clock
from spectra_kit._core.threads import single_threaded_blas
from spectra_kit._core.types import Floats
from spectra_kit._sparse.blocks import operations
from spectra_kit._sparse.ldl import SparseLDL
from spectra_kit._sparse.products import spmm
from spectra_kit._sparse.ritz import ritz_pairs, ritz_rotation
from spectra_kit.eigen.multigrid.coarse import Coarse, coarsen
from spectra_kit.eigen.multigrid.estimates import excess, in_order
from spectra_kit.eigen.multigrid.smoothing import Smoothing, on_device
from spectra_kit.errors import InvalidInputError
from spectra_kit.operators.laplacian import Laplacian

_DENSE = 1500  # points whose dense eigenproblem takes no longer than sweeps
_SWEEPS = 20  # at most; three or four settle random columns
_DEGREE = 4  # of the filter: solves of each column in a sweep
_RIDGE = 1e-13  # of the diagonal, added to it in the factor, for what is carried to nothing
_RANK_TOL = 1e-6  # of its functions: what is carried to less is rounding of the mass
_SHIFT = 1 / 8  # of the guard eigenvalue, below the spectrum


def coarsest_eigenpairs(
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

    Notes
    -----
    Each sweep filters the columns by a Chebyshev polynomial of ``(L - sigma M)^-1 M`` that is
    small beyond the guard, as `_sparse.shift_invert.shift_invert_iteration` does for a diagonal
    mass.

    Examples
    --------
    >>> from spectra_kit import robust_laplacian
    >>> from spectra_kit.geometry import sphere
    >>> from spectra_kit.eigen.multigrid import coarsest_eigenpairs, coarsen
    >>> level = coarsen(robust_laplacian(sphere(subdivisions=4).geometry), 600)
    >>> coarsest_eigenpairs(level, 9, 4)[0][1:4].round(1)
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


_RATIO = 16  # points of a level relative to those of the next one, at most
_CARRIED = 8  # products of the first step on a level: interpolation errs at its own spacing
_MIDDLE = 4  # steps on a level between, at most
_LEFT = 0.01  # of what a level between gained: its modes are off by more than that on the next one
_SURE = 3  # times smaller than the target are estimates to be: so far off are some of them
_MORE = 2  # times smaller than that are errors to become by the next step
_ROUNDING = 1e-10  # of the last Ritz value: a rise beyond it is none of rounding


class Smoothed(NamedTuple):
    """What `prolonged` reached."""

    eigenvalues: Floats  #: Of all columns, ascending.
    eigenvectors: Any  #: M-orthonormal, on the finest level.
    errors: Floats  #: Estimated relative errors of the k wanted eigenvalues.
    steps: int  #: Rayleigh-Ritz steps on the finest level.


def nested(laplacian: Laplacian, coarsest: int) -> list[Coarse]:
    """Return levels down to about `coarsest` points, from finer to coarser.

    Each is a part of the one before; none where there are fewer than twice as many points.
    """
    levels: list[Coarse] = []
    if laplacian.n >= 2 * coarsest:
        count = math.ceil(math.log(laplacian.n / coarsest) / math.log(_RATIO))
        for i in range(1, count + 1):
            size = round(laplacian.n * (coarsest / laplacian.n) ** (i / count))
            finer = levels[-1] if levels else laplacian
            if finer.n > size:  # in a regular grid a level may have far fewer points than asked for
                levels.append(coarsen(finer, size))
    return levels


def prolonged(
    laplacian: Laplacian,
    levels: Sequence[Coarse],
    values: Floats,
    vectors: Any,
    k: int,
    *,
    keep: int,
    target: float,
    max_steps: int,
    device: str = "cpu",
    clock: Clock | None = None,
) -> Smoothed:
    """Carry Ritz pairs of the coarsest level up to all points, and smooth them on each level.

    The levels are those of `nested`, none if the pairs are on all points already. Values, (b,) and
    ascending, and vectors, (n, b), array or tensor, are M-orthonormal Ritz pairs on the last of
    them; those beyond k guard the wanted ones, and `keep` columns of them go on to all points.
    There it stops after `max_steps`, or when the estimated relative errors of the wanted
    eigenvalues are a third of `target`, in the mean. On the CPU the levels above the coarsest are
    arrays, elsewhere tensors. Ritz values bound the eigenvalues from above on every level, for
    the levels are nested.

    A step is a Chebyshev smoother (`Smoothing`) and Rayleigh-Ritz. How often it is repeated on all
    points follows from what the steps gain. After Bornemann and Deuflhard, *The cascadic multigrid
    method for elliptic problems*, 1996.
    """
    clock = clock or Clock()
    X = vectors if device == "cpu" else on_device(vectors, device)
    ops, errors, step = operations(X), np.full(k, np.inf), 0
    goal = target / (_SURE * _MORE)
    finer: list[Laplacian | Coarse] = [laplacian]
    finer += levels[:-1]
    for i in range(len(finer) - 1, -1, -1):
        finest = i == 0
        if finest:
            values, X = values[:keep], X[:, :keep]
        if levels:
            X = ops.product(on_device(levels[i].prolongation, device), X)
        smoothing = Smoothing.of(finer[i], device)
        clock.stage("prolong")
        residual = smoothing.residual(values, X)
        step, found, gained, spared = 0, None, 0.0, False
        for step in range(1, 1 + (max_steps if finest else min(max_steps, _MIDDLE))):
            before = values
            # A prediction has met the target but for a margin: once, no more is aimed at.
            sparing = not levels and not spared and bool(errors.mean() <= target)
            spared |= sparing
            degree = _CARRIED if finest and levels and step == 1 else None
            guards = max(1, len(values) - k)
            smooth = smoothing.smoothed(
                values,
                X,
                residual,
                degree=degree,
                guards=guards,
                errors=found,
                goal=target / _SURE if sparing else goal,
                sparing=sparing,
            )
            clock.stage("smooth")
            del residual  # blocks as large as X: what is no longer needed makes room
            values, X = _rotated(smoothing, smooth, values, X, k)
            del smooth
            clock.stage("rayleigh_ritz")
            residual = smoothing.residual(values, X)
            least = np.maximum(values, laplacian.eigenvalue_spacing)[:k]
            falls = np.maximum(before[:k] - values[:k], 0.0)
            off = excess(smoothing, values, X, residual, falls)
            found, errors = off / least, in_order(values[:k], off) / least
            clock.stage("smooth")
            gained += float((falls / least).mean())
            if errors.mean() <= (target / _SURE if finest else max(goal, _LEFT * gained)):
                break
    return Smoothed(values, X, errors, step)


def _rotated(level: Smoothing, smooth: Any, values: Floats, X: Any, k: int) -> tuple[Floats, Any]:
    """Return the Ritz pairs of smoothed columns, whose k lowest values are not above the old ones.

    Together with the old columns, where they alone are dependent or a value rose: what some had
    beyond others was rough, or rounding grew in the correction.
    """
    try:
        lower, Y = ritz_rotation(level.stiffness, level.mass, smooth)
        if (lower[:k] <= values[:k] + _ROUNDING * values[-1]).all():
            return lower, Y
    except InvalidInputError:
        pass
    both = operations(smooth).joined(smooth, X)
    lower, Y, _ = ritz_pairs(level.stiffness, level.mass, both, len(values), least=k)
    return lower, Y
