"""Quality of a point map without any truth: coverage, smoothness, orientation, a way back."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_faces, check_indices, check_mass, check_points
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import TriangleMesh
from spectra_kit.maps.checks import check_point_map
from spectra_kit.maps.convert import functional_map_from_point_map, point_map_from_functional_map
from spectra_kit.maps.geodesic import geodesic_distances
from spectra_kit.operators import Laplacian

_WAY_BACK = 100  # modes of the functional map whose transpose leads back


@checked
def coverage(point_map: ArrayLike, mass: ArrayLike) -> float:
    """Return the share of the source's area whose points are the image of some target point.

    Parameters
    ----------
    point_map : array_like of shape (n2,), integers
        Source point of each target point.
    mass : array_like of shape (n1,)
        Of the source points, in any unit.

    Returns
    -------
    float
        1 for a permutation; less for a true map between two meshings, where several points may
        share their nearest vertex, and others are nobody's.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> sk.maps.coverage([0, 0, 1], [1.0, 1.0, 2.0])
    0.5
    """
    weights = check_mass("mass", mass, np.size(mass))
    p = check_point_map("point_map", point_map, len(weights))
    return float(weights[np.unique(p)].sum() / weights.sum())


@checked
def dirichlet_energy(source: Laplacian, target: Laplacian, point_map: ArrayLike) -> float:
    """Return the Dirichlet energy of a point map relative to the area of the source.

    Parameters
    ----------
    source : Laplacian
        Its points are where the map goes; its area is the unit.
    target : Laplacian
        Where the map is differentiated.
    point_map : array_like of shape (n2,), integers
        Source point of each target point.

    Returns
    -------
    float
        ``tr(X^T L X) / (2 area)`` with X the source points that the target points go to, shape
        (n2, 3): no unit. Near 1 for an isometry (a little less where the mesh is not
        Delaunay), more for a map onto the source that stretches unevenly, 0 for a constant one;
        jumps cost most.

    Raises
    ------
    InvalidInputError
        If `source` or `target` is no Laplacian, or `point_map` has another length than target
        points, or an index out of range.

    Notes
    -----
    Ezuz, Solomon and Ben-Chen, *Reversible Harmonic Maps between Discrete Surfaces*, 2019; the
    source's points embed its own metric, since distances of neighbours in space are those on the
    surface.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> laplacian = sk.robust_laplacian(sk.geometry.sphere(subdivisions=3).geometry)
    >>> round(sk.maps.dirichlet_energy(laplacian, laplacian, range(laplacian.n)), 6)
    1.0
    """
    p = check_point_map("point_map", point_map, source.n, target.n)
    X = source.points[p]
    return float(np.sum(X * (target.stiffness @ X)) / (2 * source.area))


@checked
def bijectivity_errors(mesh: TriangleMesh, point_map: ArrayLike, back: ArrayLike) -> Floats:
    """Measure how far each source vertex is from where it comes back to.

    Parameters
    ----------
    mesh : TriangleMesh
        The source, with n1 vertices.
    point_map : array_like of shape (n2,), integers
        Source vertex of each target point.
    back : array_like of shape (n1,), integers
        Target point of each source vertex.

    Returns
    -------
    ndarray of shape (n1,)
        Geodesic distances along edges from vertex i to ``point_map[back[i]]``, in hundredths of
        the root of the area; 0 where the two maps undo each other.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> mesh = sk.geometry.sphere(subdivisions=2).geometry
    >>> there = np.roll(np.arange(mesh.n), 5)
    >>> float(sk.maps.bijectivity_errors(mesh, there, np.argsort(there)).max())
    0.0
    """
    p = check_point_map("point_map", point_map, mesh.n)
    q = check_indices("back", back, len(p))
    if q.shape != (mesh.n,):
        raise InvalidInputError(
            "back",
            f"have shape ({mesh.n},), a target point for each source vertex",
            q.shape,
            advice="are the two maps exchanged?",
        )
    found = geodesic_distances(mesh, np.arange(mesh.n), p[q])
    return np.asarray(100 * found / np.sqrt(mesh.area))


@checked
def way_back(source: Spectrum, target: Spectrum, point_map: ArrayLike) -> Ints:
    """Return the target point of each source point, by the transpose of the functional map.

    Of a bijection that keeps areas the functional map is orthogonal, and its transpose leads back.

    Parameters
    ----------
    source, target : Spectrum
        With n1 and n2 points; of each the first 100 modes count, or as many as both have.
    point_map : array_like of shape (n2,), integers
        Source point of each target point.

    Returns
    -------
    ndarray of shape (n1,)
        Target points, for `bijectivity_errors`.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> spectrum = sk.spectrum(sk.geometry.creature(600), 40)
    >>> bool((sk.maps.way_back(spectrum, spectrum, range(600)) == np.arange(600)).all())
    True
    """
    k = min(_WAY_BACK, source.k, target.k)
    C = functional_map_from_point_map(source, target, point_map, k=k)
    return point_map_from_functional_map(target, source, C.T)


@checked
def orientation(
    source_points: ArrayLike, source_faces: ArrayLike, target_faces: ArrayLike, point_map: ArrayLike
) -> float:
    """Tell whether a point map keeps or reverses the orientation of the surface.

    Parameters
    ----------
    source_points : array_like of shape (n1, 3)
        Where the map goes.
    source_faces : array_like of shape (f1, 3), integers
        Triangles of the source, consistently turned (`operators.oriented_triangles`).
    target_faces : array_like of shape (f2, 3), integers
        Triangles of the target, consistently turned in the same sense.
    point_map : array_like of shape (n2,), integers
        Source point of each target point.

    Returns
    -------
    float
        From -1 to 1: signed area of the mapped target triangles, seen along the normals of the
        source, over their unsigned area. Near 1 the map keeps orientation, near -1 it mirrors;
        near 0 it does not know, or half of it is flipped. 0 for a constant map.

    Raises
    ------
    InvalidInputError
        If an array has another shape or an index is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> mesh = sk.geometry.sphere(subdivisions=2).geometry
    >>> same = np.arange(mesh.n)
    >>> sk.maps.orientation(mesh.points, mesh.faces, mesh.faces, same)
    1.0
    >>> sk.maps.orientation(mesh.points, mesh.faces, mesh.faces[:, ::-1], same)
    -1.0
    """
    points = check_points("source_points", source_points)
    faces = check_faces("source_faces", source_faces, len(points))
    p = check_point_map("point_map", point_map, len(points))
    images = p[check_faces("target_faces", target_faces, len(p))]
    normals = np.zeros_like(points)
    cross = _crosses(points, faces)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], cross)
    normals /= np.maximum(np.linalg.norm(normals, axis=1), np.finfo(np.float64).tiny)[:, None]
    mapped = _crosses(points, images)
    # One flat triangle sees three normals: where these disagree it lies across a sharp edge.
    along = np.sum(mapped * normals[images].mean(axis=1), axis=1)
    total = np.abs(along).sum()
    return float(along.sum() / total) if total > 0 else 0.0


def _crosses(points: Floats, faces: Ints) -> Floats:
    a, b, c = (points[faces[:, i]] for i in range(3))
    return np.asarray(np.cross(b - a, c - a))
