"""Smoothed mean curvature: what tells the front of a limb from its back."""

from __future__ import annotations

import numpy as np

from spectra_kit._core.types import Floats
from spectra_kit.eigen import Spectrum
from spectra_kit.operators.oriented import OrientedTriangles


def outward_normals(points: Floats, oriented: OrientedTriangles) -> Floats:
    """Return unit normals at the points, (n, 3): of the triangles around, weighted by area.

    Zero where no triangle is, or where the triangles around cancel.
    """
    i, j, k = oriented.faces.T
    across = np.cross(points[j] - points[i], points[k] - points[i]) * oriented.weights[:, None]
    sums = np.column_stack(
        [
            np.bincount(oriented.faces.ravel(), np.repeat(across[:, r], 3), minlength=len(points))
            for r in range(3)
        ]
    )
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    out: Floats = np.divide(sums, lengths, out=np.zeros_like(sums), where=lengths > 0)
    return out


def smoothed_mean_curvature(
    spectrum: Spectrum, points: Floats, oriented: OrientedTriangles, modes: tuple[int, ...]
) -> Floats:
    """Return twice the signed mean curvature of the surface, smoothed by a short heat flow.

    In 1/length, positive where the surface is convex; a column for each of `modes`, with heat that
    flows for the time 1 / lambda of that mode. The mean curvature normal is the Laplacian of the
    coordinates, ``2 H n = L x``; with the heat flow, ``n . U diag(lambda exp(-t lambda)) U^T M x``.
    Bending a surface changes it at the bends only. It does not see reflections.
    """
    normals = outward_normals(points, oriented)
    coefficients = spectrum.project(points)
    out = np.empty((spectrum.n, len(modes)))
    for c, mode in enumerate(modes):
        gain = spectrum.eigenvalues * np.exp(-spectrum.eigenvalues / spectrum.eigenvalues[mode])
        smooth = spectrum.eigenvectors @ (gain[:, None] * coefficients)
        out[:, c] = np.einsum("nr,nr->n", smooth, normals)
    return out
