"""`MatchedPair`: two geometries and a map between them, as pictures want it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spectra_kit._validate import check_indices
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import Geometry

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False, kw_only=True)
class MatchedPair:
    """Two geometries, a map between them, and what to write beside their pictures.

    Attributes
    ----------
    source, target : TriangleMesh or PointCloud
        With n1 and n2 points.
    point_map : array_like of shape (n2,), integers
        The source point of each target point.
    errors : array_like of shape (n2,), optional
        Of the map at each target point, >= 0; NaN where not known.
    name : str
        Set beside the row, reading upwards.
    names : tuple of str
        What to call the two.
    """

    source: Geometry
    target: Geometry
    point_map: ArrayLike
    errors: ArrayLike | None = None
    name: str = ""
    names: tuple[str, str] = ("source", "target")

    def checked_map(self) -> Ints:
        """Return the point map if it fits the two geometries."""
        n = self.target.n
        if np.shape(self.point_map) != (n,):
            raise InvalidInputError(
                f"`point_map` must have shape ({n},), a source point for each target point,"
                f" got {np.shape(self.point_map)}; are source and target exchanged?"
            )
        return check_indices("point_map", self.point_map, self.source.n)

    def checked_errors(self) -> Floats | None:
        """Return the errors if they fit the target."""
        if self.errors is None:
            return None
        n = self.target.n
        errors = np.asarray(self.errors, dtype=np.float64)
        if errors.shape != (n,) or (errors < 0).any():
            raise InvalidInputError(
                f"`errors` must have shape ({n},), one number >= 0 or NaN for each target"
                f" point, got shape {errors.shape} with {int((errors < 0).sum())} negative"
            )
        return errors
