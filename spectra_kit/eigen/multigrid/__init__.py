"""Coarse levels of an operator: a well-spread subset of its points, and the way back to all."""

from spectra_kit.eigen.multigrid.cascade import coarsest_eigenpairs
from spectra_kit.eigen.multigrid.coarse import Coarse, Subset, coarsen, prolongation, well_spread
from spectra_kit.eigen.multigrid.smoothing import smoothed

__all__ = [
    "Coarse",
    "Subset",
    "coarsen",
    "coarsest_eigenpairs",
    "prolongation",
    "smoothed",
    "well_spread",
]
