"""The smoothing that predictions get, on batches, with gradients: what a loss after it needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from scipy import sparse
from torch import Tensor

from spectra_kit._sparse.torch_device import csr_product, csr_tensor
from spectra_kit.eigen.multigrid.smoothing import (
    chebyshev_steps,
    enough_steps,
    lowest_damped,
    preconditioner,
)

_MOST = 0.9  # of the highest eigenvalue: from there on columns fill the space of the points


@dataclass(frozen=True, eq=False)
class Smoother:
    """Chebyshev steps of ``(L - lambda_j M) c = -r_j`` for errors of the modes of B surfaces.

    An error e of mode j has the residual ``(L - lambda_j M) e``, to which the mode adds nothing, so
    after the steps of `eigen.multigrid.smoothing` it is ``p(D^-1 (L - lambda_j M)) e`` with their
    polynomial
    p and preconditioner D. Exact modes stay exact. Made by `of`.

    Attributes
    ----------
    stiffness : sparse Tensor of shape (B N, B N)
        L of all surfaces, in blocks.
    mass, diagonal : Tensor of shape (B, N, 1)
        The diagonals of M and D.
    values : Tensor of shape (B, 1, k)
        Eigenvalues.
    steps : tuple of (Tensor, Tensor), of shape (B, 1, 1)
        What a step keeps of the one before, and how far it goes.
    """

    stiffness: Tensor
    mass: Tensor
    diagonal: Tensor
    values: Tensor
    steps: tuple[tuple[Tensor, Tensor], ...]

    @classmethod
    def of(
        cls,
        stiffness: Sequence[sparse.csr_array],
        mass: ArrayLike,
        eigenvalues: ArrayLike,
        eigenvectors: ArrayLike,
        *,
        degree: int,
        dtype: torch.dtype = torch.float32,
    ) -> Smoother:
        """Prepare `degree` steps for the modes of surfaces.

        Parameters
        ----------
        stiffness : sequence of B sparse arrays of shape (N, N)
            Rows of padding are empty.
        mass : array_like of shape (B, N)
            Zero for padding, in length^2.
        eigenvalues : array_like of shape (B, k)
            Ascending, of ``L u = lambda M u``, in 1/length^2.
        eigenvectors : array_like of shape (B, N, k)
            The last of which tells from where on to damp.
        degree : int
            Products with L, at most; how near to the modes they damp grows with the square.
        dtype : torch.dtype, default float32
            To smooth in.

        Returns
        -------
        Smoother
            On the CPU; see `smoothed_residuals` for an example.
        """
        masses, values = (np.asarray(a, dtype=np.float64) for a in (mass, eigenvalues))
        last = np.asarray(eigenvectors)[..., -1].astype(np.float64)
        diagonals = np.ones_like(masses)
        plans: list[list[tuple[float, float]]] = []
        for L, M, D, u, value in zip(
            stiffness, masses, diagonals, last, values[:, -1], strict=True
        ):
            real = np.flatnonzero(M)
            D[real], highest = preconditioner(sparse.csr_array(L[real][:, real]), M[real])
            wanted = value * (M @ u**2) / (D[real] @ u[real] ** 2)
            lowest = min(lowest_damped(wanted, highest, degree), _MOST * highest)
            steps = chebyshev_steps(np.array([lowest]), highest, enough_steps(lowest, highest))
            plans.append([(float(keep[0]), float(far[0])) for keep, far in steps])
        plans = [plan + [(0.0, 0.0)] * (degree - len(plan)) for plan in plans]  # stays as it is

        def there(array: Any, *shape: int) -> Tensor:
            return torch.tensor(np.array(array), dtype=dtype).view(len(masses), *shape)

        return cls(
            csr_tensor(sparse.csr_array(sparse.block_diag(stiffness, format="csr")), dtype),
            there(masses, -1, 1),
            there(diagonals, -1, 1),
            there(values, 1, -1),
            tuple(
                (there([keep for keep, _ in step], 1, 1), there([far for _, far in step], 1, 1))
                for step in zip(*plans, strict=True)
            ),
        )

    def to(self, device: torch.device) -> Smoother:
        """Return the same on a device."""
        return Smoother(
            self.stiffness.to(device),
            self.mass.to(device),
            self.diagonal.to(device),
            self.values.to(device),
            tuple((keep.to(device), step.to(device)) for keep, step in self.steps),
        )

    def __call__(self, errors: Tensor) -> Tensor:
        """Return errors of the modes, shape (B, N, k), as they are after the steps."""
        smooth: Tensor = _Smooth.apply(errors, self)  # type: ignore[no-untyped-call]
        return smooth

    def without_gradient(self, errors: Tensor) -> Tensor:
        """Return the same, and no gradient."""
        smooth = before = errors
        for keep, step in self.steps:
            image = csr_product(self.stiffness, smooth.flatten(0, 1), errors.dtype).view_as(errors)
            image.addcmul_(self.mass * self.values, smooth, value=-1)
            change = keep * (smooth - before)
            smooth, before = smooth + change.addcmul_(step / self.diagonal, image, value=-1), smooth
        return smooth


class _Smooth(torch.autograd.Function):
    """The transpose of p(D^-1 A) with symmetric A and D is D p(D^-1 A) D^-1: nothing is kept."""

    @staticmethod
    def forward(ctx: Any, errors: Tensor, smoother: Smoother) -> Tensor:
        ctx.smoother = smoother
        return smoother.without_gradient(errors)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:
        smoother: Smoother = ctx.smoother
        D = smoother.diagonal
        return D * smoother.without_gradient(gradients[0] / D), None
