"""`Cascade`: modes of a few thousand points, carried to all of them and smoothed on the way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from spectra_kit._core.checked import checked
from spectra_kit._core.clock import Clock
from spectra_kit._core.threads import team
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_count, check_positive, quantity
from spectra_kit._sparse.blocks import device_clock, device_memory
from spectra_kit._sparse.ritz import ritz_pairs
from spectra_kit.eigen.accuracy import counted_errors
from spectra_kit.eigen.base import Eigenpairs, Promise, basis_with_kernel, block_size, set_device
from spectra_kit.eigen.lanczos import cheapest, or_densely
from spectra_kit.eigen.multigrid.cascade import Smoothed, coarsest_eigenpairs, nested, prolonged
from spectra_kit.eigen.multigrid.coarse import Coarse, gathered
from spectra_kit.eigen.multigrid.smoothing import on_device
from spectra_kit.eigen.subspaces.base import OnPoints, Subspace, restricted
from spectra_kit.operators.laplacian import Laplacian

_ROOM = 6  # points of the coarsest level for each column: fewer have no low modes
# Modes and points, of small parts say, up to which Lanczos on a factor costs less, and is exact.
# For 9 modes on 4,800 points it takes half as long, for 24 on 6,400 as long; from 40 on longer.
_FEW_MODES, _FEW_POINTS = 39, 5000
_PREDICTED = 2048  # points of the coarsest level that a prediction begins on


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
        ``Neo().subspace``. Without it, the coarsest level is solved.
    target : float, default 1e-3
        Relative errors of the eigenvalues, in the mean: smooth until they are estimated to be a
        third of it, for estimates are off by that much at times.
    coarsest : int, optional
        Points of the coarsest level, about; more where k is large. 6 for each column without it
        (2,048 at least, with a subspace). With fewer than twice as many points in all, this is
        `Automatic`; with a subspace, the subspace on all points. Without it, `Arpack` also solves
        parts of up to 5,000 points for fewer than 40 modes, where that costs less.
    guard : float, default 0.4
        Columns beyond k, relative to k, below the finest level; half as many there. The worse the
        coarse levels, the more of them are needed.
    max_steps : int, default 20
        Steps on all points at most: a smoother and Rayleigh-Ritz. 0 carries the modes up alone.
    device : str or torch.device, default "cpu"
        "cpu" or "cuda", for all but the coarsest level and few points; never chosen for you.
    rank_tol : float, default 1e-10
        Of a subspace: relative cut on its singular values; see `_sparse.orthonormalize`.
    seed : int, default 0
        Of random columns, where the coarsest level is too large to be solved densely.

    Notes
    -----
    Cascadic multigrid (Bornemann and Deuflhard, 1996) for eigenpairs, on nested Galerkin levels
    (`eigen.multigrid`): Ritz values there are those of the prolonged functions on all points, and
    so bounds from above.

    Errors estimated are held against counts of the eigenvalues on up to 10,000 points, and on more
    where coarse levels may not see the modes, as beside a potential. That takes a factor.

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
    coarsest: int | None = None
    guard: float = 0.4
    max_steps: int = 20
    device: str = "cpu"
    rank_tol: float = 1e-10
    seed: int = 0

    def __post_init__(self) -> None:
        set_device(self)
        check_positive("target", self.target)
        if self.coarsest is not None:
            check_count("coarsest", self.coarsest, low=100)
        check_positive("guard", self.guard)
        check_count("max_steps", self.max_steps, low=0)
        check_count("seed", self.seed, low=0)
        check_positive("rank_tol", self.rank_tol)

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Eigenpairs:
        """See `Eigensolver.eigenpairs`."""
        block, keep = block_size(k, self.guard), block_size(k, self.guard / 2)
        clock = device_clock(self.device)
        # Without sparse products nothing depends on the order of the points.
        gathers, order = gathered(laplacian) if self.max_steps else (laplacian, None)
        least = self.coarsest or (0 if self.subspace is None else _PREDICTED)
        levels = nested(gathers, max(least, _ROOM * block))
        few = self.coarsest is None and k <= _FEW_MODES and laplacian.n <= _FEW_POINTS
        if self.subspace is None and (few or not levels):
            why = f"an exact solution is quickest for {quantity(k, 'mode')} of {laplacian.n} points"
            exact = cheapest(laplacian.n, k, seed=self.seed)
            return or_densely(exact, laplacian, k, why, seed=self.seed)
        clock.stage("coarsen")
        bottom = levels[-1] if levels else gathers
        with device_memory(), team():
            if self.subspace is None:
                assert isinstance(bottom, Coarse)
                begun: tuple[Floats, Any] = coarsest_eigenpairs(bottom, block, k, seed=self.seed)
            else:
                points = _points(gathers, levels)
                subspace = restricted(self.subspace, points if order is None else order[points])
                basis = basis_with_kernel(subspace, bottom)
                clock.stage("subspace")
                L, M, Y = (
                    on_device(part, self.device) for part in (bottom.stiffness, bottom.mass, basis)
                )
                wanted = block if levels else keep
                begun = ritz_pairs(L, M, Y, wanted, least=k, rank_tol=self.rank_tol)[:2]
            clock.stage("coarse")
            found = prolonged(
                gathers,
                levels,
                *begun,
                k,
                keep=keep,
                target=self.target,
                max_steps=self.max_steps,
                device=self.device,
                clock=clock,
            )
        return self._told(laplacian, found, k, clock, order)

    def _told(
        self, laplacian: Laplacian, found: Smoothed, k: int, clock: Clock, order: Ints | None = None
    ) -> Eigenpairs:
        """Return what was found on the points as they came, with errors held against counts."""
        vectors = found.eigenvectors[:, :k]
        if not isinstance(vectors, np.ndarray):
            with device_memory():
                vectors = np.asarray(vectors.cpu().numpy())
            clock.stage("transfer")
        if order is not None:
            there, vectors = vectors, np.empty_like(vectors)
            vectors[order] = there
        values = found.eigenvalues[:k]
        errors = None  # carried modes alone tell nothing
        if found.steps:
            unit = np.maximum(values, laplacian.eigenvalue_spacing)
            errors = counted_errors(laplacian, values, found.errors * unit) / unit
            clock.stage("count")
        pairs = Eigenpairs(values, vectors, clock.seconds, found.steps, errors)
        return pairs if self.subspace is not None else pairs._replace(solver=self)


def _points(laplacian: Laplacian, levels: list[Coarse]) -> Ints:
    """Return which of all points the coarsest level has."""
    points = np.arange(laplacian.n)
    for level in levels:
        points = points[level.subset.indices]
    return points
