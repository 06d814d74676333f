"""Units of length that are powers of two: in them nothing overflows, and nothing is rounded."""

from __future__ import annotations

import numpy as np

from spectra_kit._core.types import Floats
from spectra_kit.geometry.shapes import TriangleMesh


def power_of_two(length: float | Floats) -> Floats:
    """Return the largest power of two that is not above `length`, 0 for 0."""
    return np.where(length, np.ldexp(1.0, np.frexp(length)[1] - 1), 0.0)


def box_unit(points: Floats) -> float:
    """Return about the longest side of the box around all points (n, 3); 1 where they coincide."""
    with np.errstate(over="ignore"):
        extent = np.ptp(points, axis=0).max()
    return float(power_of_two(min(extent, np.finfo(float).max))) or 1.0


def component_units(mesh: TriangleMesh) -> Floats:
    """Return about the longest side of the box around each vertex's component, shape (n,).

    0 where all its points coincide.
    """
    labels = mesh.component_labels
    order = np.argsort(labels, kind="stable")
    starts = np.flatnonzero(np.diff(labels[order], prepend=-1))
    low, high = (f.reduceat(mesh.points[order], starts) for f in (np.minimum, np.maximum))
    with np.errstate(over="ignore"):
        extents = (high - low).max(axis=1)
    return power_of_two(np.minimum(extents, np.finfo(float).max))[labels]
