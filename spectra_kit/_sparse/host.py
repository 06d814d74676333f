"""What is done to tall blocks of columns on the host, by NumPy and loops of our own, in threads.

`device` has the same functions for torch; `blocks.operations` says which are meant.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from spectra_kit._core.threads import (
    WORTH_SHARING,
    in_threads,
    ranges,
    shares,
    single_threaded_blas,
)
from spectra_kit._core.types import Floats, Singles
from spectra_kit._sparse.products import residuals, rows_of, spmm

Block = NDArray[np.floating]
Weights = Any  # the diagonal of M as an array, or M itself as a sparse one

_ROWS = 4_096  # of one task: in the cache, and fixed, so that no sum depends on the threads
_COLUMNS = 64  # of L @ Y at once, where a double copy of all of Y would be large


def product(matrix: sparse.csr_array, Y: Block) -> Floats:
    """Return ``matrix @ Y`` in float64."""
    return np.asarray(spmm(matrix, Y, dtype=np.float64))


def gram(mass: Weights, Y: Block) -> Floats:
    """Return ``Y^T M Y``, symmetric, in float64."""
    if isinstance(mass, sparse.csr_array):
        return projected(mass, Y)

    total = np.zeros((Y.shape[1], Y.shape[1]))

    def part(rows: slice) -> tuple[Any, Floats]:
        block: Block = Y[rows]
        place: Any = np.s_[:, :]
        if not block[0].all():  # modes of other components are zero here
            here = np.flatnonzero(block.any(axis=0))
            block, place = block[:, here], np.ix_(here, here)
        weighted = np.sqrt(mass[rows, None]) * block
        return place, np.asarray(weighted.T @ weighted)

    for place, inside in _parts(part, len(Y)):
        total[place] += inside
    return total


def projected(matrix: sparse.csr_array, Y: Block) -> Floats:
    """Return ``Y^T L Y``, symmetric, in float64."""
    if Y.dtype == np.float64 or Y.size <= WORTH_SHARING:
        Y = np.ascontiguousarray(Y, dtype=float)  # not by SciPy, for each block of rows
        inside = _sum_of(lambda rows: Y[rows].T @ (matrix[rows] @ Y), len(Y))
        return (inside + inside.T) / 2
    parts = []
    for first, last in ranges(Y.shape[1], _COLUMNS):
        parts.append(inner(Y, product(matrix, Y[:, first:last])))
    inside = np.hstack(parts)
    return (inside + inside.T) / 2


def inner(Y: Block, Z: Floats) -> Floats:
    """Return ``Y^T Z``, summed in float64."""
    return _sum_of(lambda rows: Y[rows].T.astype(float, copy=False) @ Z[rows], len(Y))


def lifted(Y: Block, rotation: Floats) -> Floats:
    """Return ``Y @ rotation`` in float64."""
    U = np.empty((len(Y), rotation.shape[1]))

    def fill(rows: slice) -> None:
        np.matmul(Y[rows].astype(float, copy=False), rotation, out=U[rows])

    with single_threaded_blas():
        in_threads(fill, ((slice(*rows),) for rows in ranges(len(Y), _ROWS)))
    return U


def less(Y: Block, row: Floats) -> Floats:
    """Return Y with `row` taken off each of its rows, in float64."""
    U = np.empty(Y.shape)

    def fill(rows: slice) -> None:
        np.subtract(Y[rows], row, out=U[rows])

    in_threads(fill, ((slice(*rows),) for rows in ranges(len(Y), _ROWS)))
    return U


def energies(diagonal: Floats, Y: Block) -> Floats:
    """Return the diagonal of ``Y^T D Y``."""
    return _sum_of(lambda rows: diagonal[rows] @ np.square(Y[rows]), len(Y))


def dots(Y: Block, Z: Block) -> Floats:
    """Return the diagonal of ``Y^T Z``, in float64."""
    return np.asarray(np.einsum("ij,ij->j", Y, Z, dtype=float))


def joined(Y: Block, Z: Block) -> Block:
    """Return the columns of both."""
    return np.hstack([Y, Z])


def scaled(Y: Block, columns: NDArray[np.bool_], scale: Floats) -> Floats:
    """Return some of the columns, divided by their scale, in float64."""
    return np.asarray(Y[:, columns] / scale[columns])


def residual(
    stiffness: sparse.csr_array, mass: Weights, values: Floats, Y: Block
) -> NDArray[np.floating]:
    """Return ``L Y - M Y diag(values)``, summed in float64."""
    if isinstance(mass, sparse.csr_array):
        return product(stiffness, Y) - product(mass, Y) * values
    return residuals(stiffness, mass, values, np.asarray(Y, dtype=float))[0]


class Smoother(NamedTuple):
    """L and M of a level in float32, as `correction` wants them."""

    stiffness: sparse.csr_array
    mass: sparse.csr_array
    inverse: Singles  # of the diagonal of L


def smoother(stiffness: sparse.csr_array, mass: Weights, diagonal: Floats) -> Smoother:
    """Return what smoothing needs of a level, prepared once."""
    M = mass if isinstance(mass, sparse.csr_array) else sparse.csr_array(sparse.diags_array(mass))
    stiffness32, mass32 = (sparse.csr_array(matrix, dtype=np.float32) for matrix in (stiffness, M))
    return Smoother(stiffness32, mass32, (1 / diagonal).astype(np.float32))


def correction(
    level: Smoother, residual: Block, values: Floats, steps: Sequence[tuple[Floats, Floats]]
) -> Singles:
    """Return c after Chebyshev steps of ``(L - lambda M) c = -residual``, from c = 0, in float32.

    Of each column, a step is (keep, step): see the kernel.
    """
    from spectra_kit._sparse._kernels import smoothing_step

    graph = (*rows_of(level.stiffness, np.float32), *rows_of(level.mass, np.float32))
    residual = np.ascontiguousarray(residual, dtype=np.float32)
    fixed = (*graph, level.inverse, values.astype(np.float32), residual)
    old, new = (np.zeros(residual.shape, np.float32) for _ in range(2))
    for keep, step in steps:
        state = (old, new, keep.astype(np.float32), step.astype(np.float32))
        in_threads(smoothing_step, ((*fixed, *state, *rows) for rows in shares(len(residual))))
        old, new = new, old
    # Of a mode far above the frequencies that are damped, steps may grow until they overflow.
    old[:, ~np.isfinite(old).all(axis=0)] = 0.0
    return old


def _sum_of(part: Callable[[slice], Floats], n: int) -> Floats:
    """Return the sum of `part` over blocks of n rows, the same bits on any number of threads."""
    first, *others = _parts(part, n)
    total: Floats = first.copy()
    for other in others:
        total += other
    return total


def _parts(part: Callable[[slice], Any], n: int) -> list[Any]:
    with single_threaded_blas():
        return in_threads(part, ((slice(*rows),) for rows in ranges(n, _ROWS)))
