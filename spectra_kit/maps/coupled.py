"""ZoomOut of many maps of one pair at once, both ways, on samples: what joins maps of others.

A map that is composed of others is right in its lowest modes at best; it is cut off there, and
grown anew on its own pair.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from spectra_kit._core.types import Floats, Ints
from spectra_kit.maps.prepare import Prepared
from spectra_kit.maps.zoomout import schedule

_STEP = 6  # modes at a time


class Sampled(NamedTuple):
    """The modes of a surface at its samples, and their QR factorisation."""

    rows: Floats  # (s, k)
    Q: Floats  # (s, k)
    R: Floats  # (k, k)

    @classmethod
    def of(cls, shape: Prepared, k: int) -> Sampled:
        """Return the lowest k modes."""
        rows = shape.spectrum.eigenvectors[shape.samples, :k]
        return cls(rows, *np.linalg.qr(rows))

    def fit(self, values: Floats, k: int) -> Floats:
        """Return the coefficients on k modes of functions at the samples, (c, s, d): (c, k, d)."""
        fitted: Floats = solve_triangular(self.R[:k, :k], self.Q[:, :k].T) @ values
        return fitted


def coupled_zoomout(source: Sampled, target: Sampled, maps: Floats, lead: int) -> Floats:
    """Return the maps, (c, k, k), grown anew from their `lead` lowest modes to all k.

    Each step is one of `bijective_zoomout`.
    """
    k = source.rows.shape[1]
    C = maps[:, :lead, :lead]
    for size, _ in schedule((lead, lead), k, _STEP):
        have = C.shape[1]
        A, B = source.rows[:, :have], target.rows[:, :have]
        to_source = _nearest(A @ C.transpose(0, 2, 1), B)
        to_target = _nearest(B @ C, A)
        there = target.fit(source.rows[to_source, :size], size)
        back = source.fit(target.rows[to_target, :size], size)
        C = 0.5 * (there + back.transpose(0, 2, 1))
    return C


def _nearest(images: Floats, rows: Floats) -> Ints:
    """Return the nearest of each map's images, (c, s, k), to each of the rows, (r, k): (c, r)."""
    columns = images.transpose(0, 2, 1).astype(np.float32)
    scores = rows.astype(np.float32) @ columns
    scores -= 0.5 * (columns**2).sum(axis=1)[:, None]
    return np.asarray(scores.argmax(axis=2))
