"""Triangles of a point cloud: the Delaunay star of each point in its tangent plane."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from spectra_kit._types import Bools, Floats
from spectra_kit.errors import InvalidInputError
from spectra_kit.linalg.threads import in_threads, ranges, thread_count

Ints = NDArray[np.int32]

_BLOCK = 16_384  # points of one task: fixed, so that nothing depends on the number of threads
_TIE = 1e-7  # weight of a point, of its squared distance to the nearest: decides between diagonals
_SMALLEST = 1e-150  # distance of two points, in the unit of the cloud: its square must be a number


def local_triangles(points: Floats, n_neighbors: int) -> tuple[Ints, Bools, Floats]:
    """Return the triangles of all stars, which stars are closed, and how far each point looked.

    Of shapes (t, 3), (n,) and (n,). The first corner of a triangle is the point whose star it
    belongs to, so a consistent triangle is there three times.
    """
    from spectra_kit.operators._stars import stars, triangles

    tree = cKDTree(points)
    n = len(points)
    owners = np.arange(n, dtype=np.int32)
    nearest, farthest = np.empty(n), np.empty(n)
    neighbors = np.empty((n, n_neighbors), dtype=np.int32)
    blocks = [slice(*rows) for rows in ranges(n, _BLOCK)]
    for b in blocks:
        distance, index = tree.query(points[b], n_neighbors + 1, workers=thread_count())
        nearest[b], farthest[b], neighbors[b] = distance[:, 1], distance[:, -1], index[:, 1:]
    if nearest.min() < _SMALLEST:
        raise InvalidInputError(
            "geometry",
            f"have points further apart than {_SMALLEST:g} of its extent",
            "two that are closer",
            advice="drop one of them",
        )
    # Random but fixed: all stars decide alike between the diagonals of a square.
    ties = _TIE * nearest**2 * np.random.default_rng(0).random(n)
    links, sizes = np.empty_like(neighbors), np.empty(n, dtype=np.int32)
    closed = np.empty(n, dtype=bool)
    in_threads(
        stars,
        ((points, owners[b], neighbors[b], ties, links[b], sizes[b], closed[b]) for b in blocks),
    )
    return triangles(owners, links, sizes, closed), closed, farthest
