"""`Chebyshev`: filtered block iterations without a sparse factor, in torch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from spectra_kit._checked import checked
from spectra_kit.eigensolvers.base import Eigenpairs, Promise
from spectra_kit.eigensolvers.dense import Dense
from spectra_kit.eigensolvers.refined import DENSE_RATIO, check_sweeping, within
from spectra_kit.eigensolvers.starts import basis_with_kernel, block_size, plane_waves
from spectra_kit.operators.laplacian import Laplacian
from spectra_kit.subspaces import Subspace
from spectra_kit.subspaces.given import OnPoints

if TYPE_CHECKING:
    import torch


@checked
@dataclass(frozen=True, kw_only=True)
class Chebyshev(OnPoints):
    """Like `Refined`, but by sparse products alone: no factor, and on a GPU if you like.

    Parameters
    ----------
    start : Subspace, optional
        Where to begin, as in `Refined`.
    rtol : float, default 1e-8
        As in `Refined`.
    guard : float, default 0.5
        Ritz vectors beyond k, relative to k.
    max_sweeps : int, default 30
        Sweeps before giving up.
    device : str or torch.device, default "cpu"
        "cpu" or "cuda"; never chosen for you.
    seed : int, default 0
        Of all random columns.

    Raises
    ------
    InvalidInputError
        If a parameter is out of range.
    ConvergenceError
        (from `eigensolve`) as of `Refined`.

    Notes
    -----
    As it is taken to avoid a factor, the eigenvalues are not counted: that a mode was missed is
    unlikely, not excluded. The certificate says so, and `verify` proves it.

    See `linalg.chebyshev.chebyshev_eigenpairs` for the method.

    Examples
    --------
    >>> from spectra_kit import Chebyshev, eigensolve, robust_laplacian
    >>> from spectra_kit.geometry import sphere
    >>> laplacian = robust_laplacian(sphere(subdivisions=4).geometry)
    >>> spectrum = eigensolve(laplacian, 25, Chebyshev(rtol=1e-6))
    >>> bool(spectrum.certificate.relative_residuals.max() <= 1.01e-6)
    True
    """

    promise: ClassVar[Promise] = "to tolerance"
    factor_free: ClassVar[bool] = True
    start: Subspace | None = None
    rtol: float = 1e-8
    guard: float = 0.5
    max_sweeps: int = 30
    device: str | torch.device = "cpu"
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "device", str(self.device))
        check_sweeping(self.rtol, self.guard, self.max_sweeps, self.seed)

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Eigenpairs:
        """See `Eigensolver.eigenpairs`."""
        block = block_size(k, self.guard)
        if DENSE_RATIO * block >= laplacian.n:
            return Dense().eigenpairs(laplacian, k)
        import torch

        from spectra_kit.linalg.chebyshev import chebyshev_eigenpairs
        from spectra_kit.linalg.torch_device import (
            check_device,
            device_clock,
            device_memory,
            sparse_tensor,
            torch_threads_for,
        )
        from spectra_kit.neo import NeoSubspace

        with device_memory():
            device = str(self.device)
            clock = device_clock(check_device(device))
            start = plane_waves(k) if self.start is None else self.start
            if isinstance(start, NeoSubspace) and start.device == device:
                columns = start.tensor(laplacian.points, laplacian.mass)  # it stays where it is
                clock.stage("subspace")
            else:
                basis = basis_with_kernel(start, laplacian)
                clock.stage("subspace")
                columns = torch.from_numpy(np.array(basis)).to(device)
            stiffness = sparse_tensor(laplacian.stiffness, device)
            mass = torch.from_numpy(np.array(laplacian.mass)).to(device)
            clock.stage("transfer")
            with torch_threads_for(block * laplacian.n):
                found = chebyshev_eigenpairs(
                    stiffness,
                    mass,
                    columns,
                    k,
                    rtol=self.rtol,
                    spacing=laplacian.eigenvalue_spacing,
                    block=block,
                    max_sweeps=self.max_sweeps,
                    seed=self.seed,
                )
            clock.stage("filter")
            values, vectors, residuals = (
                np.asarray(t.cpu().numpy())
                for t in (found.eigenvalues, found.eigenvectors, found.residuals)
            )
            clock.stage("transfer")
        pairs = Eigenpairs(values, vectors, clock.seconds, found.sweeps)
        return within(self.rtol, laplacian, pairs, residuals, stalled=found.stalled)
