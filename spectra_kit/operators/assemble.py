"""The Laplacians spectra_kit knows how to build from a geometry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

import igl
import numpy as np
import robust_laplacian as rl
from scipy import sparse

from spectra_kit._core.checked import checked
from spectra_kit._core.clock import Clock
from spectra_kit._core.validate import check_count, quantity
from spectra_kit.errors import InvalidInputError, OutOfMemoryError
from spectra_kit.geometry.seams import warn_of_seams
from spectra_kit.geometry.shapes import GeometryLike, MeshLike, TriangleMesh
from spectra_kit.operators.checks import (
    check_distinct,
    check_faces_usable,
    check_mollify_factor,
    mean_edges,
    off_host,
    unit_of,
    units_of,
    warn_of_near_parts,
)
from spectra_kit.operators.intrinsic import intrinsic_delaunay
from spectra_kit.operators.laplacian import Laplacian, with_zero_sums
from spectra_kit.operators.triangle_calculus import linear_mass

# What robust_laplacian 1.1 took of address space, on meshes of 2,000 to 400,000 faces (1,550 to
# 2,540), and some more.
_BYTES_PER_FACE = 3_000


@checked
def laplacian(
    geometry: GeometryLike,
    *,
    operator: Literal["robust", "cotan", "knn", "delaunay"] | None = None,
    boundary: Literal["neumann", "dirichlet"] = "neumann",
    mass: Literal["lumped", "consistent"] = "lumped",
    device: str = "cpu",
) -> Laplacian:
    """Build the Laplacian that fits: `robust_laplacian` of a mesh, `delaunay_laplacian` of a cloud.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        With n points.
    operator : {"robust", "cotan", "knn", "delaunay"}, optional
        Another one, by its name.
    boundary : {"neumann", "dirichlet"}, default "neumann"
        What holds at the boundary of a mesh; Dirichlet holds it at zero.
    mass : {"lumped", "consistent"}, default "lumped"
        The diagonal, or the matrix of linear elements as it is, which "cotan" and "delaunay" have,
        and "delaunay" is taken for. Its eigenvalues are bounds from above on a flat sheet.
    device : str, default "cpu"
        As of `delaunay_laplacian`; other operators are the host's.

    Returns
    -------
    Laplacian
        With mass in the squared length unit of `geometry`.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> sk.laplacian(sk.geometry.sphere(subdivisions=2).geometry).n
    162
    """
    if operator == "cotan" and not isinstance(geometry, TriangleMesh):
        raise InvalidInputError("operator", "be one for points", "cotan, which needs a mesh")
    asked: dict[str, str] = {}
    if off_host(device) and operator not in ("cotan", "knn"):
        asked["device"] = device
    if mass == "consistent":
        operator, asked["mass"] = operator or "delaunay", mass
        if operator not in ("cotan", "delaunay"):
            raise InvalidInputError(
                "mass", f"be lumped for {operator!r}", mass, advice='take operator="delaunay"'
            )
    built = _BY_NAME[operator or "robust"](geometry, **asked)
    if boundary == "neumann":
        return built
    if not isinstance(geometry, TriangleMesh) or not len(geometry.boundary_vertices):
        raise InvalidInputError("boundary", "be neumann on what has none", "dirichlet")
    return built.dirichlet(geometry.boundary_vertices)


@checked
def robust_laplacian(
    geometry: GeometryLike,
    *,
    mollify_factor: float = 1e-5,
    n_neighbors: int = 30,
    device: str = "cpu",
) -> Laplacian:
    """Build the intrinsic Delaunay Laplacian of a mesh or a point cloud.

    Non-negative edge weights on any input: non-manifold edges, slivers, duplicate faces and raw
    point clouds included.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        With n points.
    mollify_factor : float, default 1e-5
        Intrinsic mollification of (near) degenerate triangles, relative to the mean edge length of
        each connected component. If there is such a triangle, all edges become longer by up to
        this share of that length, so details must not be so small.
    n_neighbors : int, default 30
        Of a cloud, see `intrinsic_delaunay`.
    device : str, default "cpu"
        Of a cloud, too; the operator of a mesh is made on the host.

    Returns
    -------
    Laplacian
        Neumann; mass in the squared length unit of `geometry`. That of a cloud is its
        `delaunay_laplacian`.

    Raises
    ------
    OutOfMemoryError
        If there is no room for what the library takes, 3 kB for each face of a mesh.
        `delaunay_laplacian` takes a seventh.

    Notes
    -----
    Meshes are handed to the library robust_laplacian (Sharp and Crane, *A Laplacian for Nonmanifold
    Triangle Meshes*, SGP 2020). Its operator of clouds does not converge: each triangle is found by
    three points, and it glues these copies to each other, which the edge flips then deflate. The
    eigenvalues 2, 6, 12 of the unit sphere come out as 1.90, 5.69, 11.37 on 8,000 random directions
    (``default_rng(1).standard_normal``, normalised), 5 % low as they are on 2,000; those of
    `delaunay_laplacian` are 2.00, 5.99, 11.96. And it fits the plane of a point around the sum of
    its k neighbours over k + 1, so its triangles depend on where the origin is: of 32,000
    directions it finds 64 % of the area, after a shift by (3, 3, 3) 98 %.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> laplacian = sk.robust_laplacian(sk.geometry.sphere(subdivisions=2).geometry)
    >>> round(laplacian.area, 1)
    12.3
    """
    if not isinstance(geometry, TriangleMesh):
        return delaunay_laplacian(
            geometry, mollify_factor=mollify_factor, n_neighbors=n_neighbors, device=device
        )
    clock = Clock()
    check_mollify_factor(mollify_factor)
    off_host(device)
    check_faces_usable(geometry)
    warn_of_seams(geometry)
    _check_room(len(geometry.faces) * _BYTES_PER_FACE)
    unit, faces = mean_edges(geometry), np.array(geometry.faces)
    stiffness, mass = rl.mesh_laplacian(geometry.points / unit[:, None], faces, mollify_factor)
    return Laplacian(
        with_zero_sums(stiffness),
        mass.diagonal() * unit**2,
        geometry.points,
        operator=f"robust_laplacian(mesh, mollify_factor={mollify_factor:g})",
        seconds=clock.total,
    )


def _check_room(size: int) -> None:
    """Refuse what the library would end the process for: it does not survive want of memory."""
    try:
        np.empty(size, dtype=np.uint8)
    except MemoryError as error:
        raise OutOfMemoryError(
            f"robust_laplacian needs up to {size / 1e9:.1f} GB, more than there is",
            advice="use delaunay_laplacian, which needs less, or a coarser geometry",
        ) from error


@checked
def delaunay_laplacian(
    geometry: GeometryLike,
    *,
    mollify_factor: float = 1e-5,
    n_neighbors: int = 30,
    device: str = "cpu",
    mass: Literal["lumped", "consistent"] = "lumped",
) -> Laplacian:
    """Build the intrinsic Delaunay Laplacian of a mesh or a point cloud.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        With n points.
    mollify_factor, n_neighbors, device
        As of `intrinsic_delaunay`.
    mass : {"lumped", "consistent"}, default "lumped"
        Of linear functions on the triangles.

    Returns
    -------
    Laplacian
        Neumann; edge weights are not negative beyond rounding; mass in the squared length unit
        of `geometry`. The same bits whatever the number of threads; on a device, the same up to
        rounding.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> mesh = sk.geometry.sphere(subdivisions=3).geometry
    >>> [round(sk.delaunay_laplacian(one).area, 2) for one in (mesh, mesh.as_cloud())]
    [12.51, 12.51]
    """
    found = intrinsic_delaunay(
        geometry, mollify_factor=mollify_factor, n_neighbors=n_neighbors, device=device
    )
    if mass == "lumped":
        return found.laplacian
    operator = f'{found.operator[:-1]}, mass="consistent")'
    return replace(found.laplacian, mass=found.consistent_mass, operator=operator)


@checked
def cotan_laplacian(
    mesh: MeshLike, *, mass: Literal["lumped", "consistent"] = "lumped"
) -> Laplacian:
    """Build the cotangent Laplacian, linear elements, with the mixed Voronoi mass, as libigl's.

    Edge weights may be negative on obtuse triangles; prefer `robust_laplacian` unless you
    need this one to compare with others. See Pinkall and Polthier, *Computing Discrete Minimal
    Surfaces and Their Conjugates*, 1993.

    Parameters
    ----------
    mesh : TriangleMesh
        Without degenerate or duplicate faces.
    mass : {"lumped", "consistent"}, default "lumped"
        Mixed Voronoi areas, or the matrix of linear elements, as of LaPy and scikit-fem.

    Returns
    -------
    Laplacian
        Neumann, positive semi-definite (libigl's matrix with its sign turned).

    Examples
    --------
    >>> import spectra_kit as sk
    >>> laplacian = sk.cotan_laplacian(sk.geometry.rectangle(n=100).geometry)
    >>> laplacian.kernel_dimension
    1
    """
    clock = Clock()
    check_faces_usable(mesh)
    warn_of_seams(mesh)
    unit = units_of(mesh)
    if (flat := int(mesh.degenerate_faces(1e-14).sum())) > 0:
        raise InvalidInputError(
            "mesh",
            "have faces on which cotangents exist",
            quantity(flat, "face") + " of zero area",
            advice="use {}, or drop them with {}",
            remedies=("robust_laplacian", "mesh.without_degenerate_faces()"),
        )
    if (twice := len(mesh.faces) - len(mesh.without_duplicate_faces().faces)) > 0:
        raise InvalidInputError(
            "mesh",
            "have each face once",
            quantity(twice, "duplicate face"),
            advice="use {}, or drop them with {}",
            remedies=("robust_laplacian", "mesh.without_duplicate_faces()"),
        )
    scaled, faces = mesh.points / unit[:, None], np.array(mesh.faces)
    stiffness = -igl.cotmatrix(scaled, faces)
    if mass == "consistent":
        weights, told = linear_mass(faces, mesh.face_areas, mesh.n), 'mesh, mass="consistent"'
    else:
        voronoi = igl.massmatrix(scaled, faces, igl.MASSMATRIX_TYPE_VORONOI)
        weights, told = voronoi.diagonal() * unit**2, "mesh"
    return Laplacian(
        stiffness,
        weights,
        mesh.points,
        operator=f"cotan_laplacian({told})",
        seconds=clock.total,
    )


@checked
def knn_laplacian(geometry: GeometryLike, *, n_neighbors: int = 20) -> Laplacian:
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

    Warns
    -----
    SplitSurfaceWarning
        If the points fall into parts that look like pieces, or lines, of one surface.

    Notes
    -----
    Weights ``W = exp(-d^2 / eps)`` with ``eps`` the squared median over points of the mean
    neighbour distance, symmetrised by averaging, then ``K = Q^-1 W Q^-1`` with ``Q`` the row sums
    of W, which takes the sampling density out (Coifman and Lafon, *Diffusion maps*, 2006). It is
    the graph operator to which the NEO paper transfers its network (Table "Robustness analysis").

    Examples
    --------
    >>> import spectra_kit as sk
    >>> laplacian = sk.knn_laplacian(sk.geometry.sphere(subdivisions=2).geometry)
    >>> laplacian.kernel_dimension
    1
    """
    from scipy.spatial import cKDTree  # slow to import

    clock = Clock()
    points = geometry.points / unit_of(geometry)
    n = len(points)
    check_count("n_neighbors", n_neighbors, low=1, high=n - 1)
    check_distinct(points)
    distance, neighbor = cKDTree(points).query(points, n_neighbors + 1)
    distance, neighbor = distance[:, 1:], neighbor[:, 1:]
    epsilon = float(np.median(distance.mean(axis=1))) ** 2
    if epsilon == 0:
        raise InvalidInputError(
            "geometry",
            "have neighbours at distances that can be squared",
            f"a median of {np.median(distance):.1g} of its extent",
            advice="remove outliers first",
        )
    rows = np.repeat(np.arange(n), n_neighbors)
    weights = np.exp(-(distance.ravel() ** 2) / epsilon)
    W = sparse.csr_array((weights, (rows, neighbor.ravel())), shape=(n, n))
    W = (W + W.T) / 2
    if not (density := W.sum(axis=1)).all():
        raise InvalidInputError(
            "geometry",
            "have neighbours of all points, near enough for weights",
            f"none near point {int(np.argmin(density))}",
            advice="remove outliers first",
        )
    inverse_density = sparse.diags_array(1 / density)
    K = inverse_density @ W @ inverse_density
    mass = K.sum(axis=1)
    built = Laplacian(
        sparse.diags_array(mass) - K,
        mass,
        geometry.points,
        operator=f"knn_laplacian(n_neighbors={n_neighbors})",
        seconds=clock.total,
    )
    warn_of_near_parts(built, n_neighbors)
    return built


_BY_NAME: dict[str, Callable[[Any], Laplacian]] = {
    "robust": robust_laplacian,
    "cotan": cotan_laplacian,
    "knn": knn_laplacian,
    "delaunay": delaunay_laplacian,
}
