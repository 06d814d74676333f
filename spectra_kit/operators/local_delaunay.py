"""Triangles of a point cloud: the Delaunay star of each point in its tangent plane."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from spectra_kit._types import Bools, Floats
from spectra_kit.errors import InvalidInputError
from spectra_kit.linalg.threads import in_threads, ranges, thread_count

Ints = NDArray[np.int32]

_BLOCK = 16_384  # points of one task: fixed, so that nothing depends on the number of threads
_TIE = 1e-7  # weight of a point, of its squared distance to the nearest: decides between diagonals
# Neighbours on a line have no spread across it: on rings at most 0.04 of that along, on 26 models,
# random points and boundaries at least 0.087, the least of 600,000 points.
_LINE = 0.05
_WIDEST = 960  # neighbours: lines 100 times further apart than the points on them
_ENTRIES = _BLOCK * 32  # neighbours of points that are held at once
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
    tree = cKDTree(points)
    n = len(points)
    neighbors, nearest, farthest = _nearest(tree, np.arange(n), n_neighbors)
    if nearest.min() < _SMALLEST:
        raise InvalidInputError(
            "geometry",
            f"have points further apart than {_SMALLEST:g} of its extent",
            "two that are closer",
            advice="drop one of them",
        )
    # Random but fixed: all stars decide alike between the diagonals of a square.
    ties = _TIE * nearest**2 * np.random.default_rng(0).random(n)
    stars = _stars(points, ties, np.arange(n), neighbors)
    closed, chosen = stars.closed, []
    # Points scanned in lines have neighbours on their own line alone, which tell no plane: more
    # of them, until there is a plane and the star closes in it, or does not close once more.
    asked, flat = np.flatnonzero(stars.width < _LINE), np.zeros(n, dtype=bool)
    while len(asked) and n_neighbors < min(_WIDEST, n - 1):
        n_neighbors = min(2 * n_neighbors, n - 1)
        rest = []
        for rows in np.array_split(asked, -(-len(asked) * n_neighbors // _ENTRIES)):
            near, _, reach = _nearest(tree, rows, n_neighbors)
            wide = _stars(points, ties, rows, near)
            plane = wide.width >= _LINE
            done = plane & (wide.closed | flat[rows])
            flat[rows] = plane
            chosen.append(wide.only(done))
            closed[rows[done]], farthest[rows[done]] = wide.closed[done], reach[done]
            rest.append(rows[~done])
        asked = np.concatenate(rest)
    if chosen:
        kept = np.ones(n, dtype=bool)
        kept[np.concatenate([one.rows for one in chosen])] = False
        chosen.insert(0, stars.only(kept))
    return np.concatenate([one.triangles() for one in chosen or [stars]]), closed, farthest


class _Stars(NamedTuple):
    """Of the points `rows` (p,): corners (p, k), their number, and whether they go all around."""

    rows: NDArray[np.int64]
    links: Ints
    sizes: Ints
    closed: Bools
    width: Floats
    """Spread of the neighbours across to that along the direction of most: 0 on a line."""

    def only(self, mask: Bools) -> _Stars:
        return _Stars._make(array[mask] for array in self)

    def triangles(self) -> Ints:
        counts = np.where(self.closed, self.sizes, np.maximum(self.sizes - 1, 0))
        place = np.repeat(np.arange(len(self.rows)), counts)
        corner = np.arange(len(place)) - np.repeat(np.cumsum(counts) - counts, counts)
        following = (corner + 1) % self.sizes[place]
        ends = self.links[place, corner], self.links[place, following]
        return np.column_stack([self.rows[place], *ends]).astype(np.int32)


def _nearest(tree: cKDTree, rows: NDArray[np.int64], k: int) -> tuple[Ints, Floats, Floats]:
    """Return the k neighbours (p, k) of some points, and how far the first and last are, (p,)."""
    near, first, last = np.empty((len(rows), k), np.int32), np.empty(len(rows)), np.empty(len(rows))
    for b in (slice(*cut) for cut in ranges(len(rows), _BLOCK)):
        distance, index = tree.query(tree.data[rows[b]], k + 1, workers=thread_count())
        near[b], first[b], last[b] = index[:, 1:], distance[:, 1], distance[:, -1]
    return near, first, last


def _stars(points: Floats, ties: Floats, rows: NDArray[np.int64], neighbors: Ints) -> _Stars:
    from spectra_kit.operators._hulls import hulls

    p = len(rows)
    found = _Stars(
        rows,
        np.empty_like(neighbors),
        np.empty(p, dtype=np.int32),
        np.empty(p, dtype=bool),
        np.empty(p),
    )

    def block(b: slice) -> None:
        near = neighbors[b]
        offsets = points[near] - points[rows[b], None]
        z = np.square(offsets).sum(axis=2)
        u, v, found.width[b] = _tangents(offsets, z)
        z += ties[rows[b], None] - ties[near]
        x, y = (np.einsum("pkr,pr->pk", offsets, axis) / z for axis in (u, v))
        hulls(x, y, near, found.links[b], found.sizes[b], found.closed[b])

    in_threads(block, ((slice(*cut),) for cut in ranges(p, _BLOCK)))
    return found


def _tangents(offsets: Floats, squares: Floats) -> tuple[Floats, Floats, Floats]:
    """Return orthonormal frames (p, 3) of the planes fitted to points and their neighbours.

    And the spread across to that along them (p,).

    Weights ``(1 - (d / d_max)^2)^2`` fade the farthest out: more of the curvature stays local.
    """
    weights = (1 - squares / (1.001 * squares[:, -1:])) ** 2
    weighted = weights[:, :, None] * offsets
    sums = weighted.sum(axis=1)
    moments = weighted.transpose(0, 2, 1) @ offsets
    moments -= sums[:, :, None] * sums[:, None] / (1 + weights.sum(axis=1))[:, None, None]
    spreads, axes = np.linalg.eigh(moments)  # of the least spread first
    normals, along = axes[:, :, 0], axes[:, :, 2]
    largest = np.abs(normals).argmax(axis=1)[:, None]  # is positive: all flat stars turn alike
    normals = normals * np.sign(np.take_along_axis(normals, largest, axis=1))
    return along, np.cross(normals, along), spreads[:, 1] / spreads[:, 2]
