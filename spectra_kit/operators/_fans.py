"""Triangles of a point cloud, all turned the same way round.

Each point triangulates its own neighbourhood, a fan of triangles counter-clockwise in a tangent
frame of either hand. Where two fans contain the same triangle, its winding in both says whether
they agree: that needs no normals, and does not mind sharp edges.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from spectra_kit._core.types import Floats, Ints
from spectra_kit.geometry.shapes import PointCloud
from spectra_kit.geometry.signs import agree_on_signs, symmetric_votes, turn_outwards
from spectra_kit.operators.checks import check_cloud_usable, unit_of
from spectra_kit.operators.local_delaunay import local_triangles

_NORMALS_VOTE = 0.1  # of a shared triangle's vote: it joins fans that share none


def oriented_fans(cloud: PointCloud, n_neighbors: int) -> tuple[Ints, Floats, float]:
    """Return triangles of shape (f, 3), their areas, and the share whose corners agree."""
    n_neighbors = check_cloud_usable(cloud, n_neighbors)
    # Neighbours in space become neighbours in memory; any unit of length becomes about 1.
    order = cKDTree(cloud.points).indices
    unit = unit_of(cloud)
    points = cloud.points[order] / unit
    faces = local_triangles(points, n_neighbors)[0].astype(np.int64)
    owners = faces[:, 0]
    a, b, c = (points[faces[:, i]] for i in range(3))
    doubled: Floats = np.cross(b - a, c - a)
    vectors: Floats = np.zeros((cloud.n, 3))
    np.add.at(vectors, owners, doubled / 6)  # a third of the area of each triangle
    votes = _votes(faces, vectors, cloud.n)
    signs, labels = agree_on_signs(votes)
    signs = turn_outwards(points, vectors, signs, labels, votes)
    turned = signs[owners] < 0
    faces[turned] = faces[turned][:, [0, 2, 1]]
    sides = np.einsum("fr,fcr->fc", doubled, vectors[faces] * signs[faces][:, :, None])
    sides *= signs[owners][:, None]
    agree = float((sides > 0).all(axis=1).mean()) if len(faces) else 0.0
    return order[faces], 0.5 * unit**2 * np.linalg.norm(doubled, axis=1), agree


def _votes(faces: Ints, vectors: Floats, n: int) -> sparse.csr_array:
    """Count for each pair of points how often their fans wind a triangle alike, less unlike."""
    a, b, c = faces.T
    even = ((a < b) & (b < c)) | ((b < c) & (c < a)) | ((c < a) & (a < b))
    winding = np.where(even, 1.0, -1.0)
    corners = np.sort(faces, axis=1)
    order = np.lexsort(corners.T)
    corners, owners, winding = corners[order], a[order], winding[order]
    pairs, values = [], []
    for step in (1, 2):  # a triangle is in the fans of three points at most
        same = np.flatnonzero((corners[step:] == corners[:-step]).all(axis=1))
        pairs.append(np.column_stack([owners[same], owners[same + step]]))
        values.append(winding[same] * winding[same + step])
    sides = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    unit = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)
    pairs.append(sides)
    values.append(_NORMALS_VOTE * np.einsum("er,er->e", unit[sides[:, 0]], unit[sides[:, 1]]))
    i, j = np.concatenate(pairs).T
    return symmetric_votes(n, i, j, np.concatenate(values))
