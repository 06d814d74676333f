"""What can be said of a map between two shapes, with and without a known truth."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from spectra_kit.correspondence import (
    Truth,
    auc,
    bijectivity_errors,
    coverage,
    dirichlet_energy,
    geodesic_errors,
    orientation,
)
from spectra_kit.errors import InvalidInputError
from spectra_kit.functional_maps import (
    functional_map_from_point_map,
    point_map_from_functional_map,
)
from spectra_kit.geometry import Geometry, TriangleMesh
from spectra_kit.matching import Match
from spectra_kit.operators import Laplacian
from spectra_kit.operators.orientation import oriented_triangles
from spectra_kit.spectrum import Spectrum

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_WAY_BACK = 60  # modes that lead from source to target


@dataclass(frozen=True, eq=False)
class Side:
    """One of two shapes, with its operator and its spectrum."""

    name: str
    geometry: Geometry
    laplacian: Laplacian
    spectrum: Spectrum


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors of a point map where the truth is known.

    Attributes
    ----------
    at_points : ndarray of shape (n2,)
        In hundredths of the root of the source's area; NaN where the truth is not known.
    label : str
        What they are.
    """

    at_points: Floats
    label: str

    @property
    def known(self) -> Floats:
        """Those that are known, in a row."""
        return self.at_points[~np.isnan(self.at_points)]

    def summary(self) -> dict[str, object]:
        """Mean, median, share and area under the curve."""
        known = self.known
        return {
            "error": self.label,
            "mean_error": float(known.mean()),
            "median_error": float(np.median(known)),
            "share_of_errors_below_5": float((known <= 5).mean()),
            "auc_to_10": auc(known),
        }


def doubts_of(found: Match) -> str:
    """Say why a match is ambiguous; nothing if it is not."""
    clear = {
        "margin": math.inf,
        "other_side": math.inf,
        "orientation": -1.0 if found.mirrored else 1.0,
        "consistent": 1.0,
    }
    other = "does not mirror" if found.mirrored else "mirrors"
    told = {
        "margin": "another map scores nearly as well",
        "other_side": f"one that {other} scores better",
        "orientation": "its orientation is not that of a whole map",
        "consistent": "it is in doubt which side of a cloud is out",
    }
    alone = {name: clear | {name: getattr(found, name)} for name in clear}  # one doubt at a time
    return ", ".join(why for name, why in told.items() if replace(found, **alone[name]).ambiguous)


def errors_of(source: Side, point_map: Ints, truth: Ints) -> Errors:
    """Measure a point map (n2,) against the true one, which is negative where it is not known."""
    known = np.flatnonzero(truth >= 0)
    errors = np.full(len(truth), np.nan)
    if isinstance(source.geometry, TriangleMesh):
        errors[known] = geodesic_errors(source.geometry, point_map, Truth(truth[known], known))
        return Errors(errors, "geodesic error, 100 / √area")
    points = source.geometry.points
    straight = np.linalg.norm(points[point_map[known]] - points[truth[known]], axis=1)
    errors[known] = 100 * straight / np.sqrt(source.laplacian.area)
    return Errors(errors, "straight-line error, 100 / √area")


def quality_of(source: Side, target: Side, point_map: Ints) -> dict[str, object]:
    """Judge a point map by itself; None stands for what cannot be measured on these shapes."""
    return {
        "orientation": _orientation(source, target, point_map),
        "coverage": coverage(point_map, source.spectrum.mass),
        "dirichlet_energy": dirichlet_energy(source.laplacian, target.laplacian, point_map),
        "way_back_error": _way_back(source, target, point_map),
    }


def _orientation(source: Side, target: Side, point_map: Ints) -> float | None:
    try:
        a, b = (oriented_triangles(side.geometry) for side in (source, target))
    except InvalidInputError:  # a surface without a consistent winding has no orientation
        return None
    return orientation(source.geometry.points, a.faces, b.faces, point_map)


def _way_back(source: Side, target: Side, point_map: Ints) -> float | None:
    """Mean distance between a source point and where the map takes its image."""
    if not isinstance(source.geometry, TriangleMesh):
        return None
    k = min(_WAY_BACK, source.spectrum.k, target.spectrum.k)
    there = functional_map_from_point_map(source.spectrum, target.spectrum, point_map, k=k)
    # Of a bijection that keeps areas the map is orthogonal, and its transpose leads back.
    back = point_map_from_functional_map(target.spectrum, source.spectrum, there.T)
    return float(bijectivity_errors(source.geometry, point_map, back).mean())
