"""Tangent planes at the points of a surface, and the gradients of functions in them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse import csr_array

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats, Ints
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import Geometry, GeometryLike, TriangleMesh
from spectra_kit.geometry.vectors import frames_of, sums
from spectra_kit.operators.checks import check_cloud_usable, check_faces_usable, of_shape, unit_of
from spectra_kit.operators.local_delaunay import local_triangles
from spectra_kit.operators.oriented import OrientedTriangles, oriented_triangles


class TangentGradient(NamedTuple):
    """Gradients at points, in coordinates of their tangent planes.

    Attributes
    ----------
    frames : ndarray of shape (n, 3, 3)
        Rows are the first axis, the second, and the normal, of unit length: right-handed. How the
        axes are turned says nothing; nor does the side of the normal, unless they are oriented.
    x, y : csr_array of shape (n, n)
        ``x @ f`` is the slope of a function f along the first axis of each point, in 1/length.
    """

    frames: Floats
    x: csr_array
    y: csr_array


@checked
def tangent_gradient(
    geometry: GeometryLike, *, n_neighbors: int = 30, oriented: bool = False
) -> TangentGradient:
    """Return tangent planes at the points of a surface, and gradients in them.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        With n points. Windings of faces do not matter, unless frames are to be oriented.
    n_neighbors : int, default 30
        Of a cloud: candidates for the triangles of a point, as in `intrinsic_delaunay`.
    oriented : bool, default False
        Let normals point outwards, as `oriented_triangles` tells; the second axes turn with them.
        For what tells a surface from its mirror image, as gradients that a network turns in their
        planes do.

    Returns
    -------
    TangentGradient
        Frames (n, 3, 3), and a matrix for each of the two slopes.

    Notes
    -----
    The gradient at a point is the mean of those on its triangles, by their areas, projected to the
    plane whose normal is the main axis of the second moments of theirs: signs of normals cancel.
    Linear functions on a plane get their exact gradients.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.geometry import rectangle
    >>> from spectra_kit.operators import tangent_gradient
    >>> sheet = rectangle(n=200).geometry
    >>> frames, x, y = tangent_gradient(sheet)
    >>> slopes = np.stack([x @ sheet.points[:, 0], y @ sheet.points[:, 0]])
    >>> bool(np.allclose(np.einsum("in,nir->nr", slopes, frames[:, :2]), [1, 0, 0]))
    True
    """
    return _tangent(geometry, n_neighbors, oriented)[0]


@checked
def gradient(geometry: GeometryLike, values: ArrayLike, *, n_neighbors: int = 30) -> Floats:
    """Return the gradient of a function at each point, as a vector of space.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        With n points.
    values : array_like of shape (n,)
        The function at the points.
    n_neighbors : int, default 30
        As of `tangent_gradient`, whose matrices give many gradients sooner.

    Returns
    -------
    ndarray of shape (n, 3)
        Tangent to the surface, in the unit of `values` over length; the mean over the triangles of
        each point, of which `IntrinsicTriangulation.gradient` has each.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> sheet = sk.geometry.rectangle(n=200).geometry
    >>> abs(sk.operators.gradient(sheet, 3 * sheet.points[:, 0])[0].round(12))
    array([3., 0., 0.])
    """
    tangent = _tangent(geometry, n_neighbors)[0]
    f = of_shape("values", values, (geometry.n,))
    slopes = np.stack([tangent.x @ f, tangent.y @ f], axis=1)
    return np.asarray(np.einsum("na,nar->nr", slopes, tangent.frames[:, :2]))


@checked
def divergence(geometry: GeometryLike, vectors: ArrayLike, *, n_neighbors: int = 30) -> Floats:
    """Return the divergence of a vector field at each point: minus the adjoint of `gradient`.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        With n points.
    vectors : array_like of shape (n, 3)
        Of what they have across the surface nothing is taken.
    n_neighbors : int, default 30
        As of `gradient`.

    Returns
    -------
    ndarray of shape (n,)
        In the unit of `vectors` over length: with a third of the area of the triangles of each
        point as mass, ``mass @ (f * divergence)`` is ``-mass @ (gradient(f) * vectors).sum(1)``. So
        what flows out through a boundary counts, too, at its points.

    Notes
    -----
    Exact, away from boundaries, for linear fields on a plane. The divergence of a `gradient` has
    the errors of both; for that take ``-(stiffness @ f) / mass``.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> ball = sk.geometry.sphere(subdivisions=4).geometry
    >>> z = ball.points[:, 2:]
    >>> found = sk.operators.divergence(ball, [0, 0, 1] - z * ball.points)  # grad z
    >>> bool(abs(found + 2 * z[:, 0]).max() < 0.02)
    True
    """
    tangent, areas = _tangent(geometry, n_neighbors)
    field = of_shape("vectors", vectors, (geometry.n, 3))
    along, across = areas * np.einsum("nr,nar->an", field, tangent.frames[:, :2])
    return np.asarray(-(tangent.x.T @ along + tangent.y.T @ across) / areas)


def _tangent(
    geometry: Geometry, n_neighbors: int, oriented: bool = False
) -> tuple[TangentGradient, Floats]:
    """Return them with the area of the triangles of each point, (n,), in some unit."""
    unit, n = unit_of(geometry), geometry.n
    points = geometry.points / unit
    faces = stars(geometry, points, n_neighbors)
    owners = faces[:, 0]
    a, b, c = (points[faces[:, i]] for i in range(3))
    doubled: Floats = np.cross(b - a, c - a)
    areas = np.linalg.norm(doubled, axis=1) / 2
    total = np.bincount(owners, areas, minlength=n)
    check_area_at_all(total)
    solid = areas > 0
    faces, owners, doubled, areas = faces[solid], owners[solid], doubled[solid], areas[solid]
    frames = frames_of(main_normals(owners, doubled / areas[:, None] ** 0.5, n))
    if oriented:
        frames = outward(frames, points, oriented_triangles(geometry, n_neighbors=n_neighbors))
    # The slope of the hat function of a corner, times the area, is half the side facing it, turned.
    corners = points[faces]
    sides = np.roll(corners, 1, axis=1) - np.roll(corners, -1, axis=1)
    turned = np.cross((doubled / (2 * areas * 2 * total[owners])[:, None])[:, None], sides)
    slopes = np.einsum("tar,tcr->atc", frames[owners, :2], turned) / unit
    where = np.repeat(owners, 3), faces.ravel()
    x, y = (sparse.csr_array((part.ravel(), where), shape=(n, n)) for part in slopes)
    return TangentGradient(frames, x, y), np.asarray(total, dtype=np.float64)


def stars(geometry: Geometry, points: Floats, n_neighbors: int, faces: Ints | None = None) -> Ints:
    """Return the triangles (t, 3) at each point, their first corner: of a cloud its local ones.

    Of a mesh all `faces`, its own or those wound otherwise, once for each corner.
    """
    if isinstance(geometry, TriangleMesh):
        check_faces_usable(geometry)
        corners = geometry.faces if faces is None else faces
        return np.concatenate([np.roll(corners, -c, axis=1) for c in range(3)])
    n_neighbors, _ = check_cloud_usable(geometry, n_neighbors)
    return local_triangles(points, n_neighbors)[0].astype(np.int64)


def check_area_at_all(total: Floats | Ints) -> None:
    """Refuse points (n,) around which triangles have no area in all: they have no plane."""
    if not (total > 0).all():
        raise InvalidInputError(
            "geometry",
            "have a triangle of some area at every point",
            f"none at point {int(np.argmin(total > 0))}",
            advice="repair it (geometry.repair), or drop that point",
        )


def main_normals(owners: Ints, normals: Floats, n: int) -> Floats:
    """Return the main axes (n, 3) of second moments of normals, times the roots of their weights.

    Their signs say nothing.
    """
    moments = [np.bincount(owners, x * y, n) for x in normals.T for y in normals.T]
    return np.asarray(np.linalg.eigh(np.stack(moments, axis=1).reshape(n, 3, 3))[1][:, :, 2])


def outward(frames: Floats, points: Floats, outer: OrientedTriangles) -> Floats:
    """Return frames whose normals are on the side of the triangles at their points."""
    a, b, c = (points[outer.faces[:, i]] for i in range(3))
    across = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    normals = sums(outer.faces.ravel(), across, len(points))
    inward = np.einsum("nr,nr->n", normals, frames[:, 2]) < 0
    return np.where(inward[:, None, None], frames * [[1.0], [-1.0], [-1.0]], frames)
