"""How far smoothed modes are still off, from what their residuals are made of."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.types import Floats
from spectra_kit._sparse.blocks import operations
from spectra_kit.eigen.multigrid.smoothing import Smoothing, chebyshev_steps

_COLUMNS = 12  # whose residuals are solved for; those of the others are like theirs
_LOWEST = 0.8  # of the frequency of the last columns: errors lie above it, for the most part
_REACH = 0.6  # degree d solves well down to 1 / (0.6 d^2) of the highest frequency
_MOST = 60  # steps: lower frequencies are left out
_WHOLE = 0.9  # of the highest frequency: where the columns reach up to it, little is left
_NEAREST = 0.9  # of the frequency of an error: that of its mode, at most
_UNSURE = 0.75  # spreads of what was fitted to add: too low is worse than too high
_TINY = float(np.finfo(np.float32).tiny)


def excess(
    smoothing: Smoothing, values: Floats, vectors: Any, residual: Any, falls: Floats
) -> Floats:
    """Estimate by how much the first k Ritz values are above the eigenvalues.

    The values, (b,), are ascending; vectors and residual ``L U - M U diag(values)`` are arrays or
    tensors, (n, b). `falls` says by how much the last step lowered the first k values. The estimate
    has their unit, and knows nothing of modes that the columns lack.

    To second order a Ritz value is too high by ``r^T (L - lambda M)^-1 r`` on what the columns do
    not span. For a few of them c = -L^-1 r comes from a Chebyshev iteration, as far down as the
    columns reach. L and not L - lambda M, for that is indefinite and what little r holds of lower
    modes would grow; with the frequency ``mu = -r^T c / c^T M c`` of the error, the sum is
    ``-r^T c / (1 - lambda / mu)``, or more where several take part (Jensen). The other columns are
    told by a fit to their number, ``r^T diag(L)^-1 r`` and falls, all logarithms.
    """
    k = len(falls)
    first = int(k > _COLUMNS)  # the lowest is the constant, as a rule
    columns = np.linspace(first, k - 1, min(_COLUMNS, k)).round().astype(int)
    ops, some, last = operations(residual), residual[:, columns], slice(3 * len(values) // 4, None)
    thetas = values[last] / ops.energies(smoothing.diagonal, vectors[:, last])
    share = _LOWEST * np.median(thetas) / smoothing.highest
    share = np.clip(share, 1 / (_REACH * _MOST**2), _WHOLE)
    lowest = np.full(len(columns), share * smoothing.highest)
    degree = math.ceil(math.sqrt(1 / (_REACH * share)) - 1e-9)
    steps = chebyshev_steps(lowest, smoothing.highest, degree)
    c = ops.correction(smoothing.singles, some, np.zeros(len(columns)), steps)
    gain = np.maximum(-ops.dots(some, c), _TINY)
    nearness = values[columns] * np.diag(ops.gram(smoothing.mass, c)) / gain
    known = gain / (1 - np.clip(nearness, 0.0, _NEAREST))
    return _fitted(columns, known, smoothing.sizes(residual)[:k], falls)


def _fitted(columns: NDArray[np.intp], known: Floats, sizes: Floats, falls: Floats) -> Floats:
    """Return what is known of some columns, and what follows from it for all."""
    k = len(falls)
    if len(columns) == k:
        return known
    size, fall = (np.log(np.maximum(x, _TINY)) for x in (sizes, falls))
    apart = np.clip(size - fall, *np.quantile((size - fall)[columns], [0, 1]))
    features = np.column_stack([np.ones(k), np.arange(k) / k, apart])
    mean = (size + fall) / 2
    left = np.log(known) - mean[columns]
    weights = np.linalg.lstsq(features[columns], left, rcond=1e-6)[0]
    spread = np.std(left - features[columns] @ weights, ddof=features.shape[1])
    found = np.exp(mean + features @ weights + _UNSURE * spread)
    found[columns] = known
    return np.asarray(found)


def in_order(values: Floats, errors: Floats) -> Floats:
    """Return the errors of ascending values that leave eigenvalues in ascending order.

    Of modes closer than their errors, the best are mixtures that hold as much of the lowest
    eigenvalue as the worst do: what these are too high by is told of the first.
    """
    left = values - errors
    sorts = np.sort(left)
    return np.where(sorts == left, errors, values - sorts)
