"""Quality of a point map: errors where the truth is known, and what tells without it.

Errors are geodesic. Coverage, smoothness, orientation and a way back need no truth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.checked import checked
from spectra_kit._core.records import Rebuilt, frozen
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import (
    check_faces,
    check_indices,
    check_mass,
    check_points,
    check_positive,
    real_array,
)
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.geodesics.edges import pair_distances
from spectra_kit.geometry import MeshLike
from spectra_kit.maps.convert import at_unit_area, check_point_map, induced
from spectra_kit.maps.nearest import nearest
from spectra_kit.maps.score import coverage_over_chance
from spectra_kit.operators import Laplacian

_INVERSE_K = 100  # modes of the functional map whose transpose leads back
_ANY = np.iinfo(np.int64).max  # points of a surface that is not known here
#: A map is flipped if its mean symmetric error is lower than its direct one by more than this.
FLIP_MARGIN = 1.0


@checked
@dataclass(frozen=True, eq=False)
class Truth(Rebuilt):
    """Known correspondences: target point ``target[i]`` is source point ``source[i]``.

    Parameters
    ----------
    source, target : array_like of shape (c,), integers
        Points of the two geometries.
    symmetric : array_like of shape (c,), integers, optional
        The mirror images of `source`, where the geometry has a symmetry.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> sk.maps.Truth([4, 2], [0, 1]).swapped().source
    array([0, 1])
    """

    source: Ints
    target: Ints
    symmetric: Ints | None = None

    def __post_init__(self) -> None:
        size = np.shape(self.source)
        for name in ("source", "target", "symmetric"):
            values = getattr(self, name)
            if values is None and name == "symmetric":
                continue
            array = check_indices(name, values, _ANY)
            if array.ndim != 1 or array.shape != size or not len(array):
                raise InvalidInputError(
                    name, "have the shape (c,) of `source`, c >= 1", f"{array.shape} beside {size}"
                )
            object.__setattr__(self, name, frozen(array.copy()))

    @classmethod
    def of_map(cls, point_map: ArrayLike) -> Truth:
        """Return the truth that a whole true point map of shape (n2,) states."""
        source = check_indices("point_map", point_map, _ANY)
        if source.ndim != 1 or not len(source):
            raise InvalidInputError("point_map", "have shape (n2,)", source.shape)
        return cls(source, np.arange(len(source)))

    def swapped(self) -> Truth:
        """Return the truth from target to source; its symmetric one is not known."""
        return Truth(self.target, self.source)


@checked
@dataclass(frozen=True, eq=False)
class MapErrors(Rebuilt):
    """Errors of a point map, in hundredths of the root of the source's area, and where they are.

    Parameters
    ----------
    direct : array_like of shape (c,)
        Against the truth, >= 0.
    target : array_like of shape (c,), integers
        The target point of each: the order is that of the truth, not of the points.
    symmetric : array_like of shape (c,), optional
        Against the mirror image of the truth.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> sk.maps.MapErrors([0.5, 2.0], [3, 1]).at_points(4)
    array([nan, 2. , nan, 0.5])
    """

    direct: Floats
    target: Ints
    symmetric: Floats | None = None

    def __post_init__(self) -> None:
        direct = _errors("direct", self.direct)
        made = {"direct": direct, "target": check_indices("target", self.target, _ANY).copy()}
        if self.symmetric is not None:
            made["symmetric"] = _errors("symmetric", self.symmetric)
        for name, values in made.items():
            if values.shape != direct.shape:
                raise InvalidInputError(
                    name, f"have the shape {direct.shape} of `direct`", values.shape
                )
            object.__setattr__(self, name, frozen(values))

    def at_points(self, n: int) -> Floats:
        """Return the direct errors at each of n target points: (n,).

        NaN where none is known, the largest where there are several.
        """
        check_indices("target", self.target, n)
        at = np.full(n, np.nan)
        np.fmax.at(at, self.target, self.direct)
        return at

    @property
    def either(self) -> Floats:
        """The smaller one at each correspondence, shape (c,): Ren et al. count so."""
        return self.direct if self.symmetric is None else np.minimum(self.direct, self.symmetric)

    def flipped(self, margin: float = FLIP_MARGIN) -> bool:
        """Tell whether the mean symmetric error is below the direct one by more than `margin`."""
        if self.symmetric is None:
            return False
        return bool(self.symmetric.mean() < self.direct.mean() - margin)


@checked
def map_errors(
    mesh: MeshLike,
    point_map: ArrayLike,
    truth: Truth,
    *,
    method: Literal["edges", "exact"] = "edges",
) -> MapErrors:
    """Measure how far a point map is from the truth, and from its mirror image if that is known.

    Parameters
    ----------
    mesh : TriangleMesh
        The source, with n1 vertices.
    point_map : array_like of shape (n2,), integers
        Source vertex of each target point.
    truth : Truth
        With c correspondences.
    method : {"edges", "exact"}, default "edges"
        See `geodesics.pair_distances`.

    Returns
    -------
    MapErrors
        ``100 d(point_map[truth.target], truth.source) / sqrt(area)``, d on the source; infinite
        where a point went to another component. In the order of the truth.

    Notes
    -----
    The measure of Kim, Lipman and Funkhouser, *Blended Intrinsic Maps*, SIGGRAPH 2011, with the
    symmetric truth of Ren et al., *Continuous and Orientation-preserving Correspondences via
    Functional Maps*, SIGGRAPH Asia 2018.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> mesh = sk.geometry.sphere(subdivisions=2).geometry
    >>> truth = sk.maps.Truth.of_map(range(mesh.n))
    >>> float(sk.maps.map_errors(mesh, range(mesh.n), truth).direct.max())
    0.0
    """
    p = check_point_map("point_map", point_map, mesh.n)
    at = check_indices("truth.target", truth.target, len(p))
    goals = [truth.source] if truth.symmetric is None else [truth.source, truth.symmetric]
    ends = check_indices("truth", np.concatenate(goals), mesh.n)
    found = pair_distances(mesh, np.tile(p[at], len(goals)), ends, method=method)
    direct, *symmetric = 100 * found.reshape(len(goals), -1) / np.sqrt(mesh.area)
    return MapErrors(direct, at, *symmetric)


@checked
def geodesic_errors(
    mesh: MeshLike,
    point_map: ArrayLike,
    truth: Truth,
    *,
    method: Literal["edges", "exact"] = "edges",
) -> Floats:
    """Measure how far a point map is from the truth, whatever its mirror image.

    Parameters
    ----------
    mesh, point_map, truth, method
        As of `map_errors`, which pictures want: it knows the points.

    Returns
    -------
    ndarray of shape (c,)
        The direct errors.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> mesh = sk.geometry.sphere(subdivisions=2).geometry
    >>> sk.maps.geodesic_errors(mesh, [0, 1], sk.maps.Truth([0, 1], [0, 1]))
    array([0., 0.])
    """
    alone = Truth(truth.source, truth.target)
    return map_errors(mesh, point_map, alone, method=method).direct.copy()


@checked
def accuracy_curve(errors: ArrayLike, thresholds: ArrayLike) -> Floats:
    """Return the share of errors at or below each threshold.

    Parameters
    ----------
    errors : array_like of shape (c,)
        As of `map_errors`.
    thresholds : array_like of shape (t,)
        In the unit of `errors`.

    Returns
    -------
    ndarray of shape (t,)
        From 0 to 1.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> sk.maps.accuracy_curve([0.0, 1.0, 5.0, 5.0], [0.0, 1.0, 10.0])
    array([0.25, 0.5 , 1.  ])
    """
    values = np.sort(_errors("errors", errors))
    at = real_array("thresholds", thresholds)
    return np.asarray(np.searchsorted(values, at, side="right") / len(values))


@checked
def auc(errors: ArrayLike, *, limit: float = 10.0) -> float:
    """Return the area under the accuracy curve up to `limit`, relative to a perfect one's.

    Parameters
    ----------
    errors : array_like of shape (c,)
        As of `map_errors`; infinite ones count as beyond the limit.
    limit : float, default 10
        In the unit of `errors`.

    Returns
    -------
    float
        From 0 to 1: the exact integral, no sampling of thresholds.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> sk.maps.auc([0.0, 5.0, 20.0, 0.0])
    0.625
    """
    limit = check_positive("limit", limit)
    return float(np.mean(1 - np.minimum(_errors("errors", errors), limit) / limit))


def _errors(name: str, values: ArrayLike) -> Floats:
    """Return errors as a flat array: at least one, none negative or NaN."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 1 or not len(array) or not (array >= 0).all():
        raise InvalidInputError(
            name,
            "be at least one number >= 0 in a row",
            f"shape {array.shape} with {int((~(array >= 0)).sum())} negative or NaN",
        )
    return array


@checked
def coverage(point_map: ArrayLike, mass: ArrayLike, target_mass: ArrayLike | None = None) -> float:
    """Return the share of the source's area whose points are the image of some target point.

    Parameters
    ----------
    point_map : array_like of shape (n2,), integers
        Source point of each target point.
    mass : array_like of shape (n1,)
        Of the source points, in any unit.
    target_mass : array_like of shape (n2,), optional
        Of the target points, in any unit: the share is then told over what as many random points
        would reach, as `Match.coverage` is.

    Returns
    -------
    float
        1 for a permutation; less for a true map between two meshings, where several points may
        share their nearest vertex, and others are nobody's. Over chance, above 1 for maps that
        spread the target over the source.

    Notes
    -----
    Of N points thrown at an area of 1, a share ``1 - exp(-N m)`` of the vertices with area m is
    hit. Target points that crowd in one place count as the ``1 / sum(m^2)`` that they amount to,
    and as no more than the source's, all of which many more would hit.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> sk.maps.coverage([0, 0, 1], [1.0, 1.0, 2.0])
    0.5
    """
    weights = check_mass("mass", mass, np.size(mass))
    if target_mass is None:
        p = check_point_map("point_map", point_map, len(weights))
        return float(weights[np.unique(p)].sum() / weights.sum())
    others = check_mass("target_mass", target_mass, np.size(target_mass))
    p = check_point_map("point_map", point_map, len(weights), len(others))
    return coverage_over_chance(weights, others, p)


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
def bijectivity_errors(mesh: MeshLike, point_map: ArrayLike, back: ArrayLike) -> Floats:
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
    found = pair_distances(mesh, np.arange(mesh.n), p[q])
    return np.asarray(100 * found / np.sqrt(mesh.area))


@checked
def inverse_map(source: Spectrum, target: Spectrum, point_map: ArrayLike) -> Ints:
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
    >>> bool((sk.maps.inverse_map(spectrum, spectrum, range(600)) == np.arange(600)).all())
    True
    """
    k = min(_INVERSE_K, source.k, target.k)
    p = check_point_map("point_map", point_map, source.n, target.n)
    a, b = at_unit_area(source), at_unit_area(target)
    C = induced(a, b, p, k, k)
    return nearest(a.eigenvectors[:, :k], b.eigenvectors[:, :k] @ C, exact=True)


@checked
def orientation(
    source_points: ArrayLike, source_faces: ArrayLike, target_faces: ArrayLike, point_map: ArrayLike
) -> float:
    """Tell whether a point map keeps or reverses the orientation of the surface.

    Parameters
    ----------
    source_points : array_like of shape (n1, 3)
        Where the map goes.
    source_faces, target_faces : array_like of shape (f1, 3) and (f2, 3), integers
        Triangles, consistently turned in the same sense (`operators.oriented_triangles`).
    point_map : array_like of shape (n2,), integers
        Source point of each target point.

    Returns
    -------
    float
        From -1 to 1: signed area of the mapped target triangles, seen along the normals of the
        source, over their unsigned area. Near 1 the map keeps orientation, near -1 it mirrors;
        near 0 it does not know, or half of it is flipped. 0 for a constant map.

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
    for corner in faces.T:
        np.add.at(normals, corner, cross)
    normals /= np.maximum(np.linalg.norm(normals, axis=1), np.finfo(np.float64).tiny)[:, None]
    mapped = _crosses(points, images)
    # One flat triangle sees three normals: where these disagree it lies across a sharp edge.
    along = np.sum(mapped * normals[images].mean(axis=1), axis=1)
    total = np.abs(along).sum()
    return float(along.sum() / total) if total > 0 else 0.0


def _crosses(points: Floats, faces: Ints) -> Floats:
    a, b, c = (points[faces[:, i]] for i in range(3))
    return np.asarray(np.cross(b - a, c - a))
