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

    The triangle (0, p, q) belongs to the star of 0 if a sphere through its corners, centred in the
    tangent plane of 0, has no point inside. With (x, y) the projection of a point and z its
    squared distance in space, that is the convex hull of all (x, y) / z and the origin: one
    angular sort. The origin is itself a corner of that hull where the star is open.
    """
    from spectra_kit.operators._hulls import hulls

    tree = cKDTree(points)
    n = len(points)
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

    def stars(b: slice) -> None:
        near = neighbors[b]
        offsets = points[near] - points[b, None]
        z = np.square(offsets).sum(axis=2)
        u, v = _tangents(offsets, z)
        z += ties[b, None] - ties[near]
        x, y = (np.einsum("pkr,pr->pk", offsets, axis) / z for axis in (u, v))
        hulls(x, y, near, links[b], sizes[b], closed[b])

    in_threads(stars, ((b,) for b in blocks))
    counts = np.where(closed, sizes, np.maximum(sizes - 1, 0))
    owner = np.repeat(np.arange(n), counts)
    corner = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
    following = (corner + 1) % sizes[owner]
    triangles = np.column_stack([owner, links[owner, corner], links[owner, following]])
    return triangles.astype(np.int32), closed, farthest


def _tangents(offsets: Floats, squares: Floats) -> tuple[Floats, Floats]:
    """Return orthonormal frames (p, 3) of the planes fitted to points and their neighbours.

    Weights ``(1 - (d / d_max)^2)^2`` fade the farthest out: more of the curvature stays local.
    """
    weights = (1 - squares / (1.001 * squares[:, -1:])) ** 2
    weighted = weights[:, :, None] * offsets
    sums = weighted.sum(axis=1)
    moments = weighted.transpose(0, 2, 1) @ offsets
    moments -= sums[:, :, None] * sums[:, None] / (1 + weights.sum(axis=1))[:, None, None]
    axes = np.linalg.eigh(moments)[1]  # of the least spread first
    normals, along = axes[:, :, 0], axes[:, :, 2]
    largest = np.abs(normals).argmax(axis=1)[:, None]  # is positive: all flat stars turn alike
    normals = normals * np.sign(np.take_along_axis(normals, largest, axis=1))
    return along, np.cross(normals, along)
