"""Chebyshev filters in torch: eigenpairs to a tolerance without any factor, and smoothing.

A step costs one product of a sparse matrix with a block of columns, which an accelerator does at
the speed of its memory; within a filter nothing waits for the host.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from spectra_kit.errors import InvalidInputError
from spectra_kit.linalg.torch_ritz import csr_like, rayleigh_ritz

_GAIN = 1e6  # largest amplification in one sweep: the condition number it may give a block
_SINGLE_GAIN = 1e4  # in float32, whose rounding at the top of the spectrum limits what is gained
_SINGLE_WORTH = 0.1  # a float32 sweep that leaves more than this of the residual was the last one
_STALLED = 0.9  # a float64 sweep has met rounding if it leaves more than this of it, locks nothing,
_STILL = 1e-9  # and lowers the sum of the Ritz values by no more than this share
_SAFETY = 3.0  # filter for residuals this much below the tolerance
_DEGREES = (8, 4000)  # of one filter, at least and at most
_CUT_GROWTH = 2.0  # of the lower end of the damped interval, per sweep
_BOUND_STEPS = 20


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
    """

    eigenvalues: Tensor
    eigenvectors: Tensor
    residuals: Tensor
    sweeps: int
    products: int
    converged: bool


def chebyshev_eigenpairs(
    stiffness: Tensor,
    mass: Tensor,
    start: Tensor,
    k: int,
    *,
    rtol: float,
    spacing: float,
    max_sweeps: int = 30,
) -> FilteredPairs:
    """Refine a block of columns until it holds the k lowest eigenpairs of L u = lambda M u.

    Parameters
    ----------
    stiffness : sparse CSR Tensor of shape (n, n)
        L, symmetric and positive semi-definite, float64, its diagonal stored.
    mass : Tensor of shape (n,)
        Diagonal of M, in length^2.
    start : Tensor of shape (n, b)
        Columns of rank above k. The b - k beyond k guard the last wanted modes: about
        ``b = 1.5 k`` takes the least time.
    k : int
        Pairs wanted.
    rtol : float
        Converged where ``||L u - lambda M u||`` in the M^-1 norm is at most
        ``rtol * max(lambda, spacing)``.
    spacing : float
        Typical gap of neighbouring eigenvalues, in 1/length^2.
    max_sweeps : int, default 30
        Filters before giving up.

    Returns
    -------
    FilteredPairs
        The best found so far where `converged` is False; what to do about it is the caller's.

    Raises
    ------
    InvalidInputError
        If `start` spans fewer than k dimensions or holds NaN, or no diagonal is stored.

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
    top = spectral_bound(operator)
    block = root.unsqueeze(1) * start
    cut, dtype, worst = spacing * start.shape[1] / _CUT_GROWTH, torch.float32, math.inf
    sweeps = products = locked = 0
    rising, trace = True, math.inf
    while True:
        values, block, _ = rayleigh_ritz(operator, ones, block, None)
        if len(values) < k:
            raise InvalidInputError(
                f"`start` must span at least k = {k} dimensions, got {len(values)};"
                " add columns, random ones if need be"
            )
        residuals = (operator @ block).addcmul_(block, values, value=-1)
        norms = residuals.norm(dim=0)[:k]
        tolerances = rtol * values[:k].clamp_min(spacing)
        excess, ritz = (norms / tolerances).tolist(), values.tolist()
        unfinished = [j for j in range(k) if not excess[j] <= 1]
        if not unfinished or sweeps == max_sweeps:
            break
        left, worst = max(excess) / worst, max(excess)
        # A mode that was missing comes up with large residuals, but lowers the sum.
        fell, trace = sum(ritz[:k]) < (1 - _STILL) * trace, sum(ritz[:k])
        progress = left <= _STALLED or fell or unfinished[0] > locked
        if not (progress or rising or dtype == torch.float32):
            break
        if left > _SINGLE_WORTH:
            dtype = torch.float64
        locked = unfinished[0]
        # The guards of a random start lie far up the spectrum: do not follow them at once.
        rising = _CUT_GROWTH * cut < ritz[-1]
        cut = max(_CUT_GROWTH * cut, ritz[locked]) if rising else ritz[-1]
        interval = (min(1.01 * cut + spacing / 2, 0.9 * top), top)
        gain = _GAIN if dtype == torch.float64 else _SINGLE_GAIN
        needs = {ritz[j]: _SAFETY * excess[j] for j in unfinished}
        degree = _degree(needs, ritz[locked], interval, gain)
        active = slice(locked, None)
        block[:, active] = _filtered(
            shifted(operator, interval, dtype),
            block[:, active],
            residuals[:, active],
            values[active],
            degree,
            interval,
        )
        sweeps, products = sweeps + 1, products + degree
    vectors = block[:, :k] / root.unsqueeze(1)
    return FilteredPairs(values[:k], vectors, norms, sweeps, products, not unfinished)


def chebyshev_smooth(
    stiffness: Tensor, basis: Tensor, *, degree: int = 8, damping: float = 30.0
) -> Tensor:
    """Damp the high frequencies of the columns of a basis.

    Parameters
    ----------
    stiffness : sparse CSR Tensor of shape (n, n)
        L, symmetric and positive semi-definite, its diagonal stored and positive.
    basis : Tensor of shape (n, m)
        Functions, float32 or float64; computed in that precision.
    degree : int, default 8
        Products with L. The band that is kept shrinks with its square.
    damping : float, default 30.0
        By what at least the damped band is divided; larger takes more of the low end with it.

    Returns
    -------
    Tensor of shape (n, m)
        ``p(D^-1 L) basis`` with D the diagonal of L: p is the Chebyshev polynomial with p(0) = 1
        and ``|p| <= 1 / damping`` from ``top * (acosh(damping) / (2 degree))^2``, about, to the top
        of the spectrum of D^-1 L, which is about 2 whatever the mesh. Constants stay as they are.

    Examples
    --------
    >>> from scipy import sparse
    >>> from spectra_kit.linalg.torch_ritz import sparse_tensor
    >>> path = sparse.csr_array([[1.0, -1, 0], [-1, 2, -1], [0, -1, 1]])
    >>> functions = torch.tensor([[1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
    >>> chebyshev_smooth(sparse_tensor(path), functions)[:, 0]
    tensor([1., 1., 1.])
    """
    root = _diagonal(stiffness).double().sqrt()
    symmetric = standard_form(stiffness, root)
    top = spectral_bound(symmetric)
    # x0 = -cosh(acosh(damping) / degree) is where the polynomial on [-1, 1] has size `damping`.
    x0 = -math.cosh(math.acosh(damping) / degree)
    cut = top * (x0 + 1) / (x0 - 1)
    rows = _row_indices(stiffness)
    scaled = csr_like(stiffness, stiffness.values() / root.square()[rows])
    operator = shifted(scaled, (cut, top), basis.dtype)
    before, current = basis.clone(), (operator @ basis).div_(x0)
    rho = 1 / x0
    for _ in range(degree - 1):
        following = 1 / (2 * x0 - rho)
        before.addmm_(operator, current, beta=-rho * following, alpha=2 * following)
        before, current, rho = current, before, following
    return current


def spectral_bound(operator: Tensor) -> float:
    """Return a proven upper bound on the eigenvalues of a symmetric sparse CSR matrix S.

    For any positive x the spectral radius of ``|S|``, and so every eigenvalue of S, is at most
    ``max_i (|S| x)_i / x_i`` (Collatz and Wielandt); a few power steps on x bring that close to
    the radius. For an L with non-negative weights it is below twice the largest eigenvalue.

    Examples
    --------
    >>> from scipy import sparse
    >>> from spectra_kit.linalg.torch_ritz import sparse_tensor
    >>> path = sparse_tensor(sparse.csr_array([[1.0, -1, 0], [-1, 2, -1], [0, -1, 1]]))
    >>> round(spectral_bound(path), 4)  # 3 is attained
    3.0000
    """
    magnitude = csr_like(operator, operator.values().double().abs())
    x = torch.ones(operator.shape[0], 1, dtype=torch.float64, device=operator.device)
    bound = (magnitude @ x).max()
    for _ in range(_BOUND_STEPS):
        y = magnitude @ x
        ratio = (y / x).max()
        bound = torch.minimum(bound, ratio)
        x = (y / ratio).add_(x)  # x stays positive where a row is zero
    return float(bound) * (1 + 1e-12)


def standard_form(stiffness: Tensor, root: Tensor) -> Tensor:
    """Return ``M^-1/2 L M^-1/2`` as CSR, `root` being the diagonal of M^1/2."""
    rows = _row_indices(stiffness)
    values = stiffness.values().double() / (root[rows] * root[stiffness.col_indices()])
    return csr_like(stiffness, values)


def shifted(operator: Tensor, interval: tuple[float, float], dtype: torch.dtype) -> Tensor:
    """Return the operator moved and scaled so that `interval` becomes [-1, 1], in `dtype`."""
    low, high = interval
    on_diagonal = _row_indices(operator) == operator.col_indices()
    if int(on_diagonal.sum()) != operator.shape[0]:
        raise InvalidInputError(
            f"`stiffness` must store all {operator.shape[0]} entries of its diagonal, got"
            f" {int(on_diagonal.sum())}; a zero one is a point that nothing holds: drop it"
        )
    values = operator.values().double() - (high + low) / 2 * on_diagonal.double()
    return csr_like(operator, (values / ((high - low) / 2)).to(dtype))


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
    degree: int,
    interval: tuple[float, float],
) -> Tensor:
    """Return ``p(S) block``, p normalised to one at the lowest of the Ritz values `values`."""
    low, high = interval
    radius = (high - low) / 2
    x = (values - (high + low) / 2) / radius
    x0 = min(float(x[0]), -1.0)
    driving = (residuals / radius).to(operator.dtype)
    before, current = torch.zeros_like(driving), driving / x0
    p_before, p = torch.ones_like(x), x / x0  # of the degrees before, at the Ritz values
    rho = 1 / x0
    for _ in range(degree - 1):
        following = 1 / (2 * x0 - rho)
        before.addmm_(operator, current, beta=-rho * following, alpha=2 * following)
        before.addcmul_(driving, (2 * following * p).to(driving.dtype))
        p_before, p = p, 2 * following * x * p - rho * following * p_before
        before, current, rho = current, before, following
    return (p * block).add_(current)


def _row_indices(operator: Tensor) -> Tensor:
    """Return the row of each stored entry."""
    counts = operator.crow_indices().diff()
    rows = torch.arange(operator.shape[0], device=operator.device)
    return torch.repeat_interleave(rows, counts, output_size=operator.values().numel())


def _diagonal(operator: Tensor) -> Tensor:
    """Return the diagonal of a CSR matrix, zero where none is stored."""
    rows = _row_indices(operator)
    values = operator.values() * (rows == operator.col_indices())
    return values.new_zeros(operator.shape[0]).index_add_(0, rows, values)
