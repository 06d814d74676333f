"""The energy matrix of a coarse space, inverted where it can be."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from spectra_kit._core.types import Floats
from spectra_kit._sparse.products import spmm
from spectra_kit.errors import InvalidInputError

_DEPENDENT = 1e-10  # share of the largest eigenvalue of the Gram matrix below which columns depend
_KERNEL = 1e-12  # share of the largest diagonal entry of A below which an energy is zero


def check_basis(basis: ArrayLike, kind: np.dtype[np.floating]) -> NDArray[Any]:
    array = np.asarray(basis)
    if array.ndim != 2 or array.shape[1] == 0 or array.shape[0] < array.shape[1]:
        raise InvalidInputError(
            "basis", "have shape (n, k) with 1 <= k <= n", array.shape, advice="modes are columns"
        )
    stored = np.ascontiguousarray(array, dtype=kind)
    # A sum over all of it is finite unless an entry is not; and needs no mask of its size.
    if not np.isfinite(np.sum(stored, dtype=np.float64)):
        raise InvalidInputError("basis", "be finite", "NaN or infinite values")
    return stored


def inverse_energy(basis: NDArray[Any], matrix: sparse.csr_array) -> tuple[Floats, int]:
    """Return a generalised inverse of ``E = Y^T A Y`` of shape (k, k), and its rank.

    In a basis W that makes ``Y W`` orthonormal: neither the units of its columns nor how skew they
    are to each other decide what is dropped.
    """
    if matrix.shape[0] != len(basis):
        raise InvalidInputError(
            "matrix",
            f"have shape ({len(basis)}, {len(basis)}), as `basis` has {len(basis)} rows",
            matrix.shape,
        )
    wide = basis.astype(np.float64, copy=False)
    gram = wide.T @ wide
    scale = 1 / np.sqrt(np.maximum(np.diag(gram), np.finfo(np.float64).tiny))
    values, vectors = np.linalg.eigh(scale[:, None] * gram * scale)
    kept = values > _DEPENDENT * values[-1]
    W = scale[:, None] * vectors[:, kept] / np.sqrt(values[kept])
    inner = W.T @ (wide.T @ spmm(matrix, wide)) @ W
    energies, turned = np.linalg.eigh((inner + inner.T) / 2)
    kept = energies > _KERNEL * matrix.diagonal().max()
    if not kept.any():
        raise InvalidInputError(
            f"`basis` must not lie in the kernel of `matrix`, but all of its {len(values)} columns"
            " have no energy"
        )
    W = W @ turned[:, kept]
    return (W / energies[kept]) @ W.T, int(kept.sum())
