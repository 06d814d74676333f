"""Tangent vector fields: planes at the points, how edges carry vectors, and their Laplacian."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from spectra_kit._core.checked import checked
from spectra_kit._core.clock import Clock
from spectra_kit._core.records import Rebuilt, frozen
from spectra_kit._core.types import Bools, Floats, Ints
from spectra_kit._core.validate import real_array
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import Geometry, GeometryLike, TriangleMesh
from spectra_kit.geometry.vectors import frames_of, sums, unit_vectors
from spectra_kit.geometry.winding import sides_of, turn, wound_against
from spectra_kit.operators.checks import of_shape, unit_of
from spectra_kit.operators.intrinsic import IntrinsicTriangulation, intrinsic_delaunay
from spectra_kit.operators.laplacian import Laplacian
from spectra_kit.operators.tangent import check_area_at_all, main_normals, stars

_FLAT = 1e-8  # sine of a corner below which its triangle has no normal
_CANCEL = 1e-6  # share of a sum of normals that is left where sheets lie back to back
# Cosine between normals of neighbours below which their sides disagree on a mesh of one side: those
# of a regular tetrahedron, the coarsest of closed surfaces, have -1/3.
_SEAM = -0.5


@checked
@dataclass(frozen=True, eq=False)
class TangentFrames(Rebuilt):
    """Axes of the tangent planes at n points, in which `connection_laplacian` has its unknowns.

    Parameters
    ----------
    axes : array_like of shape (n, 3, 3)
        Rows are two axes and the normal of each point: orthonormal and right-handed.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> from spectra_kit.operators import connection_laplacian, tangent_frames
    >>> ball = sk.geometry.sphere(subdivisions=2).geometry
    >>> mode = sk.eigensolve(connection_laplacian(ball), 1).eigenvectors[:, 0]
    >>> tangent_frames(ball).vectors(mode).shape
    (162, 3)
    """

    axes: Floats

    def __post_init__(self) -> None:
        axes = real_array("axes", self.axes)
        if axes.ndim != 3 or axes.shape[1:] != (3, 3):
            raise InvalidInputError("axes", "have shape (n, 3, 3)", axes.shape)
        object.__setattr__(self, "axes", frozen(axes.copy()))

    def vectors(self, coordinates: ArrayLike) -> Floats:
        """Return vectors in space (n, 3), in the unit of their coordinates, (2n,) or (n, 2)."""
        given, n = real_array("coordinates", coordinates), len(self.axes)
        if given.shape not in ((2 * n,), (n, 2)):
            expected = f"have shape ({2 * n},) or ({n}, 2)"
            raise InvalidInputError("coordinates", expected, given.shape)
        return np.asarray(np.einsum("nr,nra->na", given.reshape(-1, 2), self.axes[:, :2]))

    def coordinates(self, vectors: ArrayLike) -> Floats:
        """Return the coordinates (2n,) of vectors in space (n, 3), normal parts left out."""
        given = of_shape("vectors", vectors, (len(self.axes), 3))
        return np.asarray(np.einsum("na,nra->nr", given, self.axes[:, :2]).ravel())


@checked
def tangent_frames(geometry: GeometryLike, *, n_neighbors: int = 30) -> TangentFrames:
    """Return the tangent planes at the points of a surface.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        With n points.
    n_neighbors : int, default 30
        Of a cloud: candidates for the triangles of a point, as in `intrinsic_delaunay`.

    Returns
    -------
    TangentFrames
        Normals are the means of those of the triangles by their angles at the point, windings made
        to agree; where they cannot, or three faces meet, the main axes of second moments. Of a
        cloud, sides say nothing. Axes depend on the normals alone: on a flat sheet they are
        parallel.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> ball = sk.geometry.sphere(subdivisions=3).geometry
    >>> normals = sk.operators.tangent_frames(ball).axes[:, 2]
    >>> bool(((normals * ball.points).sum(axis=1) > 0.999).all())
    True
    """
    points, n = geometry.points / unit_of(geometry), geometry.n
    turned, doubtful = None, np.zeros(n, dtype=bool)
    if isinstance(geometry, TriangleMesh):
        turned, doubtful, _ = _agreed(geometry)
    faces = stars(geometry, points, n_neighbors, turned)
    owners, weighted = faces[:, 0], _corner_normals(points, faces)
    angles = np.linalg.norm(weighted, axis=1)
    total = np.bincount(owners, angles, minlength=n)
    check_area_at_all(total)
    normals = sums(owners, weighted, n)
    doubtful |= np.linalg.norm(normals, axis=1) < _CANCEL * total
    if doubtful.any():
        here = doubtful[owners] & (angles > 0)
        rooted, rank = weighted[here] / np.sqrt(angles[here, None]), np.cumsum(doubtful) - 1
        normals[doubtful] = main_normals(rank[owners[here]], rooted, doubtful.sum())
    return TangentFrames(frames_of(unit_vectors(normals)))


@checked
def connection_laplacian(geometry: GeometryLike, *, n_neighbors: int = 30) -> Laplacian:
    """Build the Laplacian of tangent vector fields, whose energy is how much they turn and change.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        With n points; anything that `intrinsic_delaunay` takes.
    n_neighbors : int, default 30
        Of a cloud, as there.

    Returns
    -------
    Laplacian
        On 2n unknowns, the coordinates in `tangent_frames`: both of the first point, then of the
        next. Each point is there twice, with its mass. Where a surface has two sides, modes come in
        pairs, turned by a right angle.

    Notes
    -----
    ``sum_ij w_ij |v_i - R_ij v_j|^2 / 2`` with the weights of the intrinsic Delaunay Laplacian,
    none negative. R_ij is the smallest rotation of space that takes one tangent plane to the other
    (Singer and Wu, *Vector Diffusion Maps and the Connection Laplacian*, Communications on Pure and
    Applied Mathematics 65, 2012), sides of normals kept where windings agree, so that vectors turn
    with the surface at any fold; where sides disagree, as on a Möbius strip or between points of a
    cloud, it is a reflection: neither an orientation nor a manifold is asked for.

    Examples
    --------
    The eigenvalues ``l (l + 1) - 1`` of the unit sphere, each ``4 l + 2`` times:

    >>> import spectra_kit as sk
    >>> from spectra_kit.operators import connection_laplacian
    >>> ball = sk.geometry.sphere(subdivisions=3).geometry
    >>> sk.eigensolve(connection_laplacian(ball), 8).eigenvalues.round(1)
    array([1., 1., 1., 1., 1., 1., 5., 5.])
    """
    clock = Clock()
    frames = tangent_frames(geometry, n_neighbors=n_neighbors)
    triangulation = intrinsic_delaunay(geometry, n_neighbors=n_neighbors)
    return replace(laplacian_along(geometry, triangulation, frames), seconds=clock.total)


def laplacian_along(
    geometry: Geometry, triangulation: IntrinsicTriangulation, frames: TangentFrames
) -> Laplacian:
    """Return the connection Laplacian on a triangulation of a geometry."""
    plain = triangulation.laplacian
    upper = sparse.csr_array(sparse.triu(plain.stiffness, 1))
    i, j = np.repeat(np.arange(plain.n), np.diff(upper.indptr)), upper.indices
    seam: float | Floats = 0.0
    if isinstance(geometry, TriangleMesh):  # where sides are known, vectors turn at any fold
        _, doubtful, clashes = _agreed(geometry)
        seam = np.where(doubtful[i] | doubtful[j], 0.0, _SEAM if clashes else -np.inf)
    blocks = upper.data[:, None, None] * _carried(frames.axes, i, j, seam)
    size = (2 * plain.n, 2 * plain.n)
    half = sparse.csr_array(sparse.bsr_array((blocks, upper.indices, upper.indptr), shape=size))
    return Laplacian(
        half + half.T + sparse.diags_array(np.repeat(plain.stiffness.diagonal(), 2)),
        np.repeat(plain.mass, 2),
        np.repeat(plain.points, 2, axis=0),
        operator=plain.operator.replace("delaunay_laplacian", "connection_laplacian"),
    )


def _agreed(mesh: TriangleMesh) -> tuple[Ints, Bools, bool]:
    """Return faces wound alike where they can be; points where they cannot; whether there are any.

    Points on edges of more than two faces are among those, which have no side either.
    """
    turned, clashes = wound_against(mesh)
    faces, doubtful = turn(mesh.faces, turned), np.zeros(mesh.n, dtype=bool)
    edges, counts = mesh.unique_edges
    doubtful[edges[counts > 2]] = True
    if clashes:
        sides = sides_of(faces, mesh.n)
        doubtful[sides.edges[sides.clash]] = True
    return faces, doubtful, bool(clashes)


def _carried(axes: Floats, i: Ints, j: Ints, seam: float | Floats) -> Floats:
    """Return the orthogonal 2x2 blocks (e, 2, 2) that take vectors at j to i.

    Of the cosines between axes, that is the nearest rotation, or the nearest reflection where
    normals are on other sides: where their cosine is below `seam`.
    """
    cosines = np.einsum("era,esa->ers", axes[i], axes[j])
    side = np.where(cosines[:, 2, 2] < seam, -1.0, 1.0)
    along = cosines[:, 0, 0] + side * cosines[:, 1, 1]
    across = cosines[:, 1, 0] - side * cosines[:, 0, 1]
    size = np.hypot(along, across)
    along = np.where(size > 0, along, 1.0)  # opposite normals are carried by any half turn
    cos, sin = np.array([along, across]) / np.where(size > 0, size, 1.0)
    return np.stack([cos, -side * sin, sin, side * cos], axis=1).reshape(-1, 2, 2)


def _corner_normals(points: Floats, faces: Ints) -> Floats:
    """Return normals of triangles times their angle at the first corner, (f, 3)."""
    a, b, c = (points[corner] for corner in faces.T)
    one, two = unit_vectors(b - a), unit_vectors(c - a)
    across: Floats = np.cross(one, two)
    sines = np.linalg.norm(across, axis=1)
    angles = np.arctan2(sines, np.einsum("fr,fr->f", one, two))
    angles = np.divide(angles, sines, out=np.zeros_like(sines), where=sines > _FLAT)
    return np.asarray(across * angles[:, None])
