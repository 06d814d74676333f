"""Functional maps: fit, refine and convert correspondences between two spectra.

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

A fit may be flipped, and no refinement turns it round; `spectra_kit.matching` sees to that.

>>> import spectra_kit as sk
>>> mesh = sk.geometry.creature(600)
>>> copy, truth = sk.geometry.permuted(mesh)
>>> source, target = (sk.eigensolve(sk.robust_laplacian(m), 40) for m in (mesh, copy))
>>> descriptors = [sk.descriptors.wave_kernel_signature(spectrum) for spectrum in (source, target)]
>>> functional_map = sk.functional_maps.fit_functional_map(source, target, *descriptors, k=20)
>>> refined = sk.functional_maps.zoomout(source, target, functional_map, k_final=40)
>>> refined, bool((refined.point_map == truth).all())
(Correspondence(600 points, functional map 40 x 40), True)
"""

from spectra_kit.functional_maps.convert import (
    Correspondence,
    functional_map_from_point_map,
    point_map_from_functional_map,
)
from spectra_kit.functional_maps.fit import FitWeights, fit_functional_map
from spectra_kit.functional_maps.nearest import nearest_rows
from spectra_kit.functional_maps.precise import functional_map_from_precise_map, precise_map
from spectra_kit.functional_maps.refine import bijective_zoomout, icp
from spectra_kit.functional_maps.zoomout import zoomout, zoomout_many

__all__ = [
    "Correspondence",
    "FitWeights",
    "bijective_zoomout",
    "fit_functional_map",
    "functional_map_from_point_map",
    "functional_map_from_precise_map",
    "icp",
    "nearest_rows",
    "point_map_from_functional_map",
    "precise_map",
    "zoomout",
    "zoomout_many",
]
