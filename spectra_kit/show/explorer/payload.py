"""The binary part of the page: whole numbers that compress well, and how the page reads them.

Points are put in an order in which neighbours follow each other, so that a smooth function changes
little from one to the next. A column of 16-bit numbers is then stored as its steps, wrapped to 16
bits, with the sign in the lowest bit (0, -1, 1, -2, … become 0, 1, 2, 3, …), high bytes before low
bytes: most high bytes are zero. Everything together passes through gzip and base64.
"""

from __future__ import annotations

import base64
import gzip

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components, depth_first_order
from scipy.spatial import cKDTree

from spectra_kit._core.types import Floats, Ints
from spectra_kit.geometry.shapes import Geometry, TriangleMesh

LEVELS = 32767  # of the positive half of a signed 16-bit number
_NEIGHBOURS = 8  # of a point of a cloud, to walk along


def quantised(functions: Floats, scale: Floats) -> NDArray[np.int16]:
    """Round columns (n, k) to steps of ``scale / LEVELS``, `scale` (k,) the largest number."""
    unit = np.where(scale > 0, scale, 1.0)
    return np.round(functions * (LEVELS / unit)).astype(np.int16)


def walk(geometry: Geometry) -> Ints:
    """Return an order of the points in which neighbours mostly follow each other."""
    n = geometry.n
    if isinstance(geometry, TriangleMesh):
        i, j = geometry.unique_edges[0].T
    else:
        _, near = cKDTree(geometry.points).query(geometry.points, k=min(_NEIGHBOURS, n))
        near = near.reshape(n, -1)
        i, j = np.repeat(np.arange(n), near.shape[1]), near.ravel()
    graph = sparse.coo_array((np.ones(len(i)), (i, j)), shape=(n, n)).tocsr()
    # One more node ties the components together, so that one walk meets them all.
    _, label = connected_components(graph, directed=False)
    first = np.unique(label, return_index=True)[1]
    rows, columns = np.append(i, np.full(len(first), n)), np.append(j, first)
    tied = sparse.coo_array((np.ones(len(rows)), (rows, columns)), shape=(n + 1, n + 1)).tocsr()
    order, _ = depth_first_order(tied, n, directed=False, return_predecessors=True)
    return np.asarray(order[1:], dtype=np.int64)


def renumbered(faces: NDArray[np.integer], order: Ints) -> Ints:
    """Faces (f, 3) of the points in another order, sorted by where they start."""
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    rows = rank[faces]
    # Turned so that the smallest corner comes first: the orientation stays.
    start = rows.argmin(axis=1)
    rows = np.take_along_axis(rows, (start[:, None] + np.arange(3)) % 3, axis=1)
    return np.asarray(rows[np.lexsort(rows.T[::-1])])


def steps16(columns: NDArray[np.integer]) -> bytes:
    """Store columns (n, c) of 16-bit numbers, one after the other."""
    wide = columns.astype(np.int32)
    delta = np.diff(wide, axis=0, prepend=0).astype(np.int16).astype(np.int32)
    zigzag = ((delta << 1) ^ (delta >> 31)).astype(np.uint16).T
    planes = np.stack([zigzag >> 8, zigzag & 255], axis=1)  # (c, 2, n)
    return planes.astype(np.uint8).tobytes()


def steps32(numbers: Ints) -> bytes:
    """Store whole numbers below 2^31 likewise, in four planes of bytes."""
    delta = np.diff(numbers, prepend=0)
    zigzag = ((delta << 1) ^ (delta >> 63)).astype(np.uint32)
    planes = [(zigzag >> shift) & 255 for shift in (24, 16, 8, 0)]
    return np.stack(planes).astype(np.uint8).tobytes()


def face_bytes(faces: Ints) -> bytes:
    """Store sorted faces: the first corner by its steps, the others by how far they are from it."""
    first = faces[:, 0]
    return steps32(first) + steps32(faces[:, 1] - first) + steps32(faces[:, 2] - first)


def packed(*parts: bytes) -> str:
    """Compress, and write as text; equal input makes equal text."""
    return base64.b64encode(gzip.compress(b"".join(parts), 6, mtime=0)).decode("ascii")
