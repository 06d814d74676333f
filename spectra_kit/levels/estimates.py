"""How far smoothed modes are still off, from what their last steps gained."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spectra_kit._types import Floats

_TINY = float(np.finfo(float).tiny)
_LAST = 0.3  # share of an error that a step tends to leave, as the lowest frequencies are left
_LEFT = 1.8  # by which the shares told by residuals and by falls are too small, in the mean
_SLOWEST = 0.9  # share beyond which steps gain too little to say what is left


def estimated(falls: Sequence[Floats], shrunk: Floats) -> Floats:
    """Return what is left of relative errors after steps that lowered them by the `falls`.

    A step leaves a share of an error. The ratio by which it shrunk the residual tells less than
    this share, for residuals weigh high frequencies more, which go first. The ratio of two falls is
    the share that the step before left; that of the last one lies between it and what remains in
    the end. So the two are taken together; the constants are those of seven meshes.
    """
    share = shrunk
    if len(falls) > 1:
        before = np.minimum(falls[-1] / np.maximum(falls[-2], _TINY), 1.0)
        share = np.sqrt(shrunk * np.cbrt(_LAST * before**2))
    share = np.minimum(_LEFT * share, _SLOWEST)
    return np.asarray(falls[-1] * share / (1 - share))
