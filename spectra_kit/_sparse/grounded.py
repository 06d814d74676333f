"""Direct solution of a singular system: one point of each component held at zero."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from spectra_kit._core.clock import Clock
from spectra_kit._core.types import Floats
from spectra_kit._sparse._checks import check_kernel, check_matrix, check_rhs
from spectra_kit._sparse.constant_kernel import ConstantKernel
from spectra_kit._sparse.elimination import Elimination
from spectra_kit._sparse.ldl import SparseLDL
from spectra_kit._sparse.solution import LinearSolution
from spectra_kit.errors import InvalidInputError

_ACCURATE = 1e-7  # relative residual up to which a direct solution is one


class GroundedCholesky:
    """A Cholesky factor of a Laplacian with constant kernel, for any number of right-hand sides.

    Both triangles of the `matrix` are stored.

    The solution is determined up to a constant on each component of the kernel. The factor fixes
    that by clearing the row and column of one of its points off the diagonal, where the value is
    then zero: as a right-hand side in the range sums to zero, the equation that was dropped holds
    too. Each constant is moved to mean zero afterwards.
    """

    def __init__(
        self,
        matrix: sparse.csr_array,
        kernel: ConstantKernel,
        *,
        elimination: Elimination | None = None,
    ) -> None:
        clock = Clock()
        self._matrix = check_matrix(matrix)
        check_kernel(kernel, self._matrix)
        self._kernel = kernel
        self.n: int = self._matrix.shape[0]
        self._held = np.zeros(self.n, dtype=bool)
        self._held[np.unique(kernel.labels, return_index=True)[1]] = True
        held = held_at_zero(self._matrix, self._held)
        self._factor = SparseLDL(held, elimination=elimination)
        self.seconds = clock.total

    def solutions(self, sides: Sequence[ArrayLike]) -> list[LinearSolution]:
        """Solve for several right-hand sides at once, which takes less time than one by one.

        Each, (n,), is in the range of the matrix. Solutions have mean zero on each component, no
        iterations and one residual; bit by bit what they would be alone, but for the seconds: what
        they took together is shared out evenly.
        """
        clock = Clock()
        checked = [check_rhs(rhs, self.n, self._kernel) for rhs in sides]
        freed = np.column_stack([np.where(self._held, 0.0, b) for b in checked])
        solved = np.ascontiguousarray(self._factor.solve(freed).T)
        found = [self._accurate(b, x) for b, x in zip(checked, solved, strict=True)]
        seconds = clock.total / len(sides)
        return [replace(one, seconds=seconds, times=np.array([seconds])) for one in found]

    def _accurate(self, b: Floats, x: Floats) -> LinearSolution:
        """Return what the factor made of `b`, if it is a solution; of no time."""
        x = self._kernel.remove(x)
        residual, norm = _norm(b - self._matrix @ x), _norm(b)
        if not residual <= _ACCURATE * norm:
            raise InvalidInputError(
                "`matrix` must be nonsingular apart from `kernel`, but its direct solution leaves"
                f" a residual of {residual / norm:.1e} ||rhs||. The Laplacian of triangles that are"
                " all but flat is that near to singular: for distances, pass"
                " intrinsic_delaunay(mesh, mollify_factor=1e-3) in place of the mesh"
            )
        return LinearSolution(
            x=x,
            residual_norms=np.array([residual]),
            rhs_norm=norm,
            converged=True,
            method="Cholesky",
            setup_seconds=self.seconds,
            seconds=0.0,
            times=np.zeros(1),
        )


def held_at_zero(matrix: sparse.csr_array, held: NDArray[np.bool_]) -> sparse.csr_array:
    """Return `matrix` with rows and columns of points cleared but for a one on the diagonal.

    In the same pattern, if all diagonal entries are stored.
    """
    rows = np.repeat(np.arange(matrix.shape[0], dtype=np.int32), np.diff(matrix.indptr))
    entries = np.where(held[rows] | held[matrix.indices], 0.0, matrix.data)
    own = np.flatnonzero(rows == matrix.indices)
    entries[own[held[rows[own]]]] = 1.0
    cleared = sparse.csr_array((entries, matrix.indices, matrix.indptr), matrix.shape)
    missing = held.copy()
    missing[rows[own]] = False
    return (
        sparse.csr_array(cleared + sparse.diags_array(1.0 * missing)) if missing.any() else cleared
    )


def _norm(values: Floats) -> float:
    """Return the 2-norm, without BLAS: its threads would take longer to meet than to add."""
    return float(np.sqrt(np.square(values).sum()))
