"""`MatchedPair`: two geometries and a map between them, as pictures want it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._checked import checked
from spectra_kit._types import Floats, Ints
from spectra_kit._validate import Brief, check_indices
from spectra_kit.correspondence import MapErrors
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import Geometry


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class MatchedPair(Brief):
    """Two geometries, a map between them, and what to write beside their pictures.

    Attributes
    ----------
    source, target : TriangleMesh or PointCloud
        With n1 and n2 points.
    point_map : array_like of shape (n2,), integers
        The source point of each target point.
    errors : MapErrors, optional
        Of the map, which say at which target points they are.
    name : str
        Set beside the row, reading upwards.
    names : tuple of str
        What to call the two.
    """

    source: Geometry
    target: Geometry
    point_map: ArrayLike
    errors: MapErrors | None = None
    name: str = ""
    names: tuple[str, str] = ("source", "target")

    def checked_map(self) -> Ints:
        """Return the point map if it fits the two geometries."""
        n = self.target.n
        if np.shape(self.point_map) != (n,):
            raise InvalidInputError(
                "point_map",
                f"have shape ({n},), a source point for each target point",
                np.shape(self.point_map),
                advice="are source and target exchanged?",
            )
        return check_indices("point_map", self.point_map, self.source.n)

    def checked_errors(self) -> Floats | None:
        """Return the errors at each target point, (n2,), NaN where not known."""
        return None if self.errors is None else self.errors.at_points(self.target.n)
