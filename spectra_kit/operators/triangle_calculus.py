"""Gradients and divergences on triangles given by the lengths of their sides.

And derivatives by these lengths, of energies and areas that are sums over triangles.

The frame of a triangle has its origin at corner 0 and side 0 along x; corner 2 is at
``(x, y)``, y > 0. Nothing else of where it lies in space is known, or needed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from spectra_kit._core.types import Floats, Ints32


def areas(lengths: Floats) -> Floats:
    """Area of each triangle, shape (f,)."""
    return np.asarray(lengths[:, 0] * apexes(lengths)[:, 1] / 2)


def linear_mass(simplices: NDArray[np.integer], measures: Floats, n: int) -> sparse.csr_array:
    """Return the consistent mass of linear functions, (n, n), on triangles or tetrahedra (m, c).

    Of a simplex with c corners, of this area or volume, the integral of the product of two hat
    functions is its ``measure / (c (c + 1))``, twice that of a square.
    """
    corners = simplices.shape[1]
    shares = (np.ones((corners, corners)) + np.eye(corners)) / (corners * (corners + 1))
    entries = measures[:, None, None] * shares
    rows = np.broadcast_to(simplices[:, :, None], entries.shape).ravel()
    columns = np.broadcast_to(simplices[:, None, :], entries.shape).ravel()
    return sparse.csr_array((entries.ravel(), (rows, columns)), shape=(n, n))


def apexes(lengths: Floats) -> Floats:
    """Where corner 2 of each triangle is in its frame, shape (f, 2)."""
    a = lengths[:, 0]
    b, c = lengths[:, 1] / a, lengths[:, 2] / a  # ratios: in any unit, nothing overflows
    square = (1 + b + c) * (b + c - 1) * (c + 1 - b) * (1 + b - c)
    return np.stack([a * (1 + c * c - b * b) / 2, a * np.sqrt(np.maximum(square, 0)) / 2], axis=1)


def gradients(corners: Ints32, lengths: Floats, values: Floats) -> Floats:
    """Gradient of the function with `values` at the points, in each triangle's frame."""
    x, y = apexes(lengths).T
    origin, one, two = values[corners].T
    along = (one - origin) / lengths[:, 0]
    return np.stack([along, (two - origin - x * along) / y], axis=1)


def divergences(corners: Ints32, lengths: Floats, vectors: Floats, n: int) -> Floats:
    """Adjoint of `gradients` for the areas: ``sum_t area <grad hat_i, vector>`` at each point i.

    The gradient of the hat function of a corner times the area is half the opposite side, turned.
    """
    x, y = apexes(lengths).T
    along, across = vectors.T
    one, two = (y * along - x * across) / 2, lengths[:, 0] * across / 2
    shares = np.stack([-(one + two), one, two], axis=1)
    return np.bincount(corners.ravel(), shares.ravel(), minlength=n).astype(np.float64)


def energy_slopes(lengths: Floats, squares: Floats) -> Floats:
    """Derivative by each side of the energy ``sum_c squares_c cot_c / 2`` of a triangle, (f, 3).

    ``squares[:, c]`` is the squared difference of a function along side c, and ``cot_c`` the
    cotangent of the angle opposite.
    """
    return _weighted_cotangent_slopes(lengths, squares / 2)


def lumped_slopes(lengths: Floats, weights: Floats) -> Floats:
    """Derivative by each side of ``sum_c weights_c area / 3``, of the corners c, (f, 3)."""
    return _area_slopes(lengths, weights.sum(axis=1) / 3)


def voronoi_slopes(lengths: Floats, weights: Floats) -> Floats:
    """Derivative by each side of ``sum_c weights_c area_c`` with mixed Voronoi areas, (f, 3).

    Corner c of a triangle of acute angles has what is nearer to it than to the others; where one
    is obtuse, it has a half of the triangle, and the others a quarter each (Meyer et al., *Discrete
    Differential-Geometry Operators for Triangulated 2-Manifolds*, 2003).
    """
    cotangents, squared = opposite_cotangents(lengths), lengths**2
    # Along side c, either corner has a triangle of height l cot / 2 over half of it.
    along = (weights + np.roll(weights, -1, axis=1)) / 8
    acute = _weighted_cotangent_slopes(lengths, along * squared) + 2 * lengths * along * cotangents
    # The angle at a corner is opposite the next side.
    large = np.asarray(np.roll(cotangents, -1, axis=1) < 0)
    shares = np.where(large, 1 / 2, 1 / 4)
    obtuse = _area_slopes(lengths, (shares * weights).sum(axis=1))
    return np.where(large.any(axis=1, keepdims=True), obtuse, acute)


def opposite_cotangents(lengths: Floats) -> Floats:
    """Cotangent of the angle opposite each side."""
    squared = lengths**2
    return np.asarray(
        (squared.sum(axis=1, keepdims=True) - 2 * squared) / (4 * areas(lengths)[:, None])
    )


def _area_slopes(lengths: Floats, weights: Floats) -> Floats:
    """Derivative by each side of the area, times a weight of the triangle: dA / dl = l cot / 2."""
    return np.asarray(weights[:, None] * lengths * opposite_cotangents(lengths) / 2)


def _weighted_cotangent_slopes(lengths: Floats, weights: Floats) -> Floats:
    """Derivative by each side of ``sum_c weights_c cot_c``, the weights held.

    With s the squares of the sides, ``4 A d cot_c / d s_j = 1 - cot_c cot_j``, and
    ``-1 - cot_c^2`` for j = c.
    """
    cotangents = opposite_cotangents(lengths)
    energy = (weights * cotangents).sum(axis=1, keepdims=True)
    total = weights.sum(axis=1, keepdims=True)
    by_square = (total - 2 * weights - cotangents * energy) / (4 * areas(lengths)[:, None])
    return np.asarray(2 * lengths * by_square)
