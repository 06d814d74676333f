"""Components of few points, all of one size together: a call costs more than such a problem."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy import sparse

from spectra_kit._core.threads import single_threaded_blas
from spectra_kit._core.types import Floats, Ints
from spectra_kit.operators.laplacian import Laplacian

_SMALL = 192  # points: beyond, LAPACK on all of them costs more than a call each
_TOGETHER = 2**22  # numbers of their matrices at once


class Alike(NamedTuple):
    """Some components of one size s, and their dense ``M^-1/2 L M^-1/2``."""

    which: Ints  #: (c,)
    points: Ints  #: Of each, (c, s).
    matrices: Floats  #: (c, s, s)

    @property
    def norms(self) -> Floats:
        """Bounds of their largest eigenvalues; (c,)."""
        return np.asarray(np.abs(self.matrices).sum(axis=2).max(axis=1))

    def eigenvalues(self) -> Floats:
        """Return all of them, ascending; (c, s)."""
        with single_threaded_blas():
            return np.asarray(np.linalg.eigvalsh(self.matrices))

    def eigenpairs(self, laplacian: Laplacian) -> tuple[Floats, Floats]:
        """Return all eigenvalues (c, s), and eigenvectors (c, s, s) in columns; writes over these.

        Where constants have no energy, the first is the constant, with eigenvalue 0: it is moved
        below all others, so that no rounding mixes them.
        """
        root = np.sqrt(laplacian.mass[self.points])
        area_root = np.linalg.norm(root, axis=1)
        constant = laplacian.constant_components[self.which]
        unit, matrices = root / area_root[:, None], self.matrices
        unit *= np.sqrt(self.norms)[:, None]
        matrices[constant] -= unit[constant, :, None] * unit[constant, None, :]
        with single_threaded_blas():
            values, vectors = np.linalg.eigh(matrices)
        vectors /= root[:, :, None]
        values[constant, 0], vectors[constant, :, 0] = 0.0, 1 / area_root[constant, None]
        return values, vectors


def small_components(
    laplacian: Laplacian, parts: list[Ints], most: int = _SMALL
) -> Iterator[Alike]:
    """Yield those of the `parts`, which are components, that have few points: at most so many.

    `parts` may be some of them, the points of each ascending.
    """
    labels, root = laplacian.component_labels, np.sqrt(laplacian.mass)
    sizes = np.array([len(part) for part in parts], dtype=np.int64)
    place = np.empty(laplacian.n, dtype=np.int64)
    for size in np.unique(sizes[sizes <= min(most, _SMALL)]):
        some = np.flatnonzero(sizes == size)
        for rows in np.array_split(some, math.ceil(len(some) * size**2 / _TOGETHER)):
            points = np.concatenate([parts[i] for i in rows])
            place[points] = np.arange(len(points))
            entries = sparse.coo_array(laplacian.stiffness[points])
            inside = labels[entries.col] == labels[points[entries.row]]
            row, column, data = entries.row[inside], entries.col[inside], entries.data[inside]
            matrices = np.zeros((len(rows), size, size))
            matrices[row // size, row % size, place[column] % size] = (
                data / root[points[row]] / root[column]
            )
            points = points.reshape(-1, size)
            yield Alike(labels[points[:, 0]], points, matrices)
