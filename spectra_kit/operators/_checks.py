"""What an operator refuses, said once for all of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spectra_kit._validate import check_count, quantity
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import PointCloud, TriangleMesh


def check_geometry(geometry: object) -> None:
    if not isinstance(geometry, TriangleMesh | PointCloud):
        raise InvalidInputError(
            f"`geometry` must be a TriangleMesh or PointCloud, got {type(geometry).__name__};"
            " wrap bare arrays in one of them"
        )


def check_faces_usable(mesh: TriangleMesh) -> None:
    """Refuse what no operator can give a mass: lone vertices and faces that are no triangles."""
    used = np.zeros(mesh.n, dtype=bool)
    used[mesh.faces] = True
    if not used.all():
        raise InvalidInputError(
            f"`mesh` has {quantity((~used).sum(), 'vertex')} that no face uses (the first is"
            f" {int(np.argmin(used))}), so they have no area;"
            " drop them with `mesh.without_unreferenced()`"
        )
    repeated = (mesh.faces == np.roll(mesh.faces, 1, axis=1)).any(axis=1)
    if repeated.any():
        raise InvalidInputError(
            f"`mesh` has {quantity(repeated.sum(), 'face')} with a vertex twice (the first is"
            f" {int(np.argmax(repeated))}); drop them with `mesh.without_degenerate_faces()`"
        )


def check_cloud_usable(cloud: PointCloud, n_neighbors: int) -> int:
    """Refuse clouds on which no local triangulation exists; return the neighbour count to use."""
    check_count("n_neighbors", n_neighbors, low=3)
    if cloud.n < 4:
        raise InvalidInputError(
            f"`geometry` must have at least 4 points for a cloud Laplacian, got {cloud.n}"
        )
    check_distinct(cloud.points)
    spread = np.linalg.svd(cloud.points - cloud.points.mean(axis=0), compute_uv=False)
    if spread[1] <= 1e-9 * spread[0]:
        raise InvalidInputError(
            "`geometry` must be a surface, got points on one line"
            f" (second to first extent {spread[1]:.1e} : {spread[0]:.1e})"
        )
    return min(n_neighbors, cloud.n - 1)


def check_distinct(points: NDArray[np.float64]) -> None:
    """Refuse exactly coincident points: they have no area of their own."""
    order = np.lexsort(points.T)
    same = (np.diff(points[order], axis=0) == 0).all(axis=1)
    if same.any():
        first, second = sorted(int(i) for i in order[np.argmax(same) :][:2])
        raise InvalidInputError(
            f"`geometry` has {quantity(same.sum(), 'duplicate point')} (such as {first} and"
            f" {second}); drop them with `cloud.without_duplicates()`, or join the corners of a"
            " mesh with `mesh.with_merged_vertices()`"
        )
