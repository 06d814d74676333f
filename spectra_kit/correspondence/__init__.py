"""Quality of a map between two geometries, with and without a known truth.

A ``point_map`` of shape (n2,) holds the source point of each target point. Errors are distances
along the source surface in hundredths of the root of its area.
"""

from spectra_kit.correspondence.errors import (
    FLIP_MARGIN,
    MapErrors,
    Truth,
    accuracy_curve,
    auc,
    geodesic_errors,
    map_errors,
)
from spectra_kit.correspondence.geodesic import edge_graph, geodesic_distances
from spectra_kit.correspondence.quality import (
    bijectivity_errors,
    coverage,
    dirichlet_energy,
    orientation,
)

__all__ = [
    "FLIP_MARGIN",
    "MapErrors",
    "Truth",
    "accuracy_curve",
    "auc",
    "bijectivity_errors",
    "coverage",
    "dirichlet_energy",
    "edge_graph",
    "geodesic_distances",
    "geodesic_errors",
    "map_errors",
    "orientation",
]
