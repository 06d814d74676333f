"""`delaunay_laplacian`: point clouds by local Delaunay triangulations, glued and flipped."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from spectra_kit._validate import check_positive
from spectra_kit.errors import ConvergenceError, InvalidInputError
from spectra_kit.geometry.shapes import PointCloud
from spectra_kit.linalg.threads import in_threads, thread_count
from spectra_kit.operators._checks import check_cloud_usable
from spectra_kit.operators.laplacian import Laplacian

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

_BLOCK = 16_384  # points of one task: fixed, so that nothing depends on the number of threads
_FLIPS = 10  # of a half-edge, before giving up; the most seen is 0.14, along a thin line
_TIE = 1e-7  # weight of a point, of its squared distance to the nearest: decides between diagonals


def delaunay_laplacian(
    cloud: PointCloud, *, mollify_factor: float = 1e-5, n_neighbors: int = 30
) -> Laplacian:
    """Build the intrinsic Delaunay Laplacian of a point cloud from local triangulations.

    Parameters
    ----------
    cloud : PointCloud
        With n points.
    mollify_factor : float, default 1e-5
        Intrinsic mollification of (near) degenerate triangles, relative to their mean side.
    n_neighbors : int, default 30
        Neighbours that define the tangent plane of a point and are candidates for its triangles;
        capped at n - 1. Fewer than 30 miss triangles of random points, more may bridge a gap.

    Returns
    -------
    Laplacian
        Neumann; edge weights are not negative beyond rounding; mass in the squared length unit
        of `cloud`. The same bits whatever the number of threads.

    Raises
    ------
    InvalidInputError
        If `cloud` is no PointCloud, points coincide, lie on one line, or are fewer than four, or
        a point is in no triangle.
    ConvergenceError
        If the edge flips do not end, which rounding could do to a degenerate cloud; none is known.

    Notes
    -----
    Each point contributes its star in the tangential Delaunay complex (Boissonnat and Ghosh,
    *Manifold reconstruction using tangential Delaunay complexes*, Discrete Comput. Geom. 2014),
    with a third of each triangle's energy and area. At each edge, triangles that continue each
    other are glued, and the intrinsic surface is flipped to Delaunay, as in Sharp and Crane, *A
    Laplacian for Nonmanifold Triangle Meshes*, SGP 2020. `robust_laplacian` glues the triangles
    of an edge in cyclic order instead; equal ones, of which a consistent triangulation has three,
    then become pillows that the flips deflate.

    Examples
    --------
    >>> from spectra_kit.geometry import sphere
    >>> laplacian = delaunay_laplacian(sphere(subdivisions=3).geometry.as_cloud())
    >>> round(laplacian.area, 2)
    12.51
    """
    if not isinstance(cloud, PointCloud):
        raise InvalidInputError(
            f"`cloud` must be a PointCloud, got {type(cloud).__name__};"
            " for meshes use robust_laplacian, or `mesh.as_cloud()`"
        )
    start = time.perf_counter()
    check_positive("mollify_factor", mollify_factor)
    n_neighbors = check_cloud_usable(cloud, n_neighbors)
    # Neighbours in space become neighbours in memory; any unit of length becomes about 1.
    order = cKDTree(cloud.points).indices
    unit = float(np.ptp(cloud.points, axis=0).max())
    points = (cloud.points[order] - cloud.points.mean(axis=0)) / unit
    rows, columns, weights, areas = _glued_surface(
        points, _local_triangles(points, n_neighbors), mollify_factor
    )
    mass = np.empty(cloud.n)
    mass[order] = areas * unit**2
    if not mass.all():
        raise InvalidInputError(
            f"`cloud` has {int((mass == 0).sum())} points in no triangle (such as"
            f" {int(np.argmin(mass))}): their neighbours lie on one line;"
            " remove such curves first"
        )
    upper = sparse.csr_array((weights, (order[rows], order[columns])), shape=(cloud.n, cloud.n))
    adjacency = upper + upper.T
    return Laplacian(
        sparse.diags_array(adjacency.sum(axis=1)) - adjacency,
        mass,
        cloud.points,
        operator=f"delaunay_laplacian(mollify_factor={mollify_factor:g},"
        f" n_neighbors={n_neighbors})",
        seconds=time.perf_counter() - start,
    )


def _local_triangles(points: Floats, n_neighbors: int) -> Ints:
    """Return the triangles of all stars, a consistent one three times, shape (t, 3)."""
    from spectra_kit.operators._stars import stars, triangles

    tree = cKDTree(points)
    n = len(points)
    owners = np.arange(n, dtype=np.int32)
    nearest, neighbors = np.empty(n), np.empty((n, n_neighbors), dtype=np.int32)
    blocks = [slice(first, first + _BLOCK) for first in range(0, n, _BLOCK)]
    for b in blocks:
        distance, index = tree.query(points[b], n_neighbors + 1, workers=thread_count())
        nearest[b], neighbors[b] = distance[:, 1], index[:, 1:]
    # Random but fixed: all stars decide alike between the diagonals of a square.
    ties = _TIE * nearest**2 * np.random.default_rng(0).random(n)
    links, sizes = np.empty_like(neighbors), np.empty(n, dtype=np.int32)
    closed = np.empty(n, dtype=bool)
    in_threads(
        stars,
        ((points, owners[b], neighbors[b], ties, links[b], sizes[b], closed[b]) for b in blocks),
    )
    return triangles(owners, links, sizes, closed)


def _glued_surface(
    points: Floats, triangles: Ints, mollify_factor: float
) -> tuple[Ints, Ints, Floats, Floats]:
    """Return ends and weights of the edges of the glued, flipped triangles, and the mass."""
    from spectra_kit.operators._cover import (
        edge_weights,
        flip_to_delaunay,
        glue,
        half_edges,
        sides_by_corner,
    )

    n = len(points)
    starts, sides = sides_by_corner(triangles, n)
    twins = np.empty(6 * len(triangles), dtype=np.int32)
    in_threads(
        glue,
        (
            (points, triangles, starts, sides, first, min(first + _BLOCK, n), twins)
            for first in range(0, n, _BLOCK)
        ),
    )
    del starts, sides
    tails, lengths = half_edges(points, triangles, mollify_factor)
    most = _FLIPS * len(tails)
    if not flip_to_delaunay(tails, lengths, twins, most):
        raise ConvergenceError(
            f"the triangles of `cloud` must become Delaunay by edge flips, got no end to them after"
            f" {most}; raise `mollify_factor`, or drop points that nearly coincide"
        )
    rows, columns, weights, mass = edge_weights(tails, lengths, twins, n)
    # Three stars, a front and a back.
    return rows, columns, weights / 6, mass / 6
