"""Vectors: their sums, their directions, and axes of the planes that these are normal to."""

from __future__ import annotations

import numpy as np

from spectra_kit._core.types import Floats, Ints


def sums(index: Ints, vectors: Floats, n: int) -> Floats:
    """Return the sums (n, d) of vectors (m, d) by an index (m,) of each."""
    found = [np.bincount(index, column, n) for column in vectors.T]
    return np.column_stack(found).astype(np.float64, copy=False)


def unit_vectors(vectors: Floats) -> Floats:
    """Return vectors (…, d) of length 1; zero where they are."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(lengths > 0, lengths, 1.0))


def frames_of(normals: Floats) -> Floats:
    """Return two axes and the normal (…, 3, 3), right-handed, of unit normals (…, 3).

    Duff et al., *Building an Orthonormal Basis, Revisited*, JCGT 6, 2017.
    """
    x, y, z = np.moveaxis(normals, -1, 0)
    side = np.copysign(1.0, z)
    a = -1 / (side + z)
    first = np.stack([1 + side * x * x * a, side * x * y * a, -side * x], axis=-1)
    second = np.stack([x * y * a, side + y * y * a, -y], axis=-1)
    return np.stack([first, second, normals], axis=-2)
