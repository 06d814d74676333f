"""What can be said of a map between two shapes, with and without a known truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spectra_kit._types import Ints
from spectra_kit.correspondence import (
    MapErrors,
    Truth,
    auc,
    bijectivity_errors,
    coverage,
    dirichlet_energy,
    map_errors,
    orientation,
    way_back,
)
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import Geometry, TriangleMesh
from spectra_kit.matching import Match
from spectra_kit.matching.result import Doubt
from spectra_kit.operators import Laplacian
from spectra_kit.operators.oriented import oriented_triangles
from spectra_kit.spectra import Spectrum


@dataclass(frozen=True, eq=False)
class Side:
    """One of two shapes, with its operator and its spectrum."""

    name: str
    geometry: Geometry
    laplacian: Laplacian
    spectrum: Spectrum


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors of a point map where the truth is known, and what they are."""

    known: MapErrors
    label: str

    def summary(self) -> dict[str, object]:
        """Mean, median, share and area under the curve."""
        known = self.known.direct
        return {
            "error": self.label,
            "mean_error": float(known.mean()),
            "median_error": float(np.median(known)),
            "share_of_errors_below_5": float((known <= 5).mean()),
            "auc_to_10": auc(known),
        }


def doubts_of(found: Match) -> str:
    """Say what speaks against a match; nothing if nothing does."""
    other = "does not mirror" if found.mirrored else "mirrors"
    told: dict[Doubt, str] = {
        "margin": "another map scores nearly as well",
        "mirror_margin": f"one that {other} scores better",
        "orientation": "its orientation is not that of a whole map",
        "consistent": "it is in doubt which side of a cloud is out",
        "coverage": "it covers hardly more of the source than chance would",
        "score": "the surfaces look no more alike than unrelated ones",
    }
    return ", ".join(told[name] for name in found.doubts)


def errors_of(source: Side, point_map: Ints, truth: Ints) -> Errors:
    """Measure a point map (n2,) against the true one, which is negative where it is not known."""
    known = np.flatnonzero(truth >= 0)
    if isinstance(source.geometry, TriangleMesh):
        errors = map_errors(source.geometry, point_map, Truth(truth[known], known))
        return Errors(errors, "geodesic error, 100 / √area")
    points = source.geometry.points
    straight = np.linalg.norm(points[point_map[known]] - points[truth[known]], axis=1)
    scaled = 100 * straight / np.sqrt(source.laplacian.area)
    return Errors(MapErrors(scaled, known), "straight-line error, 100 / √area")


def quality_of(source: Side, target: Side, point_map: Ints) -> dict[str, object]:
    """Judge a point map by itself; None stands for what cannot be measured on these shapes."""
    return {
        "point_map_orientation": _orientation(source, target, point_map),
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
    back = way_back(source.spectrum, target.spectrum, point_map)
    return float(bijectivity_errors(source.geometry, point_map, back).mean())
