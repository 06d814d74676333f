"""Locally optimal block preconditioned conjugate gradients."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from scipy import sparse

from spectra_kit._checked import checked
from spectra_kit._clock import Clock
from spectra_kit._optional import optional
from spectra_kit._types import Floats
from spectra_kit._validate import check_count, check_positive, quantity
from spectra_kit.eigensolvers.base import Eigenpairs, NotConvergedError, Promise
from spectra_kit.eigensolvers.dense import Dense
from spectra_kit.eigensolvers.starts import basis_with_kernel
from spectra_kit.linalg import SparseLDL, orthonormalize
from spectra_kit.linalg.shift_invert import shifted_factor
from spectra_kit.linalg.threads import blas_threads_for
from spectra_kit.operators.laplacian import Laplacian
from spectra_kit.subspaces import Subspace
from spectra_kit.subspaces.given import OnPoints

_DENSE_RATIO = 5  # below this multiple of the block the trial space is most of the whole space
_NEXT = 1e-2  # relative residual by which the mode after the wanted ones is known not to be lower
_GUARD = 0.15  # extra vectors relative to k: the last wanted modes converge at their gap to these


@checked
@dataclass(frozen=True, kw_only=True)
class Lobpcg(OnPoints):
    """LOBPCG with a Cholesky or an algebraic multigrid preconditioner.

    Parameters
    ----------
    rtol : float, default 1e-8
        Stop when ``||L u - lambda M u||`` in the M^-1 norm is at most
        ``rtol * max(lambda, spacing)`` for every mode.
    max_steps : int, default 200
        Iterations before giving up.
    preconditioner : {"cholesky", "amg"}, default "cholesky"
        A sparse factor of the shifted operator, or smoothed aggregation (needs pyamg), whose
        memory grows only linearly.
    start : Subspace, optional
        Where to start from, such as a `NeoSubspace`; random (seeded) without it. Random columns
        join it, for modes of which it holds nothing; under "amg", where nothing is counted, until
        they find no lower one.
    shift : float, default 0.1
        Of the preconditioner, as in `Arpack`.
    seed : int, default 0
        Of the random start and of the guard vectors.

    Raises
    ------
    InvalidInputError
        If a parameter is out of range.
    MissingDependencyError
        If `preconditioner` is "amg" and pyamg is not installed.
    ConvergenceError
        (from `eigensolve`) if `max_steps` did not suffice; ``partial`` holds the converged modes.

    References
    ----------
    Knyazev, *Toward the Optimal Preconditioned Eigensolver*, SIAM J. Sci. Comput. 2001.

    Examples
    --------
    >>> from spectra_kit import Lobpcg, eigensolve, robust_laplacian
    >>> from spectra_kit.geometry import sphere
    >>> laplacian = robust_laplacian(sphere(subdivisions=3).geometry)
    >>> eigensolve(laplacian, 4, Lobpcg()).eigenvalues[1:].round(2)
    array([2., 2., 2.])
    """

    promise: ClassVar[Promise] = "to tolerance"
    rtol: float = 1e-8
    max_steps: int = 200
    preconditioner: Literal["cholesky", "amg"] = "cholesky"
    start: Subspace | None = None
    shift: float = 0.1
    seed: int = 0

    def __post_init__(self) -> None:
        check_positive("rtol", self.rtol)
        check_positive("shift", self.shift)
        check_count("max_steps", self.max_steps, low=1)
        check_count("seed", self.seed, low=0)

    @property
    def factor_free(self) -> bool:
        """See `Eigensolver`."""
        return self.preconditioner == "amg"

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Eigenpairs:
        """See `Eigensolver.eigenpairs`."""
        block = k + max(4, round(_GUARD * k))
        if _DENSE_RATIO * block >= laplacian.n:
            return Dense().eigenpairs(laplacian, k)
        with blas_threads_for(3 * block * laplacian.n):
            return self._iterated(laplacian, k, block)

    def _iterated(self, laplacian: Laplacian, k: int, block: int) -> Eigenpairs:
        clock = Clock()
        # The standard form: orthonormality is Euclidean, and the residual is that of `Certificate`.
        root = np.sqrt(laplacian.mass)
        inverse_root = sparse.diags_array(1 / root)
        standard = sparse.csr_array(inverse_root @ laplacian.stiffness @ inverse_root)
        precondition = self._preconditioner(laplacian, root)
        clock.stage("precondition")
        spacing = laplacian.eigenvalue_spacing
        known = self._predicted(laplacian, k)
        searching = self.factor_free and self.start is not None
        noise, steps, before = np.random.default_rng(self.seed), 0, np.inf
        while True:
            guards = noise.standard_normal((laplacian.n, block - known.shape[1]))
            columns = orthonormalize(root[:, None] * np.hstack([known, guards]), np.ones(len(root)))
            values, vectors, residual, taken = lobpcg(
                standard,
                columns,
                precondition,
                tolerance=self._tolerance(k, spacing),
                k=k + 1 if searching else k,
                max_steps=self.max_steps - steps,
            )
            steps += taken
            trace = float(values[:k].sum())
            # Random columns hold some of every mode; what was predicted may lack some. Where no
            # count will tell, new random columns must not find any that is lower.
            if not searching or steps == self.max_steps or trace >= before * (1 - self.rtol):
                break
            known, before = vectors[:, :k] / root[:, None], trace
        values, vectors, residual = values[:k], vectors[:, :k], residual[:k]
        relative = residual / np.maximum(values, spacing)
        good = relative <= self.rtol
        clock.stage("lobpcg")
        pairs = Eigenpairs(values, vectors / root[:, None], clock.seconds, steps)
        if not good.all():
            raise NotConvergedError(
                f"LOBPCG brought {int(good.sum())} of {quantity(k, 'mode')} to rtol = {self.rtol:g}"
                f" in {steps} steps (largest relative residual {relative.max():.1e})",
                Eigenpairs(values[good], pairs.eigenvectors[:, good]),
                advice=("raise {}", "loosen {}", "use {}"),
                remedies=("max_steps", "rtol", "Arpack"),
            )
        return pairs

    def _tolerance(self, k: int, spacing: float) -> Callable[[Floats], Floats]:
        """Return how large the residual norm of each Ritz value may be."""
        beyond = max(self.rtol, _NEXT) if self.factor_free else self.rtol

        def tolerance(values: Floats) -> Floats:
            share = np.where(np.arange(len(values)) < k, self.rtol, beyond)
            return np.asarray(share * np.maximum(values, spacing))

        return tolerance

    def _predicted(self, laplacian: Laplacian, k: int) -> Floats:
        """Return the k lowest Ritz vectors of the start, or all there are; none without a start."""
        if self.start is None:
            return np.empty((laplacian.n, 0))
        Y = orthonormalize(basis_with_kernel(self.start, laplacian), laplacian.mass)
        projected = Y.T @ (laplacian.stiffness @ Y)
        return np.asarray(Y @ np.linalg.eigh((projected + projected.T) / 2)[1][:, :k])

    def _preconditioner(self, laplacian: Laplacian, root: Floats) -> Callable[[Floats], Floats]:
        """Return an approximate inverse of the shifted operator, in the standard form."""
        sigma = -self.shift * laplacian.eigenvalue_spacing
        column = root[:, None]
        if self.preconditioner == "cholesky":
            factor = shifted_factor(laplacian.stiffness, laplacian.mass, sigma, SparseLDL)
            return lambda x: column * factor.solve(column * x)
        pyamg = optional("pyamg", extra="amg", needed_by='Lobpcg(preconditioner="amg")')
        shifted = laplacian.stiffness - sigma * sparse.diags_array(laplacian.mass)
        cycle = pyamg.smoothed_aggregation_solver(
            sparse.csr_matrix(shifted),
            B=np.ones((laplacian.n, 1)),
            symmetry="symmetric",
            # Local weights: the default estimates a spectral radius from a random start.
            smooth=("jacobi", {"omega": 4 / 3, "weighting": "local"}),
        ).aspreconditioner()
        return lambda x: column * np.column_stack([cycle @ c for c in (column * x).T])


def lobpcg(
    operator: sparse.csr_array,
    start: Floats,
    precondition: Callable[[Floats], Floats],
    *,
    tolerance: Callable[[Floats], Floats],
    k: int,
    max_steps: int,
) -> tuple[Floats, Floats, Floats, int]:
    """Find the k lowest eigenpairs of a symmetric `operator` from b >= k orthonormal columns.

    Returns them with their residual norms, and the steps taken. `precondition` is an approximate
    inverse, `tolerance` the largest allowed residual norm of each Ritz value.

    scipy's LOBPCG iterates until the guard columns have converged too, to one absolute tolerance
    for all modes; here only the k wanted ones count, each by its own. The trial space is
    orthonormalised as a whole (Duersch et al., *A Robust and Efficient Implementation of LOBPCG*,
    2018), so it neither breaks down nor loses accuracy near convergence.
    """
    ones = np.ones(len(start))
    values, rotation = np.linalg.eigh(start.T @ (operator @ start))
    x = start @ rotation
    b = x.shape[1]
    directions = np.empty((len(x), 0))
    steps = 0
    for _ in range(max_steps):
        residuals = operator @ x - x * values
        norms = np.linalg.norm(residuals, axis=0)
        active = norms > tolerance(values)
        if not active[:k].any():
            break
        w = precondition(residuals[:, active])
        # Against x twice: once leaves what cancellation leaves.
        trial = np.hstack([w / np.linalg.norm(w, axis=0), directions])
        for _ in range(2):
            trial -= x @ (x.T @ trial)
        trial = orthonormalize(trial, ones)
        space = np.hstack([x, trial])
        ritz, rotation = np.linalg.eigh(space.T @ (operator @ space))
        values, rotation = ritz[:b], rotation[:, :b]
        directions = (trial @ rotation[b:])[:, active]
        x = space @ rotation
        steps += 1
    else:
        norms = np.linalg.norm(operator @ x - x * values, axis=0)
    return values[:k], x[:, :k], norms[:k], steps
