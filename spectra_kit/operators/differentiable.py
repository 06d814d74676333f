"""Laplacians that know how they came from their points, and so how eigenvalues move with these.

Eigenvalues depend on the points through the lengths of edges alone. Of a mode with ``u^T M u = 1``,
``d lambda = u^T (dL - lambda dM) u``: a sum over triangles, each of which is differentiated by its
sides. Edge flips are taken back one by one, and so is what mollification added: `side_lengths` has
it by corners of the mesh, the library robust_laplacian by connected components.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import quantity
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import TriangleMesh, distinct_rows
from spectra_kit.operators.assemble import laplacian
from spectra_kit.operators.checks import unit_of, units_of
from spectra_kit.operators.laplacian import Laplacian
from spectra_kit.operators.triangle_calculus import energy_slopes, lumped_slopes, voronoi_slopes

_MOLLIFY = 1e-5  # as the operators have it
_SAME = 1e-5  # relative difference of sums over the same triangles, needles among them


#: Takes derivatives by some lengths to those by the lengths these were made of, both (f, 3).
Pullback = Callable[[Floats], Floats]


@dataclass(frozen=True, eq=False)
class DifferentiableLaplacian:
    """The Laplacian of a mesh, its triangles, and the way back from their sides to the points.

    Lengths are in a `unit`, a power of two, in which nothing overflows.
    """

    laplacian: Laplacian
    mesh: TriangleMesh
    unit: float
    corners: NDArray[np.int32]
    lengths: Floats
    share: float
    mass_slopes: Callable[[Floats, Floats], Floats]
    to_faces: Pullback

    def gradient(self, eigenvalues: Floats, eigenvectors: Floats, weights: Floats) -> Floats:
        """Return the derivative (n, 3) of ``sum_j weights_j eigenvalues_j`` by the points.

        In 1/length^3.

        Weights (k,) are equal within a cluster: of the modes of one, only the sum has a derivative.
        Eigenvectors (n, k) are M-orthonormal, and zero where points are fixed.
        """
        heads = np.roll(self.corners, -1, axis=1)
        squares, lumped = np.zeros(self.corners.shape), np.zeros(self.mesh.n)
        for j in np.flatnonzero(weights):  # one by one: no array has all modes on all sides
            u = np.ascontiguousarray(eigenvectors[:, j])
            squares += weights[j] * (u[self.corners] - u[heads]) ** 2
            lumped += weights[j] * (eigenvalues[j] * self.unit**2) * u**2
        slopes = energy_slopes(self.lengths, squares)
        slopes -= self.mass_slopes(self.lengths, lumped[self.corners])
        return _by_points(self.mesh, self.to_faces(self.share * slopes)) / self.unit


def differentiable_laplacian(
    mesh: TriangleMesh,
    operator: Literal["robust", "cotan", "delaunay"],
    boundary: Literal["neumann", "dirichlet"],
) -> DifferentiableLaplacian:
    """Return the `laplacian` of a mesh with its trace.

    Refused where the ends of an edge coincide, as its length has no derivative there, and where the
    library robust_laplacian has other triangles than those found here.
    """
    built, unit = laplacian(mesh, operator=operator, boundary=boundary), unit_of(mesh)
    scaled = mesh.with_points(mesh.points / unit)
    if n_short := int((sides_in_space(scaled) == 0).sum()):
        raise InvalidInputError(
            "points",
            "differ at the two ends of an edge",
            f"{quantity(n_short, 'side')} of length 0",
            advice="join such vertices first",
        )
    if operator == "cotan":
        return DifferentiableLaplacian(
            built,
            scaled,
            unit,
            mesh.faces.astype(np.int32),
            sides_in_space(scaled),
            1.0,
            voronoi_slopes,
            lambda slopes: slopes,
        )
    return _delaunay(scaled, unit, built, by_library=operator == "robust")


def _delaunay(
    mesh: TriangleMesh, unit: float, built: Laplacian, *, by_library: bool
) -> DifferentiableLaplacian:
    """Find the triangles of an intrinsic Delaunay Laplacian again, and record the flips."""
    from spectra_kit.operators import _cover, _edge_flips

    if by_library:
        sides, unmollified = lengthened_by_component(mesh, _MOLLIFY)
        corners, lengths, twins, flips = _cover.tufted_delaunay(mesh, sides)
        copies = 2
        names = np.arange(mesh.n, dtype=np.int32)
        _check_same(built, *_cover.laplacian_of(corners, lengths, twins, names, copies), unit)
    else:
        sides, unmollified = lengthened_by_corner(mesh, _MOLLIFY)
        faces = mesh.faces.astype(np.int32)
        corners, lengths, twins, copies = _cover.cover_of_faces(mesh.points, faces, sides)
        flips = _cover.make_delaunay(corners, lengths, twins, recorded=True)

    def to_faces(slopes: Floats) -> Floats:
        before, slopes = lengths.copy(), slopes.copy()
        _edge_flips.undo_flips(before.reshape(-1), slopes.reshape(-1), *flips)
        return unmollified(_cover.folded(slopes, copies))

    return DifferentiableLaplacian(
        built, mesh, unit, corners, lengths, 1 / copies, lumped_slopes, to_faces
    )


def _check_same(built: Laplacian, stiffness: sparse.csr_array, mass: Floats, unit: float) -> None:
    """Refuse where the library has other triangles: its derivatives are not known."""
    apart = abs(built.stiffness - stiffness).max(axis=1).toarray().ravel()
    other = apart > _SAME * (1 + built.stiffness.diagonal())
    other |= abs(built.mass / unit**2 - mass) > _SAME * mass
    if other.any():
        raise InvalidInputError(
            "operator",
            "be a sum over triangles that are known, to be differentiated",
            f"robust, with other triangles at {quantity(int(other.sum()), 'vertex')}",
            advice="use delaunay",
        )


def _by_points(mesh: TriangleMesh, slopes: Floats) -> Floats:
    """Take derivatives by the sides of the faces to those by the points, shape (n, 3)."""
    heads = np.roll(mesh.faces, -1, axis=1)
    along = mesh.points[heads] - mesh.points[mesh.faces]
    along *= (slopes / np.linalg.norm(along, axis=2))[:, :, None]
    gradient = np.empty((mesh.n, 3))
    for axis in range(3):
        by_side = along[:, :, axis].ravel()
        gradient[:, axis] = np.bincount(heads.ravel(), by_side, minlength=mesh.n)
        gradient[:, axis] -= np.bincount(mesh.faces.ravel(), by_side, minlength=mesh.n)
    return gradient


def sides_in_space(mesh: TriangleMesh) -> Floats:
    """Return the length of the side from corner c to corner c + 1 of each face, shape (f, 3)."""
    corners = mesh.points[mesh.faces]
    return np.asarray(np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2))


def lengthened_by_corner(mesh: TriangleMesh, factor: float) -> tuple[Floats, Pullback]:
    """Return the sides as `delaunay_laplacian` has them, and the way back."""
    from spectra_kit.operators._edge_flips import side_lengths  # numba is slow to import

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
