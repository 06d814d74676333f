"""Match two surfaces without mirroring them: candidates, their scores, the best one refined.

And many, so that their maps agree: `match_collection`.



Functional maps: fit, refine and convert correspondences between two spectra.

Conventions, the same in every function here; `source` is the first argument, `target` the second.

- ``functional_map`` is C_12, of shape (k2, k1). It carries functions from source to target:
  coefficients ``a`` on the source's modes become ``C_12 @ a`` on the target's.
- ``point_map`` is p2p_21, of shape (n2,). Entry i is the source point that target point i
  corresponds to. It runs **against** the functional map, which is the pull-back along it:
  ``C_12 = U2.T @ M2 @ U1[point_map]``.
- Both surfaces are taken at unit area, whatever their units, so a functional map between a
  surface in metres and its copy in millimetres is the one between equals.

========  ==================================================  ===================================
fit       `fit_functional_map`                                from descriptors or landmarks
refine    `zoomout`, `bijective_zoomout`, `icp`               to a `Correspondence`: both maps
          `zoomout_many`                                      on samples, to go on from
convert   `point_map_from_functional_map`,                    one kind of map to the other
          `functional_map_from_point_map`
          `precise_map`, `functional_map_from_precise_map`    with points inside triangles
========  ==================================================  ===================================

A fit may be flipped, and no refinement turns it round; `spectra_kit.maps` sees to that.

>>> import spectra_kit as sk
>>> mesh = sk.geometry.creature(600)
>>> copy, truth = sk.geometry.permuted(mesh)
>>> source, target = (sk.eigensolve(sk.robust_laplacian(m), 40) for m in (mesh, copy))
>>> descriptors = [sk.features.wave_kernel_signature(spectrum) for spectrum in (source, target)]
>>> functional_map = sk.maps.fit_functional_map(source, target, *descriptors, k=20)
>>> refined = sk.maps.zoomout(source, target, functional_map, k_final=40)
>>> refined, bool((refined.point_map == truth).all())
(Correspondence(600 points, functional map 40 x 40), True)



Quality of a map between two geometries, with and without a known truth.

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

>>> from spectra_kit.maps import Truth, geodesic_errors, orientation
>>> from spectra_kit.geometry import creature_pair
>>> source, target, point_map = creature_pair(800, 700)
>>> float(geodesic_errors(source, point_map, Truth.of_map(point_map)).max())
0.0
>>> orientation(source.points, source.faces, target.faces, point_map)
1.0
"""

from spectra_kit.maps.collection import CollectedPair, Collection, match_collection
from spectra_kit.maps.convert import (
    Correspondence,
    functional_map_from_point_map,
    point_map_from_functional_map,
)
from spectra_kit.maps.errors import (
    FLIP_MARGIN,
    MapErrors,
    Truth,
    accuracy_curve,
    auc,
    geodesic_errors,
    map_errors,
)
from spectra_kit.maps.fit import FitWeights, fit_functional_map
from spectra_kit.maps.geodesic import edge_graph, geodesic_distances
from spectra_kit.maps.local import local_confidence
from spectra_kit.maps.match import match
from spectra_kit.maps.nearest import nearest_rows
from spectra_kit.maps.options import MatchOptions, ScoreWeights
from spectra_kit.maps.partial import match_part
from spectra_kit.maps.precise import functional_map_from_precise_map, precise_map
from spectra_kit.maps.prepare import Prepared, prepare
from spectra_kit.maps.quality import (
    bijectivity_errors,
    coverage,
    dirichlet_energy,
    orientation,
    way_back,
)
from spectra_kit.maps.refine import bijective_zoomout, icp
from spectra_kit.maps.result import Candidate, Match
from spectra_kit.maps.score import (
    coverage_over_chance,
    mismatches,
    orientation_of,
    score_of,
)
from spectra_kit.maps.zoomout import zoomout, zoomout_many

__all__ = [
    "FLIP_MARGIN",
    "Candidate",
    "CollectedPair",
    "Collection",
    "Correspondence",
    "FitWeights",
    "MapErrors",
    "Match",
    "MatchOptions",
    "Prepared",
    "ScoreWeights",
    "Truth",
    "accuracy_curve",
    "auc",
    "bijective_zoomout",
    "bijectivity_errors",
    "coverage",
    "coverage_over_chance",
    "dirichlet_energy",
    "edge_graph",
    "fit_functional_map",
    "functional_map_from_point_map",
    "functional_map_from_precise_map",
    "geodesic_distances",
    "geodesic_errors",
    "icp",
    "local_confidence",
    "map_errors",
    "match",
    "match_collection",
    "match_part",
    "mismatches",
    "nearest_rows",
    "orientation",
    "orientation_of",
    "point_map_from_functional_map",
    "precise_map",
    "prepare",
    "score_of",
    "way_back",
    "zoomout",
    "zoomout_many",
]
