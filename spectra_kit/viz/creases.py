"""Creases of a mesh: there it is lit as two surfaces that meet, elsewhere as one that bends."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

Floats = NDArray[np.float64]
Ints = NDArray[np.integer]

_BENT, _SHARP = (
    40.0,
    75.0,
)  # degrees; no edge that bends less is a crease, every one that bends more
_ALONE = 3.0  # between these: one that bends so many times more than the surface beside it


def split_along_creases(points: Floats, faces: Ints) -> tuple[Ints, Ints]:
    """Double the vertices along creases.

    Beside a crease a surface is flatter than across it. Where a smooth surface has few triangles,
    as in a tight saddle, neighbouring edges bend alike, and none of them is a crease.

    Parameters
    ----------
    points : ndarray of shape (n, 3)
        Vertices.
    faces : ndarray of shape (f, 3)
        Triangles.

    Returns
    -------
    owner : ndarray of shape (v,)
        Which vertex each of the new ones was.
    faces : ndarray of shape (f, 3)
        The triangles, of the new vertices.
    """
    n, vertex = len(points), faces.ravel()  # of each corner
    starts = np.arange(faces.size)  # a side leads from its corner to the next one of its face
    ends = np.roll(starts.reshape(-1, 3), -1, axis=1).ravel()
    low, high = np.sort([vertex[starts], vertex[ends]], axis=0).astype(np.int64)
    order = np.argsort(low * n + high, kind="stable")
    same = np.diff((low * n + high)[order]) == 0
    a, b = order[:-1][same], order[1:][same]  # two sides on one edge
    crease = _are_creases(points[faces], a, b)
    if not crease.any():
        return np.arange(n), faces
    split = np.zeros(n, dtype=bool)
    split[low[a[crease]]] = split[high[a[crease]]] = True
    joined = ~crease & (split[low[a]] | split[high[a]])
    a, b = a[joined], b[joined]
    along = vertex[starts[a]] == vertex[starts[b]]
    i = np.concatenate([starts[a], ends[a]])
    j = np.concatenate([np.where(along, starts[b], ends[b]), np.where(along, ends[b], starts[b])])
    graph = sparse.coo_array((np.ones(len(i)), (i, j)), shape=(len(vertex), len(vertex)))
    _, fan = connected_components(graph, directed=False)
    _, corner, new = np.unique(
        np.where(split[vertex], n + fan, vertex), return_index=True, return_inverse=True
    )
    return vertex[corner], new.reshape(-1, 3)


def _are_creases(corners: Floats, a: Ints, b: Ints) -> NDArray[np.bool_]:
    """Whether the surface has a crease between the sides `a` and `b` of its faces (f, 3, 3)."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals /= np.where(lengths > 0, lengths, 1.0)
    cosine = np.einsum("ei,ei->e", normals[a // 3], normals[b // 3])
    flat = (lengths[a // 3] * lengths[b // 3])[:, 0] == 0  # a face without an area has no side
    bend = np.where(flat, 0.0, np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
    of_side = np.zeros(3 * len(corners))
    of_side[a] = of_side[b] = bend
    others = of_side.reshape(-1, 3)
    least = np.minimum(np.roll(others, 1, axis=1), np.roll(others, -1, axis=1)).ravel()
    beside = np.maximum(least[a], least[b])
    return (bend > _SHARP) | ((bend > _BENT) & (bend > _ALONE * beside))
