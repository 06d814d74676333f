"""Rayleigh-Ritz: the best eigenpairs inside a given subspace."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

from spectra_kit._core.checked import checked
from spectra_kit._core.clock import Clock
from spectra_kit._core.validate import check_positive
from spectra_kit._sparse.ritz import ritz_pairs
from spectra_kit.eigen.base import Eigenpairs, Promise, basis_with_kernel
from spectra_kit.eigen.dense import Dense
from spectra_kit.eigen.subspaces.ambient_fourier import AmbientFourier
from spectra_kit.eigen.subspaces.base import OnPoints, Subspace
from spectra_kit.operators.laplacian import Laplacian


@checked
@dataclass(frozen=True, kw_only=True)
class RayleighRitz(OnPoints):
    """Turn a subspace into an eigensolver; approximate, and certified like any other.

    Components with no more than twice as many points as the subspace has functions are solved
    exactly by LAPACK: there is nothing to gain from a guess.

    Parameters
    ----------
    subspace : Subspace, default AmbientFourier()
        Function of (points, mass) that returns a basis of shape (n, m).
    rank_tol : float, default 1e-10
        Relative cut on the singular values of the basis; see `_sparse.orthonormalize`.

    Notes
    -----
    NEO paper, Eqs. (m_qr), (project_operators) and (uplift): Y M-orthonormal, ``Y^T L Y``,
    dense eigenproblem, lift. Ritz values bound the true eigenvalues from above, mode by mode. Where
    constants have no energy the constant function is added to the basis, so that the zero
    mode is exact.

    Nothing is promised beyond that. A mode of which the subspace holds nothing is passed over, and
    the residuals of the others do not tell: plane waves hardly vary across a plate that is thin
    beside their wavelength, so modes odd across it are missing. `verify` shows it.

    Examples
    --------
    >>> from spectra_kit import RayleighRitz, eigensolve, robust_laplacian
    >>> from spectra_kit.geometry import sphere
    >>> laplacian = robust_laplacian(sphere(subdivisions=3).geometry)
    >>> from spectra_kit.eigen.subspaces import AmbientFourier
    >>> solver = RayleighRitz(subspace=AmbientFourier(m=200, bandwidth=3.0))
    >>> eigensolve(laplacian, 4, solver).eigenvalues[1:].round(2)
    array([2., 2., 2.])
    """

    promise: ClassVar[Promise] = "approximate"
    subspace: Subspace = field(default_factory=AmbientFourier)
    rank_tol: float = 1e-10

    def __post_init__(self) -> None:
        check_positive("rank_tol", self.rank_tol)

    @property
    def name(self) -> str:
        """See `Eigensolver`."""
        return "fourier" if isinstance(self.subspace, AmbientFourier) else "rayleighritz"

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Eigenpairs:
        """See `Eigensolver.eigenpairs`."""
        clock = Clock()
        if laplacian.n <= max(3, 2 * k):  # no room for an approximation, or not even a plane
            return Dense().eigenpairs(laplacian, k)
        basis = basis_with_kernel(self.subspace, laplacian)
        if laplacian.n <= 2 * basis.shape[1]:
            return Dense().eigenpairs(laplacian, k)
        clock.stage("subspace")
        values, vectors, _ = ritz_pairs(
            laplacian.stiffness, laplacian._weights, basis, k, least=k, rank_tol=self.rank_tol
        )
        clock.stage("rayleigh_ritz")
        return Eigenpairs(values, vectors, clock.seconds)
