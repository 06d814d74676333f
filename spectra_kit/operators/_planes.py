"""Tangent planes at the points of a cloud, and their neighbours projected to them; numba."""

from __future__ import annotations

import math

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from spectra_kit._core.compiled import compiled
from spectra_kit._core.types import Bools, Floats, Ints32

# Neighbours on a line spread across it by 0.04 of what they do along it on exact rings, by 0.11 on
# noisy ones; random points and boundaries, and 26 models, by 0.087 at least of 600,000 points.
_LINE, _THICK = 0.05, 0.12
_SWEEPS = 30  # of rotations; six reach rounding
_PAIRS = ((0, 1), (0, 2), (1, 2))


@compiled()
def project(
    points: Floats,
    ties: Floats,
    rows: NDArray[np.int64],
    near: Ints32,
    x: Floats,
    y: Floats,
    lined: Bools,
) -> None:
    """Write x / z and y / z (p, k) of the neighbours of the points `rows`, and if they are lined.

    The plane is fitted to a point and its neighbours, whose last is the farthest; z is the squared
    distance in space, less the tie of a neighbour and more that of the point. Weights
    ``(1 - (d / d_max)^2)^2`` fade the farthest out: more of the curvature stays local.
    """
    k = near.shape[1]
    offsets, squares, sums = np.empty((k, 3)), np.empty(k), np.empty(3)
    moments, axes = np.empty((3, 3)), np.empty((3, 3))
    for row in range(len(rows)):
        i, total = rows[row], 1.0
        sums[:], moments[:] = 0.0, 0.0
        for j in range(k):
            squares[j] = 0.0
            for r in range(3):
                offsets[j, r] = points[near[row, j], r] - points[i, r]
                squares[j] += offsets[j, r] ** 2
        for j in range(k):
            weight = (1 - squares[j] / (1.001 * squares[k - 1])) ** 2
            total += weight
            for r in range(3):
                sums[r] += weight * offsets[j, r]
                for s in range(r + 1):
                    moments[r, s] += weight * offsets[j, r] * offsets[j, s]
        for r in range(3):
            for s in range(r + 1):
                moments[r, s] -= sums[r] * sums[s] / total
                moments[s, r] = moments[r, s]
        _diagonalize(moments, axes)
        least, middle, most = 0, 1, 2  # `np.argsort` takes longer than all of the sums
        if moments[1, 1] < moments[0, 0]:
            least, middle = 1, 0
        if moments[2, 2] < moments[middle, middle]:
            middle, most = 2, middle
        if moments[middle, middle] < moments[least, least]:
            least, middle = middle, least
        across, spread = moments[middle, middle], moments[most, most]
        # Noise spreads a line to either side alike.
        straight = across - moments[least, least] < _LINE * spread
        lined[row] = straight and across < _THICK * spread
        normal, along = axes[:, least], axes[:, most]
        side = 1.0 if normal[np.abs(normal).argmax()] > 0 else -1.0  # all flat stars turn alike
        a, b, c = side * normal[0], side * normal[1], side * normal[2]
        u, v, w = along[0], along[1], along[2]
        for j in range(k):
            z = squares[j] + ties[i] - ties[near[row, j]]
            p, q, r = offsets[j, 0], offsets[j, 1], offsets[j, 2]
            x[row, j] = (p * u + q * v + r * w) / z
            y[row, j] = (p * (b * w - c * v) + q * (c * u - a * w) + r * (a * v - b * u)) / z


@register_jitable
def _diagonalize(matrix: Floats, axes: Floats) -> None:
    """Turn a symmetric matrix (3, 3) into its eigenvalues, and write its eigenvectors as columns.

    By Jacobi's rotations; written out here, as compiled loops are found again by their own file.
    """
    axes[:] = np.eye(3)
    for _ in range(_SWEEPS):
        off = matrix[0, 1] ** 2 + matrix[0, 2] ** 2 + matrix[1, 2] ** 2
        if off <= 1e-33 * (matrix[0, 0] ** 2 + matrix[1, 1] ** 2 + matrix[2, 2] ** 2):
            return
        for p, q in _PAIRS:
            if matrix[p, q] == 0.0:
                continue
            theta = (matrix[q, q] - matrix[p, p]) / (2 * matrix[p, q])
            t = math.copysign(1.0, theta) / (abs(theta) + math.hypot(theta, 1.0))
            cos = 1 / math.hypot(t, 1.0)
            sin = t * cos
            for r in range(3):
                one, other = matrix[r, p], matrix[r, q]
                matrix[r, p], matrix[r, q] = cos * one - sin * other, sin * one + cos * other
            for r in range(3):
                one, other = matrix[p, r], matrix[q, r]
                matrix[p, r], matrix[q, r] = cos * one - sin * other, sin * one + cos * other
                one, other = axes[r, p], axes[r, q]
                axes[r, p], axes[r, q] = cos * one - sin * other, sin * one + cos * other
