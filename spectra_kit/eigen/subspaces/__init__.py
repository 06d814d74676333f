"""Subspaces that hold the low eigenfunctions, as functions of points and mass alone."""

from spectra_kit.eigen.subspaces.ambient_fourier import AmbientFourier
from spectra_kit.eigen.subspaces.base import GivenBasis, RandomBasis, Subspace, Union, restricted
from spectra_kit.eigen.subspaces.frame import POSES, Frame, canonical_frame

__all__ = [
    "POSES",
    "AmbientFourier",
    "Frame",
    "GivenBasis",
    "RandomBasis",
    "Subspace",
    "Union",
    "canonical_frame",
    "restricted",
]
