"""`LinearSolution`: what every solver of a linear system returns."""

from __future__ import annotations

from dataclasses import dataclass

from spectra_kit._core.types import Floats


@dataclass(frozen=True, eq=False, repr=False)
class LinearSolution:
    """A solution of ``A x = b``, with the way to it.

    `residual_norms` are ``||b - A x||`` of the start and after each iteration, in the 2-norm. The
    last one is computed from its definition, those before it may come from a recurrence. `rhs_norm`
    is ``||b||``, and `times` are seconds from the start of the solve to when each residual was
    known. `setup_seconds` went into the factor or the preconditioner, before any right-hand side
    was known; `seconds` are without them.

    >>> import numpy as np
    >>> from scipy import sparse
    >>> from spectra_kit._sparse import pcg
    >>> pcg(sparse.eye_array(3, format="csr"), np.array([1.0, 2.0, 2.0]))
    LinearSolution(n=3, method='CG', iterations=1, relative_residual=0.0e+00, converged=True)
    """

    x: Floats
    residual_norms: Floats
    rhs_norm: float
    converged: bool
    method: str
    setup_seconds: float
    seconds: float
    times: Floats

    def __repr__(self) -> str:
        return (
            f"LinearSolution(n={len(self.x)}, method={self.method!r},"
            f" iterations={self.iterations}, relative_residual={self.relative_residual:.1e},"
            f" converged={self.converged})"
        )

    @property
    def iterations(self) -> int:
        """Number of iterations; 0 for a direct solver."""
        return len(self.residual_norms) - 1

    @property
    def relative_residual(self) -> float:
        """``||b - A x|| / ||b||``; 0 where both are."""
        last = float(self.residual_norms[-1])
        if self.rhs_norm > 0:
            return last / self.rhs_norm
        return 0.0 if last == 0 else float("inf")
