"""Well-spread subsets of the points of an operator."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.sparse.csgraph import connected_components

from spectra_kit._core.types import Ints
from spectra_kit._core.validate import check_count, frozen
from spectra_kit._sparse.products import rows_of
from spectra_kit.errors import InvalidInputError

if TYPE_CHECKING:
    from spectra_kit.eigen.multigrid.coarse import Coarse
    from spectra_kit.operators.laplacian import Laplacian

# Radius of the balls, where the subset has one point per unit of area and all points `c` times as
# many: 0.99 - 0.37 / sqrt(c). Measured on meshes; the first guess is the last one there.
_PACKED, _GRAINY = 0.99, 0.37
_ROUNDS = 6  # of correction of the radius
_FEWEST = 0.9  # of the points asked for that are near enough


class Subset(NamedTuple):
    """Points that represent all others.

    Attributes
    ----------
    indices : ndarray of shape (n_subset,)
        Ascending.
    radius : float
        Every point of the operator is nearer than this to one of them, in a straight line and
        connected to it within the ball, in length.
    """

    indices: Ints
    radius: float


def well_spread(operator: Laplacian | Coarse, n_points: int) -> Subset:
    """Choose about `n_points` points, evenly spread over the surface whatever the sampling.

    Parameters
    ----------
    operator : Laplacian or Coarse
        The off-diagonal pattern of its stiffness says which points are neighbours.
    n_points : int
        At most so many are chosen, and seldom fewer than 0.9 times as many; at least 1.

    Returns
    -------
    Subset
        No two closer than ``radius`` unless two sheets of the surface come as close. Where points
        lie further apart than that, all are taken.

    Raises
    ------
    InvalidInputError
        If `n_points` is not in [1, n], or less than the number of connected parts.

    Notes
    -----
    A maximal packing of balls by an advancing front, in O(n). It is deterministic.

    Examples
    --------
    >>> from spectra_kit import robust_laplacian
    >>> from spectra_kit.geometry import sphere
    >>> from spectra_kit.eigen.multigrid import well_spread
    >>> subset = well_spread(robust_laplacian(sphere(subdivisions=4).geometry), 100)
    >>> 85 <= len(subset.indices) <= 100
    True
    """
    from spectra_kit.eigen.multigrid._kernels import cover

    check_count("n_points", n_points, low=1, high=operator.n)
    graph, points = operator.stiffness, frozen(operator.points)
    starts, neighbours, _ = rows_of(graph)
    grain = _GRAINY * np.sqrt(n_points / operator.n)
    radius = (_PACKED - grain) * np.sqrt(operator.area / n_points)
    low, high = 0.0, np.inf  # radii known to give too many and too few
    best: Subset | None = None
    for _ in range(_ROUNDS):
        indices = cover(starts, neighbours, points, radius)
        count = len(indices)
        if count > n_points:
            low = radius
        else:
            high = radius
            if best is None or count > len(best.indices):
                best = Subset(np.sort(indices).astype(np.int64), float(radius))
            if count >= _FEWEST * n_points:
                break
        guess = radius * np.sqrt(count / (0.5 * (1 + _FEWEST) * n_points))
        inside = low < guess < high
        radius = guess if inside or high == np.inf else 0.5 * (low + high)
    if best is None and n_points < (parts := connected_components(graph, directed=False)[0]):
        raise InvalidInputError(
            "n_points",
            f"be at least {parts}, one for each connected part of the operator",
            n_points,
            advice="ask for more, or treat the parts one by one",
        )
    while best is None:  # thin shapes: their count falls more slowly than the area suggests
        radius *= 1.5
        indices = cover(starts, neighbours, points, radius)
        if len(indices) <= n_points:
            best = Subset(np.sort(indices).astype(np.int64), float(radius))
    return best
