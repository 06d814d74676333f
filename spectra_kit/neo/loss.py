"""What training minimises: the energy of the true modes outside the predicted span."""

from __future__ import annotations

import torch
from torch import Tensor

from spectra_kit.neo.smoothing import Smoother


def mode_residuals(F: Tensor, mass: Tensor, U: Tensor, *, ridge: float = 1e-6) -> Tensor:
    """Return the energy share of each mode outside the span of `F`.

    With G = F^T M F = L_c L_c^T this is r_j = 1 - |L_c^-1 F^T M u_j|^2 / |u_j|_M^2: the value and
    the gradient of an M-weighted QR of F, from two matrix products and an m x m Cholesky. As each
    mode is divided by its own norm, `U` need not be M-orthonormal (say, after subsampling).

    Parameters
    ----------
    F : Tensor of shape (B, N, m)
        Predicted functions. Their scale does not matter.
    mass : Tensor of shape (B, N)
        Weights, zero for padding. Their scale does not matter.
    U : Tensor of shape (B, N, k)
        True modes.
    ridge : float, default 1e-6
        Added to the diagonal of G after its columns are normalised: directions that the functions
        hold with less than a thousandth of their norm hardly count, and a rank-deficient F has a
        loss and a gradient too.

    Returns
    -------
    Tensor of shape (B, k)
        Each in [0, 1] up to rounding, float32; NaN for a cloud whose functions are not finite.

    Examples
    --------
    >>> import torch
    >>> from spectra_kit.neo.loss import mode_residuals
    >>> F, U = torch.eye(4)[None, :, :2], torch.eye(4)[None, :, 1:3]
    >>> mode_residuals(F, torch.ones(1, 4), U).round(decimals=3)
    tensor([[0., 1.]])
    """
    root = mass.float().sqrt().unsqueeze(-1)
    _, half = _inside(_unit(F, root), _unit(U, root), root, ridge)
    residuals: Tensor = (1 - half.square().sum(-2)).float()
    return residuals


def smoothed_residuals(
    F: Tensor, mass: Tensor, U: Tensor, smoother: Smoother, *, ridge: float = 1e-6
) -> tuple[Tensor, Tensor]:
    """Return the energy shares of `mode_residuals`, and those that smoothing leaves of them.

    Of each mode the best approximation in the span of `F` is taken, its error smoothed by the steps
    that `Neo` makes, and what is left outside the span of the k smooth functions measured. `Neo`,
    which knows neither modes nor eigenvalues, smooths Ritz vectors, again and again.

    Parameters
    ----------
    F : Tensor of shape (B, N, m)
        Predicted functions.
    mass : Tensor of shape (B, N)
        Weights; zero for padding.
    U : Tensor of shape (B, N, k)
        True modes.
    smoother : Smoother
        Of these modes.
    ridge : float, default 1e-6
        See `mode_residuals`.

    Returns
    -------
    tuple of two Tensor of shape (B, k)
        Before and after, float32; NaN where the functions of a cloud are not finite.

    Examples
    --------
    Of a path, whose second mode lies outside the span of the first:

    >>> import numpy as np, torch
    >>> from scipy import sparse
    >>> from spectra_kit.neo.loss import smoothed_residuals
    >>> from spectra_kit.neo.smoothing import Smoother
    >>> step = sparse.diags_array([-np.ones(5), np.ones(6), -np.ones(5)], offsets=[-1, 0, 1])
    >>> L = sparse.csr_array(step - sparse.diags_array(step.sum(axis=1)))
    >>> values, U = np.linalg.eigh(L.toarray())
    >>> smoother = Smoother.of([L], np.ones((1, 6)), values[None, :2], U[None, :, :2], degree=4)
    >>> U = torch.from_numpy(U[None]).float()
    >>> F = U[..., :2] + 0.3 * U[..., -2:]
    >>> before, after = smoothed_residuals(F, torch.ones(1, 6), U[..., :2], smoother)
    >>> bool((after < 0.1 * before).all())
    True
    """
    root = mass.float().sqrt().unsqueeze(-1)
    functions, modes = _unit(F, root), _unit(U, root)
    factor, half = _inside(functions, modes, root, ridge)
    nearest = functions.double() @ torch.linalg.solve_triangular(factor.mT, half, upper=True)
    errors = smoother((nearest - modes).to(smoother.mass.dtype))
    left = mode_residuals(modes + errors, mass, modes, ridge=ridge)
    return (1 - half.square().sum(-2)).float(), left


def _unit(F: Tensor, root: Tensor) -> Tensor:
    """Return functions of M-norm one, for roots of the masses (B, N, 1)."""
    F = F.float()
    unit: Tensor = F / (root * F).norm(dim=-2, keepdim=True).clamp(min=1e-12)
    return unit


def _inside(F: Tensor, U: Tensor, root: Tensor, ridge: float) -> tuple[Tensor, Tensor]:
    """Return L_c, and L_c^-1 F^T M U for functions of M-norm one."""
    # Unit columns make the Cholesky factor see directions, not magnitudes.
    # Double precision from here on: trained functions share large parts, and the rounding of a
    # float32 product can then exceed the ridge. On a CPU it adds some 5 % to a whole step.
    Z, V = (root * F).double(), (root * U).double()
    G = Z.mT @ Z
    G = G + ridge * torch.eye(G.shape[-1], dtype=G.dtype, device=G.device)
    # Without a look at `info`, for which a device would be waited for: functions that are not
    # finite, as an overflow in float16 leaves them, give residuals that are not finite either.
    factor, info = torch.linalg.cholesky_ex(G)
    factor = torch.where((info == 0)[..., None, None], factor, torch.nan)
    return factor, torch.linalg.solve_triangular(factor, Z.mT @ V, upper=False)


def span_loss(F: Tensor, mass: Tensor, U: Tensor, *, ridge: float = 1e-6) -> Tensor:
    """Return the mean of `mode_residuals` over modes and clouds (paper, Eq. "span_loss").

    Examples
    --------
    >>> import torch
    >>> from spectra_kit.neo.loss import span_loss
    >>> F = torch.eye(5)[None, :, :3]
    >>> U = torch.eye(5)[None, :, 1:4]
    >>> span_loss(F, torch.ones(1, 5), U).item()
    0.3333
    """
    return mode_residuals(F, mass, U, ridge=ridge).mean()


def ortho_loss(F: Tensor, mass: Tensor) -> Tensor:
    """Return |F^T M F - I|_F^2 / m^2, with masses over their sum, averaged over clouds.

    The paper's regulariser (Eq. "ortho_loss") per entry of the matrix. The span loss is a mean of
    numbers in [0, 1]; as a plain sum, m^2 entries of size one would outweigh all of it 37 times
    with the paper's factor of 1e-3 and m = 192. The mean over entries keeps that factor and makes
    the term what the paper calls it, weak.

    Parameters
    ----------
    F : Tensor of shape (B, N, m)
        Predicted functions.
    mass : Tensor of shape (B, N)
        Weights, zero for padding.

    Returns
    -------
    Tensor of shape ()

    Examples
    --------
    >>> import torch
    >>> from spectra_kit.neo.loss import ortho_loss
    >>> ortho_loss(torch.full((1, 5, 1), 2.0), torch.ones(1, 5)).item()
    9.0
    """
    F = F.float()
    weights = (mass / mass.sum(-1, keepdim=True)).float().unsqueeze(-1)
    G = F.mT @ (weights * F)
    return (G - torch.eye(G.shape[-1], device=G.device)).square().mean()
