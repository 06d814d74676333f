"""`Capped`: a prediction on a few thousand points, whatever the resolution."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from spectra_kit._checked import checked
from spectra_kit._clock import Clock
from spectra_kit._validate import check_count
from spectra_kit.eigensolvers.base import Accuracy, Eigenpairs
from spectra_kit.eigensolvers.rayleigh_ritz import RayleighRitz
from spectra_kit.eigensolvers.refined import Polished
from spectra_kit.eigensolvers.starts import basis_with_kernel, plane_waves
from spectra_kit.errors import InvalidInputError
from spectra_kit.levels import coarse_iteration, coarse_ritz, coarsen, smoothed
from spectra_kit.linalg.products import spmm
from spectra_kit.linalg.ritz import ritz_pairs, ritz_rotation
from spectra_kit.operators.laplacian import Laplacian
from spectra_kit.subspaces import Subspace, restricted
from spectra_kit.subspaces.given import OnPoints

_GUARD = 0.5  # columns that are swept beyond k, relative to k


@checked
@dataclass(frozen=True, kw_only=True)
class Capped(OnPoints):
    """Evaluate a subspace on a well-spread subset, solve there, and carry the modes to all points.

    Approximate; the certificate says by how much. What grows with the resolution is a sparse
    interpolation, a few sparse products and one Rayleigh-Ritz, all of k columns alone.

    Parameters
    ----------
    subspace : Subspace, optional
        Any that is a function of points and masses, such as ``Neo().subspace``; some 2.7 k plane
        waves without it. With
        ``RandomBasis`` and some four sweeps it is a purely classical method.
    n_points : int, default 4096
        Points of the subset, about. Where there are fewer than twice as many, all are used, and
        this is `Polished` (`RayleighRitz` without sweeps).
    sweeps : int, default 1
        Filtered shift-invert sweeps on the subset, before the modes are carried to all points;
        0 leaves the prediction as it is.
    smoothing : int, default 6
        Sparse products that smooth the modes on all points (`levels.smoothed`), before a last
        Rayleigh-Ritz there; 0 leaves them as they were carried.

    Raises
    ------
    InvalidInputError
        If a parameter is out of range, or the subspace spans fewer than k dimensions.

    Notes
    -----
    The Galerkin operators of the subset (`levels.Coarse`) make its Ritz values those of the
    carried functions on all points: bounds from above, as after smoothing. The masses that the
    subspace sees are the areas that the points of the subset stand for.

    Examples
    --------
    >>> from spectra_kit import Arpack, Capped, eigensolve, robust_laplacian
    >>> from spectra_kit.geometry import creature
    >>> laplacian = robust_laplacian(creature(6000, seed=0))
    >>> exact, capped = (eigensolve(laplacian, 40, s) for s in (Arpack(), Capped(n_points=2000)))
    >>> bool(abs(capped.eigenvalues[1:] / exact.eigenvalues[1:] - 1).max() < 0.01)
    True
    """

    accuracy: ClassVar[Accuracy] = "approximate"
    subspace: Subspace | None = None
    n_points: int = 4096
    sweeps: int = 1
    smoothing: int = 6

    def __post_init__(self) -> None:
        check_count("n_points", self.n_points, low=100)
        check_count("sweeps", self.sweeps, low=0)
        check_count("smoothing", self.smoothing, low=0)

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Eigenpairs:
        """See `Eigensolver.eigenpairs`."""
        subspace = plane_waves(k) if self.subspace is None else self.subspace
        if laplacian.n < 2 * self.n_points:
            if self.sweeps:
                return Polished(start=subspace, sweeps=self.sweeps).eigenpairs(laplacian, k)
            return RayleighRitz(subspace=subspace).eigenpairs(laplacian, k)
        clock = Clock()
        level = coarsen(laplacian, self.n_points)
        clock.stage("coarsen")
        basis = basis_with_kernel(restricted(subspace, level.subset.indices), level)
        clock.stage("subspace")
        guard = max(8, round(_GUARD * k)) if self.sweeps else 0
        pairs = coarse_ritz(level, basis, k, guard=guard)
        pairs = coarse_iteration(level, pairs, k, max_sweeps=self.sweeps)
        clock.stage("coarse")
        values = pairs.eigenvalues[:k]
        vectors = np.asarray(spmm(level.prolongation, pairs.eigenvectors[:, :k]))
        if self.smoothing:
            smooth = smoothed(laplacian, values, vectors, degree=self.smoothing)
            L, mass = laplacian.stiffness, laplacian.mass
            try:
                values, vectors = ritz_rotation(L, mass, smooth)
            except InvalidInputError:  # what they had beyond others was rough
                values, vectors, _ = ritz_pairs(L, mass, np.hstack([smooth, vectors]), k, least=k)
        clock.stage("carry")
        return Eigenpairs(values, vectors, clock.seconds, self.sweeps)
