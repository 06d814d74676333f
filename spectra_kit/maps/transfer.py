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
from spectra_kit.geometry.vectors import sums
from spectra_kit.maps.convert import nearest_on_triangles
from spectra_kit.operators import cotan_laplacian

_SPREAD = 3.0  # times what a triangle covers of a texture: what is farther is another part of it
_FLAT = 1e-300  # area of a triangle that has no normal, at unit size


class Texture(NamedTuple):
    """Coordinates (t, 2) that faces (f, 3) name for their corners, once for each side of a seam."""

    coordinates: Floats
    faces: Ints

    def islands(self) -> Ints:
        """Return which connected piece of the texture each face lies on, (f,)."""
        i, j = self.faces.ravel(), np.roll(self.faces, -1, axis=1).ravel()
        size = len(self.coordinates)
        joined = sparse.coo_array((np.ones(len(i), bool), (i, j)), shape=(size, size))
        return np.asarray(connected_components(joined, directed=False)[1][self.faces[:, 0]])


def textured(
    texture: Texture, corners: Floats, images: Floats, middle: Ints, found: Floats
) -> Floats:
    """Return texture coordinates (f2, 3, 2) of faces, whose corners all lie on one side of a seam.

    `corners` (f1, 3, d) are those of the faces with the texture, `images` (f2, 3, d) those of the
    others on it, `middle` (f2,) the face that holds the middle of each, and `found` (f2, 3, 2)
    coordinates that may be of the other side of a seam.
    """
    own = texture.coordinates[texture.faces]
    covers, unit, size = (
        np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2).max(axis=1)
        for x in (own[middle], corners[middle], images)
    )
    reach = _SPREAD * covers * np.maximum(1.0, size / np.where(unit > 0, unit, 1.0))
    centre, island = own.mean(axis=1), texture.islands()
    across = np.linalg.norm(found - centre[middle][:, None], axis=2) > reach[:, None]
    tree, result = cKDTree(centre), found.copy()
    for f in np.flatnonzero(across.any(axis=1)):  # as a rule few, along seams
        near = np.array(tree.query_ball_point(centre[middle[f]], reach[f]), dtype=np.int64)
        near = near[island[near] == island[middle[f]]]
        for c in np.flatnonzero(across[f]):
            rows = np.broadcast_to(images[f, c], (len(near), images.shape[2]))
            weights, apart = nearest_on_triangles(rows, corners[near])
            best = int(np.argmin(apart))
            result[f, c] = weights[best] @ own[near[best]]
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
    before, after = (_frames(points[source.faces]) for points in (source.points, moved))
    gradients = after @ np.linalg.inv(before)
    gradients = np.where((face < 0)[:, None, None], np.eye(3), turn.T @ gradients[face] @ turn)
    points, faces = target.points, target.faces
    # Each side pulls by its cotangent; that of `cotmatrix_entries` is half of it, of the side
    # opposite to each corner.
    weights = igl.cotmatrix_entries(points, faces)
    rhs = np.zeros((target.n, 3))
    for corner in range(3):
        i, j = faces[:, (corner + 1) % 3], faces[:, (corner + 2) % 3]
        pull = weights[:, [corner]] * np.einsum("fab,fb->fa", gradients, points[i] - points[j])
        rhs += sums(i, pull, target.n) - sums(j, pull, target.n)
    return cotan_laplacian(target).solve(rhs)


def _frames(corners: Floats) -> Floats:
    """Return two sides and the normal, as long as the root of the area, as columns (f, 3, 3)."""
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(one, two)
    size = np.sqrt(np.linalg.norm(normal, axis=1, keepdims=True))
    return np.stack([one, two, normal / np.maximum(size, _FLAT)], axis=2)
