"""What training minimises: the energy of the true modes outside the predicted span.

Also after the smoothing that predictions get, on batches and with gradients. Letters: B clouds of N
points, predicted functions F (B, N, m) and true modes U (B, N, k) of any scale, masses (B, N), also
of any scale, zero for padding.
"""

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

# Added to the diagonal of a Gram matrix of functions of norm one: directions that they hold with
# less than a thousandth of their norm hardly count, and a rank-deficient F has a loss and a
# gradient too.
_RIDGE = 1e-6
_MOST = 0.9  # of the highest eigenvalue: from there on columns fill the space of the points


def mode_residuals(F: Tensor, mass: Tensor, U: Tensor) -> Tensor:
    """Return the energy share of each mode outside the span of `F`.

    With G = F^T M F = L_c L_c^T this is r_j = 1 - |L_c^-1 F^T M u_j|^2 / |u_j|_M^2: the value and
    the gradient of an M-weighted QR of F, from two matrix products and an m x m Cholesky. As each
    mode is divided by its own norm, `U` need not be M-orthonormal (say, after subsampling). Shape
    (B, k), each in [0, 1] up to rounding, float32; NaN for a cloud whose functions are not finite.
    """
    root = mass.float().sqrt().unsqueeze(-1)
    _, half = _inside(_unit(F, root), _unit(U, root), root)
    residuals: Tensor = (1 - half.square().sum(-2)).float()
    return residuals


def smoothed_residuals(
    F: Tensor, mass: Tensor, U: Tensor, smoother: Smoother
) -> tuple[Tensor, Tensor]:
    """Return the energy shares of `mode_residuals`, and those that smoothing leaves of them.

    Of each mode the best approximation in the span of `F` is taken, its error smoothed by the steps
    that `Neo` makes, and what is left outside the span of the k smooth functions measured. `Neo`,
    which knows neither modes nor eigenvalues, smooths Ritz vectors, again and again.
    """
    root = mass.float().sqrt().unsqueeze(-1)
    functions, modes = _unit(F, root), _unit(U, root)
    factor, half = _inside(functions, modes, root)
    nearest = functions.double() @ torch.linalg.solve_triangular(factor.mT, half, upper=True)
    errors = smoother((nearest - modes).to(smoother.mass.dtype))
    left = mode_residuals(modes + errors, mass, modes)
    return (1 - half.square().sum(-2)).float(), left


def _unit(F: Tensor, root: Tensor) -> Tensor:
    """Return functions of M-norm one, for roots of the masses (B, N, 1)."""
    F = F.float()
    unit: Tensor = F / (root * F).norm(dim=-2, keepdim=True).clamp(min=1e-12)
    return unit


def _inside(F: Tensor, U: Tensor, root: Tensor) -> tuple[Tensor, Tensor]:
    """Return L_c, and L_c^-1 F^T M U for functions of M-norm one."""
    # Unit columns make the Cholesky factor see directions, not magnitudes.
    # Double precision from here on: trained functions share large parts, and the rounding of a
    # float32 product can then exceed the ridge. On a CPU it adds some 5 % to a whole step.
    Z, V = (root * F).double(), (root * U).double()
    G = Z.mT @ Z
    G = G + _RIDGE * torch.eye(G.shape[-1], dtype=G.dtype, device=G.device)
    # Without a look at `info`, for which a device would be waited for: functions that are not
    # finite, as an overflow in float16 leaves them, give residuals that are not finite either.
    factor, info = torch.linalg.cholesky_ex(G)
    factor = torch.where((info == 0)[..., None, None], factor, torch.nan)
    return factor, torch.linalg.solve_triangular(factor, Z.mT @ V, upper=False)


def ortho_loss(F: Tensor, mass: Tensor) -> Tensor:
    """Return |F^T M F - I|_F^2 / m^2, with masses over their sum, averaged over clouds.

    The paper's regulariser (Eq. "ortho_loss") per entry of the matrix. The span loss is a mean of
    numbers in [0, 1]; as a plain sum, m^2 entries of size one would outweigh all of it 37 times
    with the paper's factor of 1e-3 and m = 192. The mean over entries keeps that factor and makes
    the term what the paper calls it, weak.
    """
    F = F.float()
    weights = (mass / mass.sum(-1, keepdim=True)).float().unsqueeze(-1)
    G = F.mT @ (weights * F)
    return (G - torch.eye(G.shape[-1], device=G.device)).square().mean()


@dataclass(frozen=True, eq=False)
class Smoother:
    """Chebyshev steps of ``(L - lambda_j M) c = -r_j`` for errors of the modes of B surfaces.

    An error e of mode j has the residual ``(L - lambda_j M) e``, to which the mode adds nothing, so
    after the steps of `eigen.multigrid.smoothing` it is ``p(D^-1 (L - lambda_j M)) e`` with their
    polynomial p and preconditioner D. Exact modes stay exact. Made by `of`.

    `stiffness` is L of all surfaces, in blocks, (B N, B N). `mass` and `diagonal` are the diagonals
    of M and D, (B, N, 1), `values` the eigenvalues, (B, 1, k). Each of the `steps` has two numbers,
    (B, 1, 1): what it keeps of the one before, and how far it goes.
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
        """Prepare steps, on the CPU, for k modes of each of B surfaces of N points.

        At most `degree` products with L: how near to the modes they damp grows with its square. The
        last mode tells from where on to damp. Padding has no mass, and empty rows in L.
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
