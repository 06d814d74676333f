"""Chebyshev-filtered subspace iteration in torch: eigenpairs to a tolerance without any factor."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from spectra_kit.linalg.filters import shifted, spectral_bound, standard_form
from spectra_kit.linalg.ritz import ritz_pairs
from spectra_kit.linalg.torch_device import csr_diagonal, csr_like, csr_rows

_GAIN = 1e6  # largest amplification in one sweep: the condition number it may give a block
_STIFF = 4.0  # diagonal of M^-1 L, relative to its median, beyond which quick sweeps add mass
_FAR = 60.0  # but not where the diagonal is below this multiple of the highest mode's eigenvalue
_POOR = 0.1  # a quick sweep that leaves more than this of the residual was the last of its kind
_STALLED = 0.9  # an exact sweep has met rounding if it leaves more than this of it, locks nothing,
_STILL = 1e-9  # and lowers the sum of the Ritz values by no more than this share
_SAFETY = 3.0  # filter for residuals this much below the tolerance
_DEGREES = (8, 4000)  # of one filter, at least and at most
_PROBES = 8  # random columns that look for modes of which the start holds nothing; then twice these
_CUT_GROWTH = 2.0  # of the lower end of the damped interval, per sweep


class FilteredPairs(NamedTuple):
    """What `chebyshev_eigenpairs` found, whether it `converged`, or `stalled` at rounding."""

    eigenvalues: Tensor
    eigenvectors: Tensor
    residuals: Tensor  # ||L u - lambda M u|| in the M^-1 norm
    sweeps: int
    products: int  # of L with a block, over all sweeps
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
    block: int,
    max_sweeps: int = 30,
    seed: int = 0,
) -> FilteredPairs:
    """Refine a block of columns until it holds the k lowest eigenpairs of L u = lambda M u.

    Converged where ``||L u - lambda M u||`` in the M^-1 norm is at most
    ``rtol * max(lambda, spacing)``. `block` Ritz vectors are iterated on: those beyond k guard the
    last wanted modes. Random ones are added where the start has too few.

    Subspace iteration with a Chebyshev polynomial p of M^-1 L (Zhou, Saad, Tiago and Chelikowsky,
    *Self-consistent-field calculations using Chebyshev-filtered subspace iteration*, J. Comput.
    Phys. 2006): at most one in size from the highest Ritz value of the block to the top of the
    spectrum, as large as can be below. Rayleigh-Ritz in the whole block follows. Leading modes
    that have converged are locked: they stay in the block and are filtered no more.

    A filter is applied to residuals: with ``A = M^-1 L``, ``p(A) x = p(theta) x + f`` for a Ritz
    pair (theta, x), and f obeys the recurrence of p driven by ``A x - theta x``. So f needs little
    accuracy, and what is not right of it is made good by the next sweep: as long as sweeps gain a
    digit they are in float32, and of an A with more mass at the few points whose stiffness makes
    the top of the spectrum. The result is that of L and M in float64 all the same.

    Residuals do not tell whether a mode is missing of which the start holds nothing. So converged
    modes are tried: random columns, filtered twice and orthogonal to the block, join a last
    Rayleigh-Ritz. If a Ritz value falls, the iteration goes on with these, and with twice as many
    the next time. That makes it unlikely that a mode is missed; only a count can prove it.
    """
    values, X = _ritz_pairs(stiffness, mass, start, block)
    if len(values) < block:
        drawn = np.random.default_rng(seed).standard_normal((len(X), block - len(values)))
        X = torch.cat([X, torch.from_numpy(drawn).to(X)], dim=1)
        values, X = _ritz_pairs(stiffness, mass, X, block)
    weights = mass.double().unsqueeze(1)
    operator = _Operator.quick(stiffness, mass, spacing * block)
    schedule = _Schedule(rtol, spacing, spacing * block)
    probes, rng = _PROBES, np.random.default_rng(seed)
    while True:
        residuals = (stiffness @ X.contiguous()).sub_(weights * X * values)
        norms = (residuals / weights.sqrt()).norm(dim=0)
        schedule.look(values.tolist(), norms[:k].tolist())
        if schedule.converged and len(X) > block + probes:
            noise = torch.from_numpy(rng.standard_normal((len(X), probes))).to(X)
            unseen = _unseen(operator, stiffness, weights, X, noise, schedule)
            tried, joined = _ritz_pairs(stiffness, mass, torch.cat([X, unseen], 1), block)
            fall = (values - tried)[:k] / values[:k].clamp(min=spacing)
            if float(fall.max()) > rtol:
                values, X, probes = tried, joined, 2 * probes
                schedule = schedule.anew()
                continue
        if schedule.finished or schedule.sweeps == max_sweeps:
            break
        if schedule.careful and math.isfinite(operator.limit):
            operator = _Operator.exact(stiffness, mass)
        sweep = schedule.plan(operator)
        # Above the top of a nearby operator its polynomial grows without end.
        active = slice(schedule.locked, int((values <= operator.top).sum()))
        X[:, active] = _filtered(
            operator, X[:, active], residuals[:, active], values[active], sweep
        )
        values, X = _ritz_pairs(stiffness, mass, X, block)
    return FilteredPairs(
        values[:k],
        X[:, :k],
        norms[:k],
        schedule.sweeps,
        schedule.products,
        converged=schedule.converged,
        stalled=schedule.stalled,
    )


def _ritz_pairs(
    stiffness: Tensor, mass: Tensor, columns: Tensor, most: int
) -> tuple[Tensor, Tensor]:
    """Return the lowest Ritz pairs in the span of the columns, as many as it has dimensions."""
    values, X, _ = ritz_pairs(stiffness, mass, columns, most)
    return torch.from_numpy(values).to(X.device), X


class _Operator(NamedTuple):
    """What a filter is a polynomial of, and in which precision."""

    matrix: Tensor  # M^-1 L
    mass: Tensor
    top: float
    limit: float  # of its diagonal, where mass was added to reach that; inf without

    @classmethod
    def quick(cls, stiffness: Tensor, mass: Tensor, highest: float) -> _Operator:
        """Return a nearby operator in float32 whose spectrum ends far earlier.

        A few points of tiny mass, or between needles, make the top of the spectrum; with more mass
        there, all modes up to `highest` stay about the same.
        """
        diagonal = csr_diagonal(stiffness)
        typical = float((diagonal / mass).median())
        limit = max(_STIFF * typical, _FAR * highest)
        return cls._of(stiffness, torch.maximum(mass.double(), diagonal / limit), limit)

    @classmethod
    def exact(cls, stiffness: Tensor, mass: Tensor) -> _Operator:
        """Return the operator itself in float64."""
        return cls._of(stiffness, mass.double(), math.inf)

    @classmethod
    def _of(cls, stiffness: Tensor, mass: Tensor, limit: float) -> _Operator:
        top = spectral_bound(standard_form(stiffness, mass.sqrt()))
        matrix = csr_like(stiffness, stiffness.values() / mass[csr_rows(stiffness)])
        return cls(matrix, mass, top, limit)


class _Sweep(NamedTuple):
    """One filter: the interval it damps, and its degree."""

    interval: tuple[float, float]
    degree: int


@dataclass
class _Schedule:
    """What to do next, from the Ritz values and residual norms so far; runs on the host."""

    rtol: float
    spacing: float
    cut: float  # about the highest eigenvalue of the block
    converged: bool = False
    stalled: bool = False
    careful: bool = False
    locked: int = 0
    sweeps: int = 0
    products: int = 0
    _rising: bool = True
    _expected: float = math.inf  # share of the largest residual that a sweep should leave
    _sum: float = math.inf
    _ritz: list[float] = field(default_factory=list)
    _excess: list[float] = field(default_factory=list)  # residuals relative to their tolerances

    @property
    def finished(self) -> bool:
        """Whether there is no more to do, or no use in it."""
        return self.converged or self.stalled

    def anew(self) -> _Schedule:
        """Return the schedule of a block that more modes have joined."""
        return _Schedule(
            self.rtol, self.spacing, self.cut, sweeps=self.sweeps, products=self.products
        )

    def probe(self, operator: _Operator) -> _Sweep:
        """Return the filter that brings up modes below the end of the block."""
        low = min(1.01 * self._ritz[-1] + self.spacing / 2, 0.9 * operator.top)
        degree = math.acosh(_GAIN) / _rate(0.0, low, operator.top)
        degree = min(max(math.ceil(degree), _DEGREES[0]), _DEGREES[1])
        self.products += 2 * degree
        return _Sweep((low, operator.top), degree)

    def look(self, ritz: list[float], norms: list[float]) -> None:
        """Judge the last sweep by all Ritz values and the residual norms of the wanted ones."""
        k = len(norms)
        before, self._ritz = max(self._excess, default=math.inf), ritz
        self._excess = [norms[j] / (self.rtol * max(ritz[j], self.spacing)) for j in range(k)]
        worst = max(self._excess)
        locked = next((j for j in range(k) if not self._excess[j] <= 1), k)
        self.converged = locked == k
        # A mode that was missing comes up with large residuals, but lowers the sum.
        fell, self._sum = sum(ritz[:k]) < (1 - _STILL) * self._sum, sum(ritz[:k])
        progress = worst <= _STALLED * before or fell or locked > self.locked or self._rising
        self.stalled = self.careful and not progress
        poor = worst > min(max(_POOR, 5 * self._expected), 0.5) * before
        self.careful = self.careful or (poor and not self._rising)
        self.locked = locked

    def plan(self, operator: _Operator) -> _Sweep:
        """Return the next sweep."""
        top = operator.top
        # The guards of a random start lie far up the spectrum: do not follow them at once.
        self._rising = self.cut < min(self._ritz[-1], 0.5 * top)
        cut = max(min(self._ritz[-1], self.cut), self._ritz[self.locked])
        self.cut *= _CUT_GROWTH
        low = min(1.01 * cut + self.spacing / 2, 0.9 * top)
        wanted = range(self.locked, len(self._excess))
        rates = {j: _rate(self._ritz[j], low, top) for j in wanted if self._excess[j] > 1}
        reach = max(operator.limit / low, 10.0)  # added mass leaves about the inverse of this
        degree = min(
            max(
                math.acosh(min(_SAFETY * self._excess[j], reach)) / rate
                for j, rate in rates.items()
            ),
            math.acosh(_GAIN) / _rate(0.0, low, top),  # for modes that may be missing yet, too
        )
        degree = min(max(math.ceil(degree), _DEGREES[0]), _DEGREES[1])
        self._expected = 1 / math.cosh(min(degree * min(rates.values()), 700.0))
        self.sweeps, self.products = self.sweeps + 1, self.products + degree
        return _Sweep((low, top), degree)


def _unseen(
    operator: _Operator,
    stiffness: Tensor,
    weights: Tensor,
    X: Tensor,
    noise: Tensor,
    schedule: _Schedule,
) -> Tensor:
    """Return the low modes in random columns, of unit norm and orthogonal to X."""
    sweep = schedule.probe(operator)
    for _ in range(2):  # once leaves too much of the top of the spectrum
        for _ in range(2):  # once leaves what cancellation leaves
            noise = noise - X @ (X.T @ (weights * noise))
        noise = noise / (weights * noise**2).sum(dim=0).sqrt()
        energy = stiffness @ noise.contiguous()
        values = (noise * energy).sum(dim=0)
        noise = _filtered(operator, noise, energy - weights * noise * values, values, sweep)
    noise = noise - X @ (X.T @ (weights * noise))
    return noise / (weights * noise**2).sum(dim=0).sqrt()


def _rate(value: float, low: float, high: float) -> float:
    """Growth of the polynomial that damps [low, high] at a value below, an exponent per degree."""
    return math.acosh(max((high + low - 2 * value) / (high - low), 1 + 1e-12))


def _filtered(
    operator: _Operator, X: Tensor, residuals: Tensor, values: Tensor, sweep: _Sweep
) -> Tensor:
    """Return ``p(M^-1 L) X``, p normalised to one at zero."""
    low, high = sweep.interval
    radius = (high - low) / 2
    matrix = shifted(operator.matrix, sweep.interval)
    if math.isfinite(operator.limit):
        matrix = matrix.float()
    x = (values - (high + low) / 2) / radius
    x0 = -(high + low) / 2 / radius
    driving = (residuals / (radius * operator.mass.unsqueeze(1))).to(matrix.dtype)
    before, current = torch.zeros_like(driving), driving / x0
    p_before, p = torch.ones_like(x), x / x0  # of the degrees before, at the Ritz values
    rho = 1 / x0
    for _ in range(sweep.degree - 1):
        following = 1 / (2 * x0 - rho)
        before.addmm_(matrix, current, beta=-rho * following, alpha=2 * following)
        before.addcmul_(driving, (2 * following * p).to(driving.dtype))
        p_before, p = p, 2 * following * x * p - rho * following * p_before
        before, current, rho = current, before, following
    return (p * X).add_(current)
