"""Triangles of a point cloud: the Delaunay star of each point in its tangent plane."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.threads import in_threads, ranges
from spectra_kit._core.types import Bools, Floats, Ints32
from spectra_kit.errors import InvalidInputError

_BLOCK = 4096  # points of one task: fixed, so that nothing depends on the number of threads
_TIE = 1e-7  # weight of a point, of its squared distance to the nearest: decides between diagonals
# Half of the neighbours are nearer than 0.71 of the last on a plane, than 0.5 along a curve.
_HALF = 0.6
_PATIENCE = 2  # doublings after the first plane
_WIDEST = 960  # neighbours: lines 100 times further apart than the points on them
_ENTRIES = 1 << 19  # neighbours of points that are held at once
_SMALLEST = 1e-150  # distance of two points, in the unit of the cloud: its square must be a number


def local_triangles(
    points: Floats, n_neighbors: int, first: FirstStars | None = None
) -> tuple[Ints32, Bools, Floats]:
    """Return the triangles of all stars, which stars are closed, and how far each point looked.

    Of shapes (t, 3), (n,) and (n,). The first corner of a triangle is the point whose star it
    belongs to, so a consistent triangle is there three times. What the first neighbours tell may
    have been found elsewhere.

    The triangle (0, p, q) belongs to the star of 0 if a sphere through its corners, centred in the
    tangent plane of 0, has no point inside. With (x, y) the projection of a point and z its
    squared distance in space, that is the convex hull of all (x, y) / z and the origin: one
    angular sort. The origin is itself a corner of that hull where the star is open.
    """
    n = len(points)
    stars, nearest, farthest = first or first_stars(points, n_neighbors)
    _check_apart(nearest)
    closed, farthest = stars.closed.copy(), farthest.copy()
    kept, wider = np.ones(n, dtype=bool), []
    # Points scanned in lines have neighbours on their own line alone, which tell no plane: more
    # of them, until there is a plane and the star closes in it. On a boundary it does not: there
    # they look about three times as far as the next line is, as 30 neighbours elsewhere do.
    asked, planes = np.flatnonzero(stars.lined), np.zeros(n, dtype=np.int8)
    if len(asked):
        tree, ties = _tree(points), _ties(nearest)
    while len(asked) and n_neighbors < min(_WIDEST, n - 1):
        n_neighbors = min(2 * n_neighbors, n - 1)
        for rows in np.array_split(asked, -(-len(asked) * n_neighbors // _ENTRIES)):
            near, _, middle, reach = _nearest(tree, rows, n_neighbors)
            wide = _stars(points, ties, rows, near)
            planes[rows] += ~wide.lined & (middle > _HALF * reach)
            done = (planes[rows] > 0) & (wide.closed | (planes[rows] > _PATIENCE))
            kept[rows] = ~done
            closed[rows[done]], farthest[rows[done]] = wide.closed[done], reach[done]
            wider.append(wide.triangles(done))
        asked = asked[kept[asked]]
    return np.concatenate([stars.triangles(kept), *wider]), closed, farthest


class FirstStars(NamedTuple):
    """Stars among the first neighbours of all points, and how far the nearest and the last are."""

    stars: Stars
    nearest: Floats
    farthest: Floats


def first_stars(points: Floats, n_neighbors: int) -> FirstStars:
    """Begin to look for the triangles of a cloud."""
    rows = np.arange(len(points))
    neighbors, nearest, _, farthest = _nearest(_tree(points), rows, n_neighbors)
    _check_apart(nearest)
    stars = _stars(points, _ties(nearest), rows, neighbors)
    return FirstStars(stars, nearest, farthest)


def _check_apart(nearest: Floats) -> None:
    if nearest.min() < _SMALLEST:
        raise InvalidInputError(
            "geometry",
            f"have points further apart than {_SMALLEST:g} of its extent",
            "two that are closer",
            advice="drop one of them",
        )


def nearest_by_tree(points: Floats, k: int) -> Ints32:
    """Return the k nearest neighbours of all points, (n, k)."""
    return _nearest(_tree(points), np.arange(len(points)), k)[0]


def _ties(nearest: Floats) -> Floats:
    """Return weights that are random but fixed: all stars cut a square along one diagonal."""
    return _TIE * nearest**2 * np.random.default_rng(0).random(len(nearest))


class Stars(NamedTuple):
    """Of the points `rows` (p,): corners (p, k), their number, and whether they go all around."""

    rows: NDArray[np.int64]
    links: Ints32
    sizes: Ints32
    closed: Bools
    lined: Bools
    """Whether the neighbours lie on a line."""

    def triangles(self, of: Bools) -> Ints32:
        """Return the triangles of those points."""
        from spectra_kit.operators._hulls import star_triangles  # numba is slow to import

        return star_triangles(*self[:-1], of)


def _tree(points: Floats) -> Any:
    from scipy.spatial import cKDTree  # slow to import

    return cKDTree(points)


def _nearest(tree: Any, rows: NDArray[np.int64], k: int) -> tuple[Ints32, Floats, Floats, Floats]:
    """Return the k neighbours (p, k) of some points; how far first, middle and last are, (p,)."""
    near, distances = np.empty((len(rows), k), dtype=np.int32), np.empty((3, len(rows)))

    def block(b: slice) -> None:
        distance, index = tree.query(tree.data[rows[b]], k + 1)
        near[b], distances[:, b] = index[:, 1:], distance[:, [1, k // 2, k]].T

    in_threads(block, ((slice(*cut),) for cut in ranges(len(rows), _BLOCK)))
    return near, *distances


def _stars(points: Floats, ties: Floats, rows: NDArray[np.int64], neighbors: Ints32) -> Stars:
    from spectra_kit.operators._hulls import hulls
    from spectra_kit.operators._planes import project

    p = len(rows)
    found = Stars(
        rows,
        np.empty_like(neighbors),
        np.empty(p, dtype=np.int32),
        np.empty(p, dtype=bool),
        np.empty(p, dtype=bool),
    )

    def block(b: slice) -> None:
        near = neighbors[b]
        x, y = np.empty(near.shape), np.empty(near.shape)
        project(points, ties, rows[b], near, x, y, found.lined[b])
        hulls(x, y, near, found.links[b], found.sizes[b], found.closed[b])

    in_threads(block, ((slice(*cut),) for cut in ranges(p, _BLOCK)))
    return found
