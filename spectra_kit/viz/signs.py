"""One choice of the sign of a mode, which means nothing, for all pictures of it."""

from __future__ import annotations

import numpy as np

from spectra_kit._types import Floats

_TIED = 1e-6  # relative; differences below it may be rounding


def display_signs(eigenvectors: Floats) -> Floats:
    """Return the factor (k,), 1 or -1, with which each mode, a column of (n, k), is shown.

    1 where the largest entry in absolute value is positive, otherwise -1. Where the largest and the
    smallest entry are opposite to rounding, the sum of the cubes decides, and where that is zero
    too, the first of the largest entries.
    """
    peak = np.abs(eigenvectors).max(axis=0, initial=0.0)
    scaled = eigenvectors / np.where(peak > 0, peak, 1.0)
    lean = scaled.max(axis=0, initial=0.0) + scaled.min(axis=0, initial=0.0)
    cubes = scaled**3
    skew = cubes.sum(axis=0) / np.maximum(np.abs(cubes).sum(axis=0), 1.0)
    first = (np.abs(scaled) >= 1.0 - _TIED).argmax(axis=0)
    foremost = np.take_along_axis(scaled, first[None], axis=0)[0]
    decisive = np.where(np.abs(lean) > _TIED, lean, np.where(np.abs(skew) > _TIED, skew, foremost))
    return np.where(decisive < 0, -1.0, 1.0)
