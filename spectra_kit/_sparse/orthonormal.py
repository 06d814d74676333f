"""Mass-orthonormal bases of the span of given columns, however badly conditioned these are."""

from __future__ import annotations

from typing import Any

import numpy as np

from spectra_kit._core.validate import quantity
from spectra_kit._sparse.blocks import operations
from spectra_kit.errors import InvalidInputError

_PASSES = 6  # three suffice down to rank_tol = 1e-14; more mean a bug or NaN
_SETTLED = 1e-13  # deviation of the Gram matrix from the identity that rounding alone leaves
_EPS = float(np.finfo(np.float64).eps)


class RankError(InvalidInputError):
    """Columns span fewer dimensions than are wanted: `rank` of them."""

    def __init__(self, message: str, rank: int) -> None:
        super().__init__(message)
        self.rank = rank


def orthonormalize(basis: Any, mass: Any, *, rank_tol: float = 1e-10) -> Any:
    """Return an M-orthonormal basis Y of the numerical range of `basis`, in float64.

    Columns of the `basis`, (n, m), may be dependent. The mass, in length^2, is lumped (n,) or a
    sparse matrix, of the kind of the basis: all are arrays, or all tensors. Directions whose
    singular value (of the columns scaled to unit M-norm) is below `rank_tol` times the largest are
    dropped. Small directions carry real accuracy: a cut at 3e-6 costs the refinement that follows a
    factor of ten.

    Repeated whitening by the eigenvectors of the Gram matrix (SVQB; Stathopoulos and Wu, *A block
    orthogonalization procedure with constant synchronization requirements*, 2002): the long
    side sees matrix products alone. One Gram matrix resolves singular values down to 1e-8 of the
    largest; smaller ones are raised by a bounded factor in one pass and resolved in the next, so
    the cut is meaningful down to about 1e-14.
    """
    ops = operations(basis)
    norms = np.sqrt(np.maximum(np.diag(ops.gram(mass, basis)), 0.0))
    if not np.isfinite(norms).all() or not (norms > 0).any():
        message = (
            "`basis` must have finite columns that are not all zero, got"
            f" {quantity((~np.isfinite(norms)).sum(), 'column')} with NaN or infinite values"
            f" of {len(norms)}; look at the subspace that returned it"
        )
        raise RankError(message, 0) if np.isfinite(norms).all() else InvalidInputError(message)
    q = ops.scaled(basis, norms > 0, norms)

    triangle = np.eye(q.shape[1])  # the scaled columns are q @ triangle, throughout
    for _ in range(_PASSES):
        values, vectors = np.linalg.eigh(ops.gram(mass, q))
        if values[-1] - 1 < _SETTLED and 1 - values[0] < _SETTLED:
            break
        # Eigenvalues below rounding carry no direction yet: raise them by a bounded factor only.
        scale = np.sqrt(np.maximum(values, values[-1] * len(values) * _EPS))
        triangle = scale[:, None] * (vectors.T @ triangle)
        left, singular, triangle_rows = np.linalg.svd(triangle, full_matrices=False)
        kept = singular > rank_tol * singular[0]
        triangle = singular[kept, None] * triangle_rows[kept]
        q = ops.lifted(q, (vectors / scale) @ left[:, kept])
    return q
