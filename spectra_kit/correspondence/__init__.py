"""Quality of a map between two geometries, with and without a known truth.

A ``point_map`` of shape (n2,) holds the source point of each target point. Errors are distances
along the source surface in hundredths of the root of its area.

=====================================  ======================  ==================================
of a map                               needs, beside the map   says
=====================================  ======================  ==================================
`geodesic_errors`, `map_errors`        source mesh, `Truth`    how far points are from the truth
`coverage`                             mass of the source      which part of it is reached
`dirichlet_energy`                     both Laplacians         how much it stretches and tears
`orientation`                          triangles of both       whether it mirrors
`way_back`                             both spectra            a map back
`bijectivity_errors`                   source mesh, map back   how far from where they began
                                                               points come back
=====================================  ======================  ==================================

`accuracy_curve` and `auc` sum errors up.

>>> from spectra_kit.correspondence import Truth, geodesic_errors, orientation
>>> from spectra_kit.geometry import creature_pair
>>> source, target, point_map = creature_pair(800, 700)
>>> float(geodesic_errors(source, point_map, Truth.of_map(point_map)).max())
0.0
>>> orientation(source.points, source.faces, target.faces, point_map)
1.0
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
    way_back,
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
    "way_back",
]
