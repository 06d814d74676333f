"""The sides of faces after mollification, and derivatives by them taken back to sides in space.

Sides of nearly degenerate triangles are lengthened until, at each corner, the two sides that meet
exceed the third by a share of the mean side. `side_lengths` does this by corners of the mesh,
the library robust_laplacian by connected components.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from spectra_kit._core.types import Floats, Ints
from spectra_kit.geometry.shapes import TriangleMesh, distinct_rows
from spectra_kit.operators.checks import units_of

#: Takes derivatives by some lengths to those by the lengths these were made of, both (f, 3).
Pullback = Callable[[Floats], Floats]


def sides_in_space(mesh: TriangleMesh) -> Floats:
    """Return the length of the side from corner c to corner c + 1 of each face, shape (f, 3)."""
    corners = mesh.points[mesh.faces]
    return np.asarray(np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2))


def lengthened_by_corner(mesh: TriangleMesh, factor: float) -> tuple[Floats, Pullback]:
    """Return the sides as `delaunay_laplacian` has them, and the way back."""
    from spectra_kit.operators._half_edges import side_lengths  # numba is slow to import

    unit, faces = units_of(mesh), mesh.faces
    scale = unit[faces[:, :1]]
    points = mesh.points / unit[:, None]
    sides = side_lengths(points, faces.astype(np.int32), factor) * scale
    space = sides_in_space(mesh)
    lacking = factor * space.mean(axis=1, keepdims=True) - _slacks(space)
    thin = np.flatnonzero(lacking > 0)
    # Of all triangles at a vertex, the one that lacks most says how much is added there.
    thin = thin[np.argsort(lacking.flat[thin], kind="stable")]
    decisive = np.full(mesh.n, -1)
    decisive[faces.flat[thin]] = thin
    vertices = np.flatnonzero(decisive >= 0)
    t, c = np.divmod(decisive[vertices], 3)

    def back(slopes: Floats) -> Floats:
        at_corners = slopes + np.roll(slopes, 1, axis=1)
        added = np.bincount(faces.ravel(), at_corners.ravel(), minlength=mesh.n)[vertices] / 2
        slopes = slopes.copy()
        np.add.at(slopes, t, added[:, None] * factor / 3)
        _add_to_slacks(slopes, t, c, -added)
        return slopes

    return sides, back


def lengthened_by_component(mesh: TriangleMesh, factor: float) -> tuple[Floats, Pullback]:
    """Return the sides as `robust_laplacian` has them, and the way back.

    In units of the mean edge of each component, all are lengthened by the same.
    """
    space, label = sides_in_space(mesh), mesh.component_labels[mesh.faces]
    edge = distinct_rows(mesh.edges)[1]
    once = (1 / np.bincount(edge))[edge].reshape(space.shape)  # an edge has several sides
    once /= np.bincount(label.ravel(), once.ravel())[label]
    means = np.bincount(label.ravel(), (once * space).ravel())
    slacks = _slacks(space) / means[label]
    longer = factor - slacks.min()
    if longer <= 0:
        return space, lambda slopes: slopes
    t, c = np.divmod(np.array([slacks.argmin()]), 3)

    def back(slopes: Floats) -> Floats:
        total = np.bincount(label.ravel(), slopes.ravel(), minlength=len(means))
        by_longer = float(total @ means)
        by_means = longer * total
        by_means[label[t, c]] += by_longer * slacks[t, c] / means[label[t, c]]
        slopes = slopes + once * by_means[label]
        _add_to_slacks(slopes, t, c, -by_longer / means[label[t, c]])
        return slopes

    return space + longer * means[label], back


def _slacks(sides: Floats) -> Floats:
    """By how much the two sides that meet at each corner exceed the third, shape (f, 3)."""
    return np.asarray(sides + np.roll(sides, 1, axis=1) - np.roll(sides, -1, axis=1))


def _add_to_slacks(slopes: Floats, t: Ints, c: Ints, values: Floats) -> None:
    """Add, in place, what the derivatives by the slacks at corners c of faces t tell of sides."""
    for side, sign in ((c, 1), (c - 1, 1), (c - 2, -1)):
        np.add.at(slopes, (t, side), sign * values)
