"""Coarse levels of an operator: a well-spread subset of its points, and the way back to all."""

from spectra_kit.eigen.multigrid.coarse import Coarse, coarsen
from spectra_kit.eigen.multigrid.interpolation import prolongation
from spectra_kit.eigen.multigrid.smoothing import smoothed
from spectra_kit.eigen.multigrid.solve import coarse_pairs
from spectra_kit.eigen.multigrid.subset import Subset, well_spread

__all__ = [
    "Coarse",
    "Subset",
    "coarse_pairs",
    "coarsen",
    "prolongation",
    "smoothed",
    "well_spread",
]
