"""Preconditioned conjugate gradients for symmetric positive semi-definite systems."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from spectra_kit.errors import ConvergenceError, InvalidInputError
from spectra_kit.linalg._checks import check_kernel, check_matrix, check_rhs
from spectra_kit.linalg.coarse_space import Preconditioner
from spectra_kit.linalg.constant_kernel import ConstantKernel
from spectra_kit.linalg.solution import LinearSolution

Floats = NDArray[np.float64]


def pcg(
    matrix: sparse.csr_array,
    rhs: ArrayLike,
    *,
    preconditioner: Preconditioner | None = None,
    start: ArrayLike | None = None,
    kernel: ConstantKernel | None = None,
    rtol: float = 1e-8,
    atol: float = 0.0,
    max_iterations: int | None = None,
    progress: Callable[[int, float], None] | None = None,
    throw: bool = True,
) -> LinearSolution:
    """Solve ``A x = b`` by preconditioned conjugate gradients."""
    begin = time.perf_counter()
    A = check_matrix(matrix)
    kernel = check_kernel(kernel, A)
    n = A.shape[0]
    b = check_rhs(rhs, n, kernel)
    limit = 10 * n if max_iterations is None else max_iterations

    def project(v: Floats) -> Floats:
        return v if kernel is None else kernel.remove(v)

    x = np.zeros(n) if start is None else project(np.array(start, dtype=np.float64))
    norm = float(np.linalg.norm(b))
    target = max(rtol * norm, atol)
    r = b - A @ x if start is not None else b.copy()
    norms, times = [float(np.linalg.norm(r))], [time.perf_counter() - begin]
    p, rz = np.zeros(n), 1.0
    while norms[-1] > target and len(norms) <= limit:
        z = project(r.copy() if preconditioner is None else preconditioner.solve(r))
        rz, before = float(r @ z), rz
        p = z + (rz / before if len(norms) > 1 else 0.0) * p
        q = A @ p
        pq = float(p @ q)
        if not pq > 0:
            raise InvalidInputError("not positive semi-definite")
        x += rz / pq * p
        r -= rz / pq * q
        norms.append(float(np.linalg.norm(r)))
        times.append(time.perf_counter() - begin)
        if norms[-1] <= target:
            r = project(b - A @ x)
            norms[-1] = float(np.linalg.norm(r))
        if progress is not None:
            progress(len(norms) - 1, norms[-1] / norm)
    converged = norms[-1] <= target
    x = project(x)
    solution = LinearSolution(
        x=x,
        residual_norms=np.array(norms),
        rhs_norm=norm,
        converged=converged,
        method="PCG",
        setup_seconds=getattr(preconditioner, "seconds", 0.0),
        seconds=time.perf_counter() - begin,
        times=np.array(times),
    )
    if not converged and throw:
        raise ConvergenceError(f"after {limit} iterations", partial=solution)
    return solution
