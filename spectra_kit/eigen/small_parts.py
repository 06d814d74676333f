"""Components of few points, all of one size together: a call costs more than such a problem."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy import sparse

from spectra_kit._core.threads import single_threaded_blas
from spectra_kit._core.types import Floats, Ints
from spectra_kit.operators.laplacian import Laplacian

_SMALL = 192  # points: beyond, LAPACK on all of them costs more than a call each
_TOGETHER = 2**22  # numbers of their matrices at once
_QUICK = 2**18  # the same, whose modes are all found before it would be known which are wanted


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


def are_quick(parts: list[Ints]) -> bool:
    """Whether the small ones of some components take little time, all modes of all of them."""
    return sum(len(part) ** 2 for part in parts if len(part) <= _SMALL) <= _QUICK


def small_components(
    laplacian: Laplacian, parts: list[Ints], most: int = _SMALL
) -> Iterator[Alike]:
    """Yield those of the `parts`, which are components, that have few points: at most so many.

    `parts` may be some of them, the points of each ascending. By their sizes, ascending.
    """
    labels, root = laplacian.component_labels, np.sqrt(laplacian.mass)
    every = np.array([len(part) for part in parts], dtype=np.int64)
    some = np.flatnonzero(every <= min(most, _SMALL))
    some = some[np.argsort(every[some], kind="stable")]
    place = np.empty(laplacian.n, dtype=np.int64)
    begun = (np.cumsum(every[some] ** 2) - 1) // _TOGETHER
    for rows in np.split(some, np.flatnonzero(np.diff(begun)) + 1) if len(some) else ():
        sizes = every[rows]
        points = np.concatenate([parts[i] for i in rows])
        own = np.repeat(np.arange(len(rows)), sizes)  # of each point
        starts = np.cumsum(sizes) - sizes
        place[points] = np.arange(len(points)) - starts[own]
        entries = sparse.coo_array(laplacian.stiffness[points])
        inside = labels[entries.col] == labels[points[entries.row]]
        row, column, data = entries.row[inside], entries.col[inside], entries.data[inside]
        ends, point = np.cumsum(sizes**2), points[row]
        numbers = np.zeros(ends[-1])
        at = (ends - sizes**2)[own[row]] + place[point] * sizes[own[row]] + place[column]
        numbers[at] = data / root[point] / root[column]
        for size in np.unique(sizes):
            which = np.flatnonzero(sizes == size)
            first = which[0]
            matrices = numbers[ends[first] - size**2 : ends[which[-1]]].reshape(-1, size, size)
            these = points[starts[first] : starts[first] + size * len(which)].reshape(-1, size)
            yield Alike(labels[these[:, 0]], these, matrices)
