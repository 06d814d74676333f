"""Meshes and point clouds."""

from spectra_kit.geometry.io import read, write
from spectra_kit.geometry.sampling import GaussianDensity, Samples, sample, sample_with_origin
from spectra_kit.geometry.shapes import Geometry, PointCloud, TriangleMesh

__all__ = [
    "GaussianDensity",
    "Geometry",
    "PointCloud",
    "Samples",
    "TriangleMesh",
    "read",
    "sample",
    "sample_with_origin",
    "write",
]
