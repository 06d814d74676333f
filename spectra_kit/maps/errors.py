"""Errors of a point map where the truth is known: geodesic, direct and symmetric."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import Rebuilt, check_indices, check_positive, frozen, real_array
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import TriangleMesh
from spectra_kit.maps.checks import check_point_map
from spectra_kit.maps.geodesic import geodesic_distances

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

    Raises
    ------
    InvalidInputError
        If an array holds no integers, a negative one, or has another shape.

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
            array = check_indices(name, values, np.iinfo(np.int64).max)
            if array.ndim != 1 or array.shape != size or not len(array):
                raise InvalidInputError(
                    name, "have the shape (c,) of `source`, c >= 1", f"{array.shape} beside {size}"
                )
            object.__setattr__(self, name, frozen(array.copy()))

    @classmethod
    def of_map(cls, point_map: ArrayLike) -> Truth:
        """Return the truth that a whole true point map of shape (n2,) states."""
        source = check_indices("point_map", point_map, np.iinfo(np.int64).max)
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

    Raises
    ------
    InvalidInputError
        If the arrays differ in shape, an error is negative or NaN, or `target` holds no indices.

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
        object.__setattr__(self, "direct", frozen(_errors("direct", self.direct)))
        target = check_indices("target", self.target, np.iinfo(np.int64).max)
        object.__setattr__(self, "target", frozen(target.copy()))
        if self.symmetric is not None:
            object.__setattr__(self, "symmetric", frozen(_errors("symmetric", self.symmetric)))
        for name in ("target", "symmetric"):
            if (values := getattr(self, name)) is not None and values.shape != self.direct.shape:
                raise InvalidInputError(
                    name, f"have the shape {self.direct.shape} of `direct`", values.shape
                )

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
    mesh: TriangleMesh,
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
        See `geodesic_distances`.

    Returns
    -------
    MapErrors
        ``100 d(point_map[truth.target], truth.source) / sqrt(area)``, d on the source; infinite
        where a point went to another component. In the order of the truth.

    Raises
    ------
    InvalidInputError
        If `point_map` or `truth` has an index out of range, or `truth` is no Truth.

    Notes
    -----
    The measure of Kim, Lipman and Funkhouser, *Blended Intrinsic Maps*, SIGGRAPH 2011, with the
    symmetric truth of Ren et al., *Continuous and Orientation-preserving Correspondences via
    Functional Maps*, SIGGRAPH Asia 2018.

    Examples
    --------
    >>> from spectra_kit.maps import Truth, map_errors
    >>> from spectra_kit.geometry import sphere
    >>> mesh = sphere(subdivisions=2).geometry
    >>> float(map_errors(mesh, range(mesh.n), Truth.of_map(range(mesh.n))).direct.max())
    0.0
    """
    p = check_point_map("point_map", point_map, mesh.n)
    at = check_indices("truth.target", truth.target, len(p))
    goals = [truth.source] if truth.symmetric is None else [truth.source, truth.symmetric]
    found = geodesic_distances(
        mesh, np.tile(p[at], len(goals)), np.concatenate(goals), method=method
    )
    scaled = 100 * found.reshape(len(goals), -1) / np.sqrt(mesh.area)
    return MapErrors(scaled[0], at, *scaled[1:])


@checked
def geodesic_errors(
    mesh: TriangleMesh,
    point_map: ArrayLike,
    truth: Truth,
    *,
    method: Literal["edges", "exact"] = "edges",
) -> Floats:
    """Measure how far a point map is from the truth, whatever its mirror image.

    Parameters
    ----------
    mesh, point_map, truth, method
        As of `map_errors`.

    Returns
    -------
    ndarray of shape (c,)
        The direct errors of `map_errors`, in hundredths of the root of the source's area, and in
        the order of the truth; pictures want `map_errors` itself, which knows the points.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> mesh = sk.geometry.sphere(subdivisions=2).geometry
    >>> sk.maps.geodesic_errors(mesh, [0, 1], sk.maps.Truth([0, 1], [0, 1]))
    array([0., 0.])
    """
    return map_errors(mesh, point_map, Truth(truth.source, truth.target), method=method).direct


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
