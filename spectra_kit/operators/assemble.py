"""The Laplacians spectra_kit knows how to build from a geometry."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from spectra_kit._validate import check_count, check_positive
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import Geometry, TriangleMesh
from spectra_kit.operators._checks import (
    check_cloud_usable,
    check_distinct,
    check_faces_usable,
    check_geometry,
)
from spectra_kit.operators.laplacian import Laplacian

Floats = NDArray[np.float64]


def robust_laplacian(
    geometry: Geometry, *, mollify_factor: float = 1e-5, n_neighbors: int = 30
) -> Laplacian:
    """Build the intrinsic Delaunay Laplacian of a mesh, or the tufted one of a point cloud.

    Non-negative edge weights on any input: non-manifold edges, slivers, duplicate faces and raw
    point clouds included.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        With n points.
    mollify_factor : float, default 1e-5
        Intrinsic mollification of (near) degenerate triangles, relative to the mean edge length.
    n_neighbors : int, default 30
        Neighbours that vote for the local triangulations of a cloud; capped at n - 1.

    Returns
    -------
    Laplacian
        Neumann; mass in the squared length unit of `geometry`.

    Raises
    ------
    InvalidInputError
        If a vertex belongs to no face, a face repeats a vertex, points of a cloud coincide, lie
        on one line, or are fewer than four.

    Notes
    -----
    For clouds prefer `delaunay_laplacian`. The library (1.1) fits the plane of a point around the
    sum of its k neighbours over k + 1, so its triangles depend on where the origin is, the more
    the finer the cloud: of 32 000 random directions (``default_rng(1).standard_normal``,
    normalised) it finds 64 % of the area of the sphere, after a shift by (3, 3, 3) 98 %.

    References
    ----------
    Sharp and Crane, *A Laplacian for Nonmanifold Triangle Meshes*, SGP 2020.

    Examples
    --------
    >>> from spectra_kit.geometry import sphere
    >>> laplacian = robust_laplacian(sphere(subdivisions=2).geometry)
    >>> round(laplacian.area, 1)
    12.3
    """
    import robust_laplacian as rl  # here: a bare machine unpacks it after this import

    start = time.perf_counter()
    check_geometry(geometry)
    check_positive("mollify_factor", mollify_factor)
    points = np.array(geometry.points)
    if isinstance(geometry, TriangleMesh):
        check_faces_usable(geometry)
        stiffness, mass = rl.mesh_laplacian(points, np.array(geometry.faces), mollify_factor)
        options = f"mollify_factor={mollify_factor:g}"
    else:
        neighbors = check_cloud_usable(geometry, n_neighbors)
        stiffness, mass = rl.point_cloud_laplacian(points, mollify_factor, neighbors)
        options = f"mollify_factor={mollify_factor:g}, n_neighbors={neighbors}"
    return Laplacian(
        stiffness,
        mass,
        points,
        operator=f"robust_laplacian({_kind(geometry)}, {options})",
        seconds=time.perf_counter() - start,
    )


def cotan_laplacian(mesh: TriangleMesh) -> Laplacian:
    """Build the cotangent Laplacian with the mixed Voronoi mass, as libigl has it.

    Edge weights may be negative on obtuse triangles; prefer `robust_laplacian` unless you
    need this one to compare with others.

    Parameters
    ----------
    mesh : TriangleMesh
        Without degenerate or duplicate faces.

    Returns
    -------
    Laplacian
        Neumann, positive semi-definite (libigl's matrix with its sign turned).

    Raises
    ------
    InvalidInputError
        If `mesh` is a cloud, a vertex belongs to no face, or a face is degenerate or duplicated.

    References
    ----------
    Pinkall and Polthier, *Computing Discrete Minimal Surfaces and Their Conjugates*, 1993.

    Examples
    --------
    >>> from spectra_kit.geometry import rectangle
    >>> laplacian = cotan_laplacian(rectangle(n=100).geometry)
    >>> laplacian.kernel_dimension
    1
    """
    import igl  # here: training runs where no libigl is installed

    if not isinstance(mesh, TriangleMesh):
        raise InvalidInputError(
            f"`mesh` must be a TriangleMesh, got {type(mesh).__name__};"
            " for clouds use robust_laplacian or knn_laplacian"
        )
    start = time.perf_counter()
    check_faces_usable(mesh)
    if (flat := int(mesh.degenerate_faces(1e-14).sum())) > 0:
        raise InvalidInputError(
            f"`mesh` has {flat} faces of zero area, on which cotangents do not exist;"
            " use robust_laplacian, or drop them with `mesh.without_degenerate_faces()`"
        )
    if (twice := len(mesh.faces) - len(mesh.without_duplicate_faces().faces)) > 0:
        raise InvalidInputError(
            f"`mesh` has {twice} duplicate faces, which would count their area twice;"
            " use robust_laplacian, or drop them with `mesh.without_duplicate_faces()`"
        )
    points, faces = np.array(mesh.points), np.array(mesh.faces)
    stiffness = -igl.cotmatrix(points, faces)
    mass = igl.massmatrix(points, faces, igl.MASSMATRIX_TYPE_VORONOI)
    return Laplacian(
        stiffness,
        mass,
        points,
        operator="cotan_laplacian(mesh)",
        seconds=time.perf_counter() - start,
    )


def knn_laplacian(geometry: Geometry, *, n_neighbors: int = 20) -> Laplacian:
    """Build the density-normalised Gaussian k-nearest-neighbour graph Laplacian.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        Only its points are used.
    n_neighbors : int, default 20
        Neighbours of each point, itself excluded.

    Returns
    -------
    Laplacian
        ``L = D - K`` with mass ``D`` (row sums of K): **dimensionless**, its eigenvalues are in
        [0, 2] whatever the unit of length.

    Raises
    ------
    InvalidInputError
        If there are not more points than `n_neighbors`, or points coincide.

    Notes
    -----
    Weights ``W = exp(-d^2 / eps)`` with ``eps`` the squared median over points of the mean
    neighbour distance, symmetrised by averaging, then ``K = Q^-1 W Q^-1`` with ``Q`` the row sums
    of W, which takes the sampling density out (Coifman and Lafon, *Diffusion maps*, 2006). It is
    the graph operator to which the NEO paper transfers its network (Table "Robustness analysis").

    Examples
    --------
    >>> from spectra_kit.geometry import sphere
    >>> laplacian = knn_laplacian(sphere(subdivisions=2).geometry)
    >>> laplacian.kernel_dimension
    1
    """
    start = time.perf_counter()
    check_geometry(geometry)
    points = np.array(geometry.points)
    n = len(points)
    check_count("n_neighbors", n_neighbors, low=1, high=n - 1)
    check_distinct(points)
    distance, neighbor = cKDTree(points).query(points, n_neighbors + 1)
    distance, neighbor = distance[:, 1:], neighbor[:, 1:]
    epsilon = float(np.median(distance.mean(axis=1))) ** 2
    rows = np.repeat(np.arange(n), n_neighbors)
    weights = np.exp(-(distance.ravel() ** 2) / epsilon)
    W = sparse.csr_array((weights, (rows, neighbor.ravel())), shape=(n, n))
    W = (W + W.T) / 2
    if not (density := W.sum(axis=1)).all():
        raise InvalidInputError(
            f"`geometry` has points without neighbours, such as {int(np.argmin(density))}: all"
            f" others are more than {np.sqrt(700) * np.sqrt(epsilon):.3g} away;"
            " remove outliers first"
        )
    inverse_density = sparse.diags_array(1 / density)
    K = inverse_density @ W @ inverse_density
    mass = K.sum(axis=1)
    return Laplacian(
        sparse.diags_array(mass) - K,
        mass,
        points,
        operator=f"knn_laplacian(n_neighbors={n_neighbors})",
        seconds=time.perf_counter() - start,
    )


def _kind(geometry: Geometry) -> str:
    return "mesh" if isinstance(geometry, TriangleMesh) else "cloud"
