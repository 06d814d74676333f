"""`Cascade`: modes of a few thousand points, carried to all of them and smoothed on the way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from spectra_kit._checked import checked
from spectra_kit._types import Floats, Ints
from spectra_kit._validate import check_count, check_positive
from spectra_kit.eigensolvers.base import Eigenpairs, Promise
from spectra_kit.eigensolvers.refined import Polished, Refined
from spectra_kit.eigensolvers.starts import basis_with_kernel, block_size
from spectra_kit.levels import Coarse, coarse_iteration, coarse_ritz
from spectra_kit.levels.cascade import climb, nested
from spectra_kit.levels.smoothing import on_device
from spectra_kit.linalg.ritz import ritz_pairs
from spectra_kit.operators.laplacian import Laplacian
from spectra_kit.subspaces import RandomBasis, Subspace, restricted
from spectra_kit.subspaces.given import OnPoints

_SWEEPS = 20  # at most; three or four settle random columns
_SETTLED = 0.01  # change of the coarsest Ritz values in the last sweep; the next gains nothing
_CLOSEST = 1e-8  # residuals that few points are solved to at most: errors are their squares
_ROOM = 6  # points of the coarsest level for each column: fewer have no low modes


@checked
@dataclass(frozen=True, kw_only=True)
class Cascade(OnPoints):
    """Solve on few points, carry the modes up level by level, and smooth them on each.

    Approximate, without a factor of more than a few thousand points: what grows with the
    resolution is sparse products and Rayleigh-Ritz. How many follows from the operator and from
    what they gain; the certificate says what was reached.

    Parameters
    ----------
    subspace : Subspace, optional
        Where to begin on the coarsest level: any function of points and masses, such as
        ``Neo().subspace``. Random columns without it, swept until they settle.
    target : float, default 1e-3
        Smooth on all points until the relative errors of the eigenvalues, as estimated, are below
        this in the mean.
    coarsest : int, default 2048
        Points of the coarsest level, about; more where k is large. With fewer than twice as many
        points in all, this is `Refined` (`Polished`, where `sweeps` are given; with 0, the subspace
        on all points).
    sweeps : int, optional
        Filtered shift-invert sweeps on the coarsest level; until they settle without it. 0
        leaves a prediction as it is, and no matrix is ever factorised.
    guard : float, default 0.67
        Columns beyond k, relative to k, below the finest level; half as many there. The worse the
        coarse levels, the more of them are needed.
    max_steps : int, default 20
        Steps on all points at most: a smoother and Rayleigh-Ritz. 0 carries the modes up alone.
    device : str or torch.device, default "cpu"
        "cpu" or "cuda", for all but the coarsest level and few points; never chosen for you.
    rank_tol : float, default 1e-10
        Of a basis that is not swept: relative cut on its singular values; see
        `linalg.orthonormalize`.
    seed : int, default 0
        Of random columns.

    Raises
    ------
    InvalidInputError
        If a parameter is out of range, or the subspace spans fewer than k dimensions.

    Notes
    -----
    Cascadic multigrid (Bornemann and Deuflhard, 1996) for eigenpairs, on the nested Galerkin levels
    of `levels`: Ritz values there are those of the carried functions on all points, and so bounds
    from above.

    Examples
    --------
    >>> from spectra_kit import Arpack, Cascade, eigensolve, robust_laplacian
    >>> from spectra_kit.geometry import creature
    >>> laplacian = robust_laplacian(creature(6000, seed=0))
    >>> exact, found = (eigensolve(laplacian, 40, s) for s in (Arpack(), Cascade()))
    >>> bool(abs(found.eigenvalues[1:] / exact.eigenvalues[1:] - 1).mean() < 1e-3)
    True
    """

    promise: ClassVar[Promise] = "approximate"
    subspace: Subspace | None = None
    target: float = 1e-3
    coarsest: int = 2048
    sweeps: int | None = None
    guard: float = 0.67
    max_steps: int = 20
    device: str = "cpu"
    rank_tol: float = 1e-10
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "device", str(self.device))
        check_positive("target", self.target)
        check_count("coarsest", self.coarsest, low=100)
        if self.sweeps is not None:
            check_count("sweeps", self.sweeps, low=0)
        check_positive("guard", self.guard)
        check_count("max_steps", self.max_steps, low=0)
        check_count("seed", self.seed, low=0)
        if self.device != "cpu":
            from spectra_kit.linalg.torch_device import check_device

            check_device(self.device)
        check_positive("rank_tol", self.rank_tol)

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Eigenpairs:
        """See `Eigensolver.eigenpairs`."""
        from spectra_kit.linalg.torch_device import device_clock, device_memory

        block = block_size(k, self.guard)
        subspace = self.subspace or RandomBasis(m=block, seed=self.seed)
        clock = device_clock(self.device)
        levels = nested(laplacian, max(self.coarsest, _ROOM * block))
        if not levels and self.sweeps != 0:
            return self._without_levels(subspace, laplacian, k)
        clock.stage("coarsen")
        if levels:
            subspace = restricted(subspace, _points(levels))
        bottom = levels[-1] if levels else laplacian
        basis = basis_with_kernel(subspace, bottom)
        clock.stage("subspace")
        with device_memory():
            begun = self._begun(bottom, basis, k, block)
            clock.stage("coarse")
            found = climb(
                laplacian,
                levels,
                *begun,
                k,
                keep=block_size(k, self.guard / 2),
                target=self.target,
                max_steps=self.max_steps,
                device=self.device,
                clock=clock,
            )
            vectors = found.eigenvectors[:, :k]
            if not isinstance(vectors, np.ndarray):
                vectors = np.asarray(vectors.cpu().numpy())
                clock.stage("transfer")
        errors = found.errors if found.steps else None  # carried modes alone tell nothing
        return Eigenpairs(found.eigenvalues[:k], vectors, clock.seconds, found.steps, errors)

    def _without_levels(self, start: Subspace, laplacian: Laplacian, k: int) -> Eigenpairs:
        """Solve where there are few points, on the host."""
        if self.sweeps is not None:
            polished = Polished(start=start, sweeps=self.sweeps, guard=self.guard, seed=self.seed)
            return polished.eigenpairs(laplacian, k)
        rtol = min(max(self.target, _CLOSEST), 0.1)
        refined = Refined(start=start, rtol=rtol, guard=self.guard, seed=self.seed)
        # The error of an eigenvalue is of second order in its residual.
        return refined.eigenpairs(laplacian, k)._replace(errors=np.full(k, rtol**2))

    def _begun(
        self, bottom: Coarse | Laplacian, basis: NDArray[np.floating], k: int, block: int
    ) -> tuple[Floats, Any]:
        """Return Ritz pairs of the coarsest level, k at least, and swept there if that is asked."""
        if self.sweeps == 0:
            L, M, Y = (
                on_device(part, self.device) for part in (bottom.stiffness, bottom.mass, basis)
            )
            return ritz_pairs(L, M, Y, block, least=k, rank_tol=self.rank_tol)[:2]
        assert isinstance(bottom, Coarse)
        least = 1 if self.sweeps is None else k  # sweeps until they settle make up for the rest
        start = coarse_ritz(bottom, basis, least, guard=block - least)
        if len(start.eigenvalues) < block and self.sweeps is None:
            noise = np.random.default_rng(self.seed).standard_normal((bottom.n, block))
            start = coarse_ritz(bottom, np.hstack([start.eigenvectors, noise]), k, guard=block - k)
        return coarse_iteration(
            bottom, start, k, rtol=_SETTLED, max_sweeps=self.sweeps or _SWEEPS, least=1
        )


def _points(levels: list[Coarse]) -> Ints:
    """Return which of all points the coarsest level has."""
    points = levels[0].subset.indices
    for level in levels[1:]:
        points = points[level.subset.indices]
    return points
