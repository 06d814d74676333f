"""Moving and scaling a geometry to unit size, and back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar, cast

import numpy as np

from spectra_kit._core.checked import checked
from spectra_kit._core.records import Brief, frozen
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_points, check_positive, quantity, real_array
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import Geometry, GeometryLike, MeshLike, PointCloud, TriangleMesh

Movable = TypeVar("Movable", bound=Floats | TriangleMesh | PointCloud)


@checked
@dataclass(frozen=True, eq=False)
class Normalization(Brief):
    """The map ``x -> (x - centre) / scale`` of points, and its inverse.

    Parameters
    ----------
    centre : array_like of shape (3,)
        The point that goes to the origin, in the unit of the geometry.
    scale : float
        The length that becomes 1, in the same unit.

    Notes
    -----
    A spectrum of the normalised geometry belongs to the original after
    ``spectrum.rescale(scale)``: eigenvalues are divided by scale^2.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.geometry import Normalization, PointCloud
    >>> cloud = PointCloud([[0, 0, 0], [4000, 0, 0], [0, 2000, 0]])
    >>> to_unit = Normalization.unit_box(cloud)
    >>> to_unit.apply(cloud).points[1]
    array([ 0.5 , -0.25,  0.  ])
    >>> bool(np.array_equal(to_unit.invert(to_unit.apply(cloud.points)), cloud.points))
    True
    """

    centre: Floats
    scale: float

    def __post_init__(self) -> None:
        centre = check_points("centre", np.array(self.centre)[None])[0]
        object.__setattr__(self, "centre", frozen(centre))
        object.__setattr__(self, "scale", check_positive("scale", self.scale))

    @classmethod
    def unit_box(cls, geometry: GeometryLike) -> Normalization:
        """Centre the bounding box at the origin, its longest side 1: in [-0.5, 0.5]^3."""
        low, high = geometry.points.min(axis=0), geometry.points.max(axis=0)
        side = float((high - low).max())
        if side == 0:
            raise InvalidInputError(
                "geometry",
                "have an extent to be normalised",
                f"{quantity(geometry.n, 'point')} at {tuple(low.tolist())}",
            )
        return cls(low + 0.5 * (high - low), side)

    @classmethod
    def unit_area(cls, mesh: MeshLike) -> Normalization:
        """Centre the surface at its centroid and make its area 1."""
        if mesh.area == 0:
            raise InvalidInputError("mesh", "have area", "only degenerate faces")
        weights = mesh.face_areas / mesh.area
        centroids = mesh.points[mesh.faces].mean(axis=1)
        return cls(weights @ centroids, float(np.sqrt(mesh.area)))

    def apply(self, geometry: Movable) -> Movable:
        """Return the normalised copy of a geometry, or of points of shape (n, 3)."""
        return _moved(geometry, lambda points: (points - self.centre) / self.scale)

    def invert(self, geometry: Movable) -> Movable:
        """Return the copy in the original place and size; the inverse of `apply`."""
        return _moved(geometry, lambda points: points * self.scale + self.centre)


def _moved(geometry: Movable, move: Callable[[Floats], Floats]) -> Movable:
    if isinstance(geometry, TriangleMesh | PointCloud):
        return cast("Movable", geometry.with_points(move(geometry.points)))
    points = real_array("geometry", cast("Floats", geometry))
    if points.shape[-1:] != (3,):
        raise InvalidInputError(
            "geometry",
            "be a TriangleMesh, a PointCloud or points of shape (..., 3)",
            f"shape {points.shape}",
        )
    return cast("Movable", move(points))


@checked
def normalize(geometry: GeometryLike) -> tuple[Geometry, Normalization]:
    """Return the geometry in the unit box, and the map that took it there.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        Of more than a single point.

    Returns
    -------
    normalized : TriangleMesh or PointCloud
        With its bounding box centred at the origin and its longest side 1.
    normalization : Normalization
        ``normalization.invert`` brings points and geometries back.

    Examples
    --------
    >>> from spectra_kit.geometry import PointCloud, normalize
    >>> unit, to_unit = normalize(PointCloud([[0, 0, 0], [10, 0, 0]]))
    >>> unit.points[:, 0], to_unit.scale
    (array([-0.5,  0.5]), 10.0)
    """
    normalization = Normalization.unit_box(geometry)
    return normalization.apply(geometry), normalization
