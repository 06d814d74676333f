"""The boundary that the second term of Weyl's law wants to know."""

from __future__ import annotations

import numpy as np

from spectra_kit.geometry.shapes import Geometry, TriangleMesh
from spectra_kit.spectra import Spectrum


def free_boundary(geometry: Geometry, spectrum: Spectrum) -> float:
    """Length of the boundary that is free, less that where all modes are held at zero.

    Of a cloud it is not known, and taken to be 0.
    """
    if not isinstance(geometry, TriangleMesh):
        return 0.0
    edges, n_faces = geometry.unique_edges
    ends = edges[n_faces == 1]
    start, stop = geometry.points[ends].swapaxes(0, 1)
    held = ~spectrum.eigenvectors[ends].any(axis=(1, 2))
    return float(np.where(held, -1.0, 1.0) @ np.linalg.norm(stop - start, axis=1))
