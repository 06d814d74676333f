"""Texture coordinates and deformations from one surface to another whose faces know a place."""

from __future__ import annotations

from typing import NamedTuple

import igl
import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from spectra_kit._core.types import Floats, Ints
from spectra_kit.geometry import TriangleMesh
from spectra_kit.geometry.shapes import box_unit
from spectra_kit.geometry.vectors import sums
from spectra_kit.maps.convert import nearest_on_triangles
from spectra_kit.operators import cotan_laplacian

_SPREAD = 3.0  # times what a triangle covers of a texture: what is farther is another part of it
_FLAT = 1e-300  # area of a triangle that has no normal, at unit size


class Texture(NamedTuple):
    """Coordinates (t, 2) that each face names for its corners: several at a point on a seam."""

    coordinates: Floats
    named: Ints  # (f, 3)
    faces: Ints  # (f, 3), the points of the corners

    def islands(self) -> Ints:
        """Return which connected piece of the texture each of the coordinates is of, (t,)."""
        i, j = self.named.ravel(), np.roll(self.named, -1, axis=1).ravel()
        size = len(self.coordinates)
        joined = sparse.coo_array((np.ones(len(i), bool), (i, j)), shape=(size, size))
        return np.asarray(connected_components(joined, directed=False)[1])

    def copies(self, n: int) -> tuple[Ints, Ints]:
        """Return the coordinates that points have, one after the other, and where each begins."""
        pairs = np.unique(np.column_stack([self.faces.ravel(), self.named.ravel()]), axis=0)
        return pairs[:, 1], np.searchsorted(pairs[:, 0], np.arange(n + 1))


def textured(
    texture: Texture,
    places: sparse.csr_array,
    triangles: Ints,
    middle: Ints,
    corners: Floats,
    images: Floats,
) -> Floats:
    """Return texture coordinates (f2, 3, 2) of triangles, each on one side of all seams.

    `places` are those of their corners, `middle` (f2,) is the face that holds the middle of each;
    `corners` (f1, 3, d) and `images` (f2, 3, d) are of the faces and of the triangles.
    """
    own, islands = texture.coordinates[texture.named], texture.islands()
    centre, island = own.mean(axis=1), islands[texture.named[:, 0]]
    covers, unit, size = (
        np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2).max(axis=1)
        for x in (own[middle], corners[middle], images)
    )
    reach = _SPREAD * covers * np.maximum(1.0, size / np.where(unit > 0, unit, 1.0))
    # Of the coordinates at each point of a place, those of the middle's piece that are nearest.
    entries = sparse.coo_array(places[triangles.ravel()])
    (corner, point), face = entries.coords, middle[entries.coords[0] // 3]
    known, first = texture.copies(places.shape[1])
    best, least = np.zeros(len(point), dtype=np.int64), np.full(len(point), np.inf)
    for k in range(int(np.diff(first).max(initial=0))):
        here = np.flatnonzero(first[point] + k < first[point + 1])
        copy = known[first[point[here]] + k]
        away = np.linalg.norm(texture.coordinates[copy] - centre[face[here]], axis=1)
        away[islands[copy] != island[face[here]]] = np.inf
        nearer = away < least[here]
        best[here[nearer]], least[here[nearer]] = copy[nearer], away[nearer]
    shares = entries.data[:, None] * texture.coordinates[best]
    result = sums(corner, shares, triangles.size).reshape(-1, 3, 2)
    across = np.zeros(triangles.size, bool)
    across[corner[least > reach[corner // 3]]] = True
    across = across.reshape(-1, 3) & (middle >= 0)[:, None]
    tree = cKDTree(centre)
    for f in np.flatnonzero(across.any(axis=1)):  # as a rule few, along seams
        near = np.array(tree.query_ball_point(centre[middle[f]], reach[f]), dtype=np.int64)
        near = np.append(near[island[near] == island[middle[f]]], middle[f])
        for c in np.flatnonzero(across[f]):
            rows = np.broadcast_to(images[f, c], (len(near), images.shape[2]))
            weights, apart = nearest_on_triangles(rows, corners[near])
            nearest = int(np.argmin(apart))
            result[f, c] = weights[nearest] @ own[near[nearest]]
    return result


def deformed(
    source: TriangleMesh, moved: Floats, target: TriangleMesh, face: Ints, turn: Floats
) -> Floats:
    """Return the points of a target deformed as a source is, of mean zero on each component.

    Each target face turns and stretches as the source's `face` (f2,), -1 for none, and the points
    follow by least squares (Sumner and Popovic, *Deformation transfer for triangle meshes*, ACM
    Transactions on Graphics 23 (3), 2004). `turn` (3, 3) takes directions of the target to those of
    the source.
    """
    unit, flat = box_unit(source.points), source.degenerate_faces()
    before, after = (_frames(points[source.faces] / unit) for points in (source.points, moved))
    before[flat] = after[flat] = np.eye(3)  # what has no area has no directions
    gradients = after @ np.linalg.inv(before)
    gradients = np.where((face < 0)[:, None, None], np.eye(3), turn.T @ gradients[face] @ turn)
    size = box_unit(target.points)
    points, faces = target.points / size, np.array(target.faces)
    # Each side pulls by its cotangent; that of `cotmatrix_entries` is half of it, of the side
    # opposite to each corner.
    weights = igl.cotmatrix_entries(points, faces)
    rhs = np.zeros((target.n, 3))
    for corner in range(3):
        i, j = faces[:, (corner + 1) % 3], faces[:, (corner + 2) % 3]
        pull = weights[:, [corner]] * np.einsum("fab,fb->fa", gradients, points[i] - points[j])
        rhs += sums(i, pull, target.n) - sums(j, pull, target.n)
    return size * cotan_laplacian(target).solve(rhs)


def _frames(corners: Floats) -> Floats:
    """Return two sides and the normal, as long as the root of the area, as columns (f, 3, 3)."""
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(one, two)
    size = np.sqrt(np.linalg.norm(normal, axis=1, keepdims=True))
    return np.stack([one, two, normal / np.maximum(size, _FLAT)], axis=2)
