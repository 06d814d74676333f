"""Chebyshev-filtered subspace iteration in torch: eigenpairs to a tolerance without any factor."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from spectra_kit.linalg.filters import shifted, spectral_bound, standard_form
from spectra_kit.linalg.torch_ritz import leading_ritz_pairs

_GAIN = 1e6  # largest amplification in one sweep: the condition number it may give a block
_SINGLE_GAIN = 1e4  # in float32, whose rounding at the top of the spectrum limits what is gained
_SINGLE_WORTH = 0.1  # a float32 sweep that leaves more than this of the residual was the last one
_STALLED = 0.9  # a float64 sweep has met rounding if it leaves more than this of it, locks nothing,
_STILL = 1e-9  # and lowers the sum of the Ritz values by no more than this share
_SAFETY = 3.0  # filter for residuals this much below the tolerance
_DEGREES = (8, 4000)  # of one filter, at least and at most
_CUT_GROWTH = 2.0  # of the lower end of the damped interval, per sweep


class FilteredPairs(NamedTuple):
    """What `chebyshev_eigenpairs` found.

    Attributes
    ----------
    eigenvalues : Tensor of shape (k,)
        Ascending, float64, in 1/length^2.
    eigenvectors : Tensor of shape (n, k)
        M-orthonormal, float64.
    residuals : Tensor of shape (k,)
        ``||L u - lambda M u||`` in the M^-1 norm, in 1/length^2.
    sweeps : int
        Filters applied.
    products : int
        Sum of their degrees: products of L with a block.
    converged : bool
        Whether every residual is within the tolerance.
    stalled : bool
        Whether it gave up because the residuals no longer fell: rounding.
    """

    eigenvalues: Tensor
    eigenvectors: Tensor
    residuals: Tensor
    sweeps: int
    products: int
    converged: bool
    stalled: bool


def chebyshev_eigenpairs(
    stiffness: Tensor,
    mass: Tensor,
    start: Tensor,
    k: int,
    *,
    rtol: float,
    spacing: float,
    block: int | None = None,
    max_sweeps: int = 30,
    seed: int = 0,
) -> FilteredPairs:
    """Refine a block of columns until it holds the k lowest eigenpairs of L u = lambda M u.

    Parameters
    ----------
    stiffness : sparse CSR Tensor of shape (n, n)
        L, symmetric and positive semi-definite, float64, its diagonal stored.
    mass : Tensor of shape (n,)
        Diagonal of M, in length^2.
    start : Tensor of shape (n, m)
        Columns; the closer to the wanted span, the less is left to do.
    k : int
        Pairs wanted.
    rtol : float
        Converged where ``||L u - lambda M u||`` in the M^-1 norm is at most
        ``rtol * max(lambda, spacing)``.
    spacing : float
        Typical gap of neighbouring eigenvalues, in 1/length^2.
    block : int, optional
        Ritz vectors to iterate on, by default ``1.5 k``, which takes the least time: those beyond k
        guard the last wanted modes. Random ones are added where the start has too few.
    max_sweeps : int, default 30
        Filters before giving up.
    seed : int, default 0
        Of the random columns.

    Returns
    -------
    FilteredPairs
        The best found so far where `converged` is False; what to do about it is the caller's.

    Raises
    ------
    InvalidInputError
        If `start` holds NaN, or no diagonal is stored.

    Notes
    -----
    Subspace iteration with a Chebyshev polynomial p of M^-1 L (Zhou, Saad, Tiago and Chelikowsky,
    *Self-consistent-field calculations using Chebyshev-filtered subspace iteration*, J. Comput.
    Phys. 2006): at most one in size from the highest Ritz value of the block to the top of the
    spectrum, as large as can be below. Rayleigh-Ritz in the whole block follows. Leading modes
    that have converged are locked: they stay in the block and are filtered no more.

    A filter is applied to residuals: ``p(S) x = p(theta) x + f`` for a Ritz pair (theta, x), and f
    obeys the recurrence of p driven by ``S x - theta x``. Only the relative accuracy of f counts,
    so sweeps are in float32 as long as these gain a digit, and the result is float64 all the same.

    Examples
    --------
    >>> from scipy import sparse
    >>> from spectra_kit.linalg.torch_ritz import sparse_tensor
    >>> diagonals, offsets = [2.0, -1, -1, -1, -1], [0, 1, -1, 99, -99]
    >>> ring = sparse.diags_array(diagonals, offsets=offsets, shape=(100, 100))
    >>> ring = sparse_tensor(ring.tocsr())
    >>> block = torch.randn(100, 9, generator=torch.Generator().manual_seed(0))
    >>> pairs = chebyshev_eigenpairs(ring, torch.ones(100), block, 5, rtol=1e-9, spacing=0.002)
    >>> pairs.eigenvalues.abs()
    tensor([0.0000, 0.0039, 0.0039, 0.0158, 0.0158], dtype=torch.float64)
    """
    root = mass.double().sqrt()
    ones = torch.ones_like(root)
    operator = standard_form(stiffness, root)  # orthonormality is Euclidean from here on
    block = k + max(8, k // 2) if block is None else block
    values, X, _ = leading_ritz_pairs(stiffness, mass, start, block)
    X *= root.unsqueeze(1)
    if len(values) < block:
        drawn = np.random.default_rng(seed).standard_normal((len(X), block - len(values)))
        X = torch.cat([X, torch.from_numpy(drawn).to(X)], dim=1)
        values, X, _ = leading_ritz_pairs(operator, ones, X, block)
    schedule = _Schedule(rtol, spacing, spectral_bound(operator), spacing * len(values))
    while True:
        residuals = (operator @ X.contiguous()).addcmul_(X, values, value=-1)
        norms = residuals.norm(dim=0)
        sweep = schedule.next(values.tolist(), norms[:k].tolist())
        if sweep is None or schedule.sweeps == max_sweeps:
            break
        active = slice(sweep.locked, None)
        X[:, active] = _filtered(
            shifted(operator, sweep.interval, sweep.dtype),
            X[:, active],
            residuals[:, active],
            values[active],
            sweep,
        )
        schedule.sweeps, schedule.products = schedule.sweeps + 1, schedule.products + sweep.degree
        values, X, _ = leading_ritz_pairs(operator, ones, X, block)
    return FilteredPairs(
        values[:k],
        X[:, :k] / root.unsqueeze(1),
        norms[:k],
        schedule.sweeps,
        schedule.products,
        converged=schedule.converged,
        stalled=schedule.stalled,
    )


class _Sweep(NamedTuple):
    """One filter: of which columns, on which interval, how long, how precise."""

    locked: int
    interval: tuple[float, float]
    degree: int
    dtype: torch.dtype


@dataclass
class _Schedule:
    """What to do next, from the Ritz values and residual norms so far; runs on the host."""

    rtol: float
    spacing: float
    top: float
    cut: float  # about the highest eigenvalue of the block
    converged: bool = False
    stalled: bool = False
    sweeps: int = 0
    products: int = 0
    _rising: bool = True
    _locked: int = 0
    _worst: float = math.inf
    _sum: float = math.inf
    _dtype: torch.dtype = torch.float32

    def next(self, ritz: list[float], norms: list[float]) -> _Sweep | None:
        """Return the next sweep for the first ``len(norms)`` Ritz pairs, None at the end."""
        k = len(norms)
        excess = [norms[j] / (self.rtol * max(ritz[j], self.spacing)) for j in range(k)]
        unfinished = [j for j in range(k) if not excess[j] <= 1]
        self.converged = not unfinished
        if self.converged:
            return None
        left, self._worst = max(excess) / self._worst, max(excess)
        # A mode that was missing comes up with large residuals, but lowers the sum.
        fell, self._sum = sum(ritz[:k]) < (1 - _STILL) * self._sum, sum(ritz[:k])
        progress = left <= _STALLED or fell or unfinished[0] > self._locked
        self.stalled = not (progress or self._rising or self._dtype == torch.float32)
        if self.stalled:
            return None
        if left > _SINGLE_WORTH:
            self._dtype = torch.float64
        self._locked = unfinished[0]
        lowest = ritz[self._locked]
        # The guards of a random start lie far up the spectrum: do not follow them at once.
        self._rising = ritz[-1] > self.cut
        cut = max(min(ritz[-1], self.cut), lowest)
        self.cut *= _CUT_GROWTH
        interval = (min(1.01 * cut + self.spacing / 2, 0.9 * self.top), self.top)
        gain = _SINGLE_GAIN if self._dtype == torch.float32 else _GAIN
        needs = {ritz[j]: _SAFETY * excess[j] for j in unfinished}
        degree = _degree(needs, lowest, interval, gain)
        return _Sweep(self._locked, interval, degree, self._dtype)


def _degree(
    needs: dict[float, float], lowest: float, interval: tuple[float, float], gain: float
) -> int:
    """Return the degree that divides each residual (by its Ritz value) by what it needs.

    Less where the amplification at the lowest active Ritz value would exceed `gain`.
    """
    low, high = interval

    def rate(value: float) -> float:
        """Growth of the polynomial per degree, as an exponent."""
        return math.acosh(max((high + low - 2 * value) / (high - low), 1 + 1e-12))

    degree = min(
        max(math.acosh(max(need, 1.0)) / rate(value) for value, need in needs.items()),
        math.acosh(gain) / rate(lowest),
    )
    return min(max(math.ceil(degree), _DEGREES[0]), _DEGREES[1])


def _filtered(
    operator: Tensor,
    block: Tensor,
    residuals: Tensor,
    values: Tensor,
    sweep: _Sweep,
) -> Tensor:
    """Return ``p(S) block``, p normalised to one at the lowest of the Ritz values `values`."""
    low, high = sweep.interval
    radius = (high - low) / 2
    x = (values - (high + low) / 2) / radius
    x0 = min(float(x[0]), -1.0)
    driving = (residuals / radius).to(operator.dtype)
    before, current = torch.zeros_like(driving), driving / x0
    p_before, p = torch.ones_like(x), x / x0  # of the degrees before, at the Ritz values
    rho = 1 / x0
    for _ in range(sweep.degree - 1):
        following = 1 / (2 * x0 - rho)
        before.addmm_(operator, current, beta=-rho * following, alpha=2 * following)
        before.addcmul_(driving, (2 * following * p).to(driving.dtype))
        p_before, p = p, 2 * following * x * p - rho * following * p_before
        before, current, rho = current, before, following
    return (p * block).add_(current)
