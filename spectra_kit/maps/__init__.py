"""Which point is which: functional maps, `match` on top of them, and how good a map is.

Conventions, the same in every function here; `source` is the first argument, `target` the second.

- ``functional_map`` is C_12, of shape (k2, k1). It carries functions from source to target:
  coefficients ``a`` on the source's modes become ``C_12 @ a`` on the target's.
- ``point_map`` is p2p_21, of shape (n2,). Entry i is the source point that target point i
  corresponds to. It runs **against** the functional map, which is the pull-back along it:
  ``C_12 = U2.T @ M2 @ U1[point_map]``.
- Both surfaces are taken at unit area, whatever their units, so a functional map between a
  surface in metres and its copy in millimetres is the one between equals.

========  ===================================================  ==================================
match     `match`, `match_part`, `match_components`,           a `Match`: not mirrored, and how
          `match_collection`, `prepare`                        sure that is
fit       `fit_functional_map`                                 from descriptors or landmarks
refine    `zoomout`, `bijective_zoomout`, `icp`                to a `Correspondence`: both maps
          `zoomout_many`                                       on samples, to go on from
convert   `point_map_from_functional_map`,                     one kind of map to the other
          `functional_map_from_point_map`
          `precise_map`, `functional_map_from_precise_map`     with points inside triangles
carry     `Carrier`, `Match.carry`                             values, labels, landmarks, vectors,
                                                               textures and poses along a map
compare   `shape_difference`                                   where it stretches, and by how much
judge     `geodesic_errors`, `map_errors`, `accuracy_curve`,   against a known `Truth`, in
          `auc`                                                hundredths of the root of the area
          `coverage`, `dirichlet_energy`, `orientation`,       without one
          `inverse_map`, `bijectivity_errors`, `score_map`
========  ===================================================  ==================================

A fit may be flipped, and no refinement turns it round; `match` sees to that.

>>> import spectra_kit as sk
>>> mesh = sk.geometry.creature(600)
>>> copy, truth = sk.geometry.permuted(mesh)
>>> source, target = (sk.eigensolve(sk.robust_laplacian(m), 40) for m in (mesh, copy))
>>> descriptors = [sk.features.wave_kernel_signature(spectrum) for spectrum in (source, target)]
>>> functional_map = sk.maps.fit_functional_map(source, target, *descriptors, k=20)
>>> refined = sk.maps.zoomout(source, target, functional_map, k_final=40)
>>> refined, bool((refined.point_map == truth).all())
(Correspondence(600 points, functional map 40 x 40), True)
"""

from spectra_kit.maps.carry import CarriedLabels, Carrier
from spectra_kit.maps.collection import CollectedPair, Collection, match_collection
from spectra_kit.maps.components import ComponentMatch, match_components
from spectra_kit.maps.convert import (
    Correspondence,
    functional_map_from_point_map,
    functional_map_from_precise_map,
    point_map_from_functional_map,
    precise_map,
)
from spectra_kit.maps.difference import ShapeDifference, shape_difference
from spectra_kit.maps.evaluate import (
    FLIP_MARGIN,
    MapErrors,
    Truth,
    accuracy_curve,
    auc,
    bijectivity_errors,
    coverage,
    dirichlet_energy,
    geodesic_errors,
    inverse_map,
    map_errors,
    orientation,
)
from spectra_kit.maps.fit import FitWeights, fit_functional_map
from spectra_kit.maps.match import match
from spectra_kit.maps.nearest import nearest_rows
from spectra_kit.maps.partial import match_part
from spectra_kit.maps.prepare import Prepared, prepare
from spectra_kit.maps.result import Candidate, Match, MatchOptions
from spectra_kit.maps.score import local_confidence, score_map
from spectra_kit.maps.zoomout import bijective_zoomout, icp, zoomout, zoomout_many

__all__ = [
    "FLIP_MARGIN",
    "Candidate",
    "CarriedLabels",
    "Carrier",
    "CollectedPair",
    "Collection",
    "ComponentMatch",
    "Correspondence",
    "FitWeights",
    "MapErrors",
    "Match",
    "MatchOptions",
    "Prepared",
    "ShapeDifference",
    "Truth",
    "accuracy_curve",
    "auc",
    "bijective_zoomout",
    "bijectivity_errors",
    "coverage",
    "dirichlet_energy",
    "fit_functional_map",
    "functional_map_from_point_map",
    "functional_map_from_precise_map",
    "geodesic_errors",
    "icp",
    "inverse_map",
    "local_confidence",
    "map_errors",
    "match",
    "match_collection",
    "match_components",
    "match_part",
    "nearest_rows",
    "orientation",
    "point_map_from_functional_map",
    "precise_map",
    "prepare",
    "score_map",
    "shape_difference",
    "zoomout",
    "zoomout_many",
]
