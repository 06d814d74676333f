"""Preconditioned conjugate gradients for symmetric positive semi-definite systems."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from spectra_kit._core.clock import Clock
from spectra_kit._core.threads import in_threads, ranges, single_threaded_blas, team
from spectra_kit._core.types import Floats
from spectra_kit._sparse._checks import (
    asymmetry,
    check_kernel,
    check_matrix,
    check_rhs,
    check_vector,
)
from spectra_kit._sparse.coarse_space import ROWS, Preconditioner
from spectra_kit._sparse.constant_kernel import ConstantKernel
from spectra_kit._sparse.solution import LinearSolution
from spectra_kit.errors import ConvergenceError, InvalidInputError

_MOST_ITERATIONS = 10_000
_PROGRESS = 0.5  # factor by which a restart must have reduced the true residual
_ROUNDING = 1e-13  # share of its largest possible value below which a quadratic form is zero


def pcg(
    matrix: sparse.csr_array,
    rhs: ArrayLike,
    *,
    preconditioner: Preconditioner | None = None,
    start: ArrayLike | None = None,
    kernel: ConstantKernel | None = None,
    rtol: float = 1e-8,
    max_iterations: int | None = None,
) -> LinearSolution:
    """Solve ``A x = b`` by conjugate gradients, until ``||b - A x|| <= rtol ||b||``.

    A, of shape (n, n), is symmetric positive semi-definite, and b (n,) in its range. Symmetry is
    taken on trust, and looked at where the tolerance is not reached; the residual at the end is
    not: the last one is computed from x. The tolerance does not depend on the `start`. Iterations
    are at most 10 n and 10,000 by default; what is short of the tolerance comes with the error.

    Where A has a `kernel`, x has mean zero on each of its components, and no iterate grows in its
    direction. Algorithm 1 of the NEO paper is this with `IncompleteCholesky`; its Algorithm 2 with
    `AdditiveTwoLevel` and ``start=coarse.solve(rhs)``. They differ from the paper in their
    treatment of the kernel: no point is held at zero, which would raise the condition number.

    Stored vectors are scaled by ``1 / ||b||``. The same bits whatever the number of threads.
    """
    clock = Clock()
    A = check_matrix(matrix)
    n = A.shape[0]
    kernel = check_kernel(kernel, A)
    b = check_rhs(rhs, n, kernel)
    limit = min(10 * n, _MOST_ITERATIONS) if max_iterations is None else max_iterations
    guess = np.zeros(n)
    if start is not None and b.any():
        given = check_vector("start", start, n)
        guess = given if kernel is None else kernel.remove(given)
    norm = float(np.linalg.norm(b))
    unit = norm or 1.0
    with team(), single_threaded_blas():
        system = _Iteration(A, b / unit, guess / unit, preconditioner, kernel, clock)
        target = rtol if norm else 0.0
        reason = system.run(target, limit)
    converged = system.norms[-1] <= target
    x = system.x * unit
    solution = LinearSolution(
        x=x if kernel is None else kernel.remove(x),
        residual_norms=np.array(system.norms) * unit,
        rhs_norm=norm,
        converged=converged,
        method="CG" if preconditioner is None else f"PCG with {preconditioner!r}",
        setup_seconds=float(getattr(preconditioner, "seconds", 0.0)),
        seconds=clock.total,
        times=np.array(system.times),
    )
    if not converged:
        if (skew := asymmetry(A)) > 0:
            reason = f"`matrix` is not symmetric, |A - A.T| is up to {skew:.2e}"
        raise ConvergenceError(
            f"conjugate gradients reached ||b - A x|| = {system.norms[-1]:.1e} ||b|| after"
            f" {solution.iterations} iterations, more than the {target:.1e} asked for: {reason};"
            " the last iterate is kept in `partial`",
            partial=solution,
        )
    return solution


class _Iteration:
    """The state of one solve, for ``||b|| = 1``."""

    def __init__(
        self,
        A: sparse.csr_array,
        b: Floats,
        x: Floats,
        preconditioner: Preconditioner | None,
        kernel: ConstantKernel | None,
        clock: Clock,
    ) -> None:
        from spectra_kit._sparse import _krylov_kernels

        self._kernels = _krylov_kernels
        # Unsigned: the compiled loop need not test for negative indices.
        index = np.uint32 if A.nnz < 2**32 else np.uint64
        self._rows = (A.indptr.astype(index), A.indices.astype(index), A.data)
        self._ranges = ranges(len(b), ROWS)
        self._A = A
        self._preconditioner, self._kernel, self._clock = preconditioner, kernel, clock
        self._drift = 0.0  # mean of r, to be taken from it
        self._weight = 0.0  # r . z of the last step; 0: the next forgets the directions before it
        self._b, self.x = b, x
        self._p, self._q = np.zeros_like(b), np.empty_like(b)
        self._r = self._residual() if x.any() else b.copy()
        correct = getattr(preconditioner, "correct", None)
        if correct is not None:
            self.x += correct(self._r)
            self._r = self._residual()
        self.norms: list[float] = []
        self.times: list[float] = []
        self._record(float(np.linalg.norm(self._r)))

    def run(self, target: float, limit: int) -> str:
        """Iterate until the true residual is at `target`; say why if it does not get there."""
        checked = np.inf
        while True:
            if self.norms[-1] <= target:
                self._refresh()
                if self.norms[-1] <= target:
                    return ""
                if self.norms[-1] > _PROGRESS * checked:
                    return "rounding does not allow for less"
                checked = self.norms[-1]
                self._weight = 0.0
            if len(self.norms) > limit:
                self._refresh()
                return "raise `max_iterations` or use a better preconditioner"
            if not self._step():
                self._refresh()
                return "rounding does not allow for less, or `rhs` is not in the range of `matrix`"

    def _step(self) -> bool:
        """Do one iteration; False if nothing but rounding is left to go by."""
        p, q, kernels = self._p, self._q, self._kernels
        r = self._r = self._without_parts(self._r)
        z = r
        if self._preconditioner is not None:
            z = check_vector("preconditioner.solve(...)", self._preconditioner.solve(r), len(r))
        z = self._without_parts(z)
        sums = self._on_ranges(kernels.weigh, r, z)
        before, self._weight = self._weight, sum(s[0] for s in sums)
        if not self._weight > 0:
            scale = float(np.linalg.norm(r) * np.linalg.norm(z))
            if abs(self._weight) > _ROUNDING * scale or (self._weight == 0 < scale):
                raise _indefinite("preconditioner", self._weight)
            return False
        ratio = self._weight / before if before else 0.0
        self._on_ranges(kernels.turn, p, z, self._mean(sums), ratio)
        energy = self._multiply(p, q)
        if not energy > 0:
            # A of no negative energy maps a direction of none to zero: |A p|^2 <= |A| p.A p.
            most = float(abs(self._A).sum(axis=1).max())
            rounding = _ROUNDING * most * float(p @ p)
            if energy < -rounding or float(q @ q) > 2 * most * rounding > 0:
                raise _indefinite("matrix", energy)
            return False
        # The mean of r is rounding, which would outlast everything else in r: the factor, nearly
        # singular, blows it up.
        step = self._weight / energy
        sums = self._on_ranges(kernels.advance, self.x, r, p, q, step, self._drift)
        self._drift = self._mean(sums)
        self._record(float(np.sqrt(sum(s[0] for s in sums))))
        return True

    def _without_parts(self, values: Floats) -> Floats:
        """Return `values` without the kernel, unless `_mean` takes care of that."""
        if self._kernel is None or self._kernel.whole:
            return values
        return self._kernel.remove(values)

    def _mean(self, sums: list[tuple[float, float]]) -> float:
        """Return the mean to take from values whose sums on the ranges come second in `sums`."""
        if self._kernel is None or not self._kernel.whole:
            return 0.0
        return sum(s[1] for s in sums) / len(self._b)

    def _on_ranges(self, task: Callable[..., Any], *arguments: Any) -> list[Any]:
        """Call `task` on one range after the other: a pass over a vector is not worth a thread."""
        return [task(*arguments, *rows) for rows in self._ranges]

    def _multiply(self, values: Floats, out: Floats) -> float:
        """Write ``A @ values`` to `out`, and return its product with `values`."""
        fixed = (*self._rows, values, out)
        shares = in_threads(self._kernels.multiply, ((*fixed, *rows) for rows in self._ranges))
        return float(sum(shares))

    def _residual(self) -> Floats:
        image = np.empty_like(self._b)
        self._multiply(self.x, image)
        residual = self._b - image
        return residual if self._kernel is None else self._kernel.remove(residual)

    def _refresh(self) -> None:
        """Replace the residual of the recurrence by the true one."""
        self._r, self._drift = self._residual(), 0.0
        self.norms[-1] = float(np.linalg.norm(self._r))

    def _record(self, norm: float) -> None:
        self.norms.append(norm)
        self.times.append(self._clock.total)


def _indefinite(name: str, energy: float) -> InvalidInputError:
    return InvalidInputError(
        f"`{name}` must be symmetric positive semi-definite, but conjugate gradients met a"
        f" direction of energy {energy:.3g} that it does not map to zero"
    )
