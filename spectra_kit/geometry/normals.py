"""Normals of point clouds: estimated from neighbours, then turned outwards together."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_count, real_array
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import PointCloud
from spectra_kit.geometry.signs import agree_on_signs, symmetric_votes, turn_outwards
from spectra_kit.geometry.units import box_unit


@checked
def estimate_normals(cloud: PointCloud, *, n_neighbors: int = 12) -> Floats:
    """Fit a plane to the neighbours of each point.

    Parameters
    ----------
    cloud : PointCloud
        With n points, at least three.
    n_neighbors : int, default 12
        Of the point itself, which counts too; capped at n - 1. More smooth noise and round edges.

    Returns
    -------
    ndarray of shape (n, 3)
        Unit vectors, each with one of its two signs; see `orient_normals`.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.geometry import estimate_normals, sphere
    >>> cloud = sphere(subdivisions=3).geometry.as_cloud()
    >>> normals = estimate_normals(cloud)
    >>> bool(np.allclose(np.abs(np.sum(normals * cloud.points, axis=1)), 1, atol=0.01))
    True
    """
    points = _check_cloud(cloud)
    _, near = _neighbors(points, n_neighbors)
    offsets = points[np.column_stack([np.arange(len(points)), near])]
    offsets = offsets - offsets.mean(axis=1, keepdims=True)
    _, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets))
    return np.asarray(axes[:, :, 0])


@checked
def orient_normals(cloud: PointCloud, normals: ArrayLike, *, n_neighbors: int = 12) -> Floats:
    """Turn normals such that they agree with each other and point outwards.

    Parameters
    ----------
    cloud : PointCloud
        With n points, at least three.
    normals : array_like of shape (n, 3)
        Unit vectors of any sign, such as those of `estimate_normals`.
    n_neighbors : int, default 12
        Points that agree with a point on the side.

    Returns
    -------
    ndarray of shape (n, 3)
        `normals` times 1 or -1. Each component of the neighbour graph is turned outwards on its
        own; on an open sheet, away from its centroid.

    Notes
    -----
    Neighbours vote for the side with the inner product of their normals (Hoppe et al. 1992), and
    groups that agree vote together; parts that came out inside out are found by their winding
    number (Barill et al. 2018). Fails where two sheets are nearer to each other than the points
    of one.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.geometry import estimate_normals, orient_normals, torus
    >>> cloud = torus(n=600).geometry.as_cloud()
    >>> normals = orient_normals(cloud, estimate_normals(cloud))
    >>> outer = np.hypot(*cloud.points[:, :2].T) > 1
    >>> bool((np.sum(normals * cloud.points, axis=1)[outer] > 0).all())
    True
    """
    points = _check_cloud(cloud)
    vectors = real_array("normals", normals)
    if vectors.shape != points.shape:
        raise InvalidInputError(
            "normals", f"have shape {points.shape} like the points", vectors.shape
        )
    if not np.allclose(np.linalg.norm(vectors, axis=1), 1, atol=1e-6):
        raise InvalidInputError("normals", "be unit vectors", advice="divide them by their length")
    distances, near = _neighbors(points, n_neighbors)
    n, k = near.shape
    i, j = np.repeat(np.arange(n), k), near.ravel()
    votes = symmetric_votes(n, i, j, np.einsum("er,er->e", vectors[i], vectors[j]))
    signs, labels = agree_on_signs(votes)
    # The disc that reaches the last neighbour holds k points besides this one.
    areas = np.pi * distances[:, -1:] ** 2 / k
    return vectors * turn_outwards(points, vectors * areas, signs, labels, votes)[:, None]


def _check_cloud(cloud: PointCloud) -> Floats:
    if cloud.n < 3:
        raise InvalidInputError("cloud", "have at least 3 points", cloud.n)
    return np.asarray(cloud.points / box_unit(cloud.points))


def _neighbors(points: Floats, n_neighbors: int) -> tuple[Floats, Ints]:
    k = min(check_count("n_neighbors", n_neighbors, low=2), len(points) - 1)
    distances, near = cKDTree(points).query(points, k + 1)
    return distances[:, 1:], near[:, 1:]
