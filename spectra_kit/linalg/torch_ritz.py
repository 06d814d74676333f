"""Rayleigh-Ritz in torch, on CPU or CUDA: the twin of the NumPy solver of the same name."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from spectra_kit._clock import Clock
from spectra_kit._validate import quantity
from spectra_kit.errors import InvalidInputError
from spectra_kit.linalg.torch_device import csr_product, device_clock

_ROWS = 65_536  # rows of a basis handled at once: bounds the temporaries, not the result
_SINGLE_ROWS = 2_048  # of float32 products between two float64 sums: keeps the rounding down
_COLUMNS = 64  # of L @ Y at once, for the same reason
_PASSES = 6  # three suffice down to rank_tol = 1e-14; more mean NaN
_SETTLED = 1e-13  # deviation of the Gram matrix from the identity that rounding alone leaves
# How much the inverse of a Gram matrix may amplify its rounding, in either precision.
_SINGLE_LIMIT, _DOUBLE_LIMIT = 1e7, 1e12
_SPREAD = 1e5  # the same for columns that need no second round
_NOTHING = 1e-13  # share of the largest squared norm: orthonormal columns may be carried to nothing


class RitzPairs(NamedTuple):
    """The lowest eigenpairs inside a subspace.

    Attributes
    ----------
    eigenvalues : Tensor of shape (k,)
        Ascending, float64, in 1/length^2.
    eigenvectors : Tensor of shape (n, k)
        M-orthonormal, float64.
    seconds : dict of str to float
        ``orthonormalize``, ``project``, ``eigh`` (with the lift) and ``settle``.
    """

    eigenvalues: Tensor
    eigenvectors: Tensor
    seconds: dict[str, float]


def orthonormalize(basis: Tensor, mass: Tensor, *, rank_tol: float = 1e-10) -> Tensor:
    """Return an M-orthonormal basis of the numerical range of `basis`, in float64.

    The twin of `linalg.orthonormalize`, where the method is described: the long side sees only
    matrix products, all m x m algebra is float64.
    """
    root = mass.double().sqrt().unsqueeze(1)
    Q = torch.empty(basis.shape, dtype=torch.float64, device=basis.device)  # the one large copy
    for rows in range(0, len(Q), _ROWS):
        torch.mul(
            basis[rows : rows + _ROWS].double(),
            root[rows : rows + _ROWS],
            out=Q[rows : rows + _ROWS],
        )
    norms = Q.norm(dim=0)
    if not norms.isfinite().all() or not norms.any():
        raise InvalidInputError(
            "basis",
            "have finite columns that are not all zero",
            f"{quantity(int((~norms.isfinite()).sum()), 'column')} with NaN or infinite values"
            f" of {len(norms)}",
            advice="in half precision try float32",
        )
    if not norms.all():
        Q = Q[:, norms > 0]
    Q /= norms[norms > 0]
    triangle = torch.eye(Q.shape[1], dtype=Q.dtype, device=Q.device)
    eps = torch.finfo(Q.dtype).eps
    for _ in range(_PASSES):
        values, vectors = torch.linalg.eigh(Q.mT @ Q)  # the scaled columns are Q @ triangle
        if (values - 1).abs().max() < _SETTLED:
            break
        scale = values.clamp_min(values[-1] * len(values) * eps).sqrt()
        left, singular, right = torch.linalg.svd(
            scale.unsqueeze(1) * (vectors.mT @ triangle), full_matrices=False
        )
        kept = singular > rank_tol * singular[0]
        triangle = singular[kept].unsqueeze(1) * right[kept]
        Q = _multiply_rows(Q, (vectors / scale) @ left[:, kept])
    return Q.div_(root)


def rayleigh_ritz(
    stiffness: Tensor,
    mass: Tensor,
    basis: Tensor,
    k: int,
    *,
    rank_tol: float = 1e-10,
    clock: Clock | None = None,
) -> RitzPairs:
    """Return the k lowest Ritz pairs of L u = lambda M u in the span of `basis`.

    NEO paper, Eqs. "m_qr", "project_operators" and "uplift": Y M-orthonormal,
    ``L^ = Y^T L Y``, ``L^ v = lambda v``, ``u = Y v``. `mass` is the diagonal of M, or M itself as
    a sparse tensor; the stages are booked on the `clock`. A rank below k is refused.
    """
    pairs = leading_ritz_pairs(stiffness, mass, basis, k, rank_tol=rank_tol, clock=clock)
    if (rank := len(pairs.eigenvalues)) < k:
        raise InvalidInputError(
            "basis",
            f"span at least k = {k} dimensions",
            f"numerical rank {rank} of {basis.shape[1]} columns",
            advice="ask for fewer modes or join more functions",
        )
    return pairs


def leading_ritz_pairs(
    stiffness: Tensor,
    mass: Tensor,
    basis: Tensor,
    most: int,
    *,
    rank_tol: float = 1e-10,
    clock: Clock | None = None,
) -> RitzPairs:
    """Return what `rayleigh_ritz` does, but only as many pairs as the rank of `basis` allows.

    A basis that is not too badly conditioned is orthonormalised in the small problem alone,
    ``Y = F R^-1`` with ``F^T M F = R^T R``: the long side sees one Gram matrix, one product with L,
    one projection, and the lift of the columns wanted. A second round in these takes away the
    rounding of the first.
    """
    clock = clock or device_clock(basis.device)
    whitening, single = _single_whitening(basis, mass), True
    if whitening is None:
        whitening, single = _whitening(_gram(basis, mass, torch.float64), _DOUBLE_LIMIT), False
    if whitening is None:
        weights = mass if mass.ndim == 1 else torch.ones_like(basis[:, 0])
        basis = orthonormalize(basis, weights, rank_tol=rank_tol)
        whitening = _resolved(_gram(basis, mass, torch.float64))
    clock.stage("orthonormalize")
    projected = _project(stiffness, basis, torch.float32 if single else torch.float64)
    clock.stage("project")
    _, eigenvectors = _lift(projected, whitening, basis, most)
    clock.stage("eigh")
    return ritz_rotation(stiffness, mass, eigenvectors, clock=clock)


def ritz_rotation(
    stiffness: Tensor, mass: Tensor, columns: Tensor, *, clock: Clock | None = None
) -> RitzPairs:
    """Return all Ritz pairs in the span of columns that are far from dependent.

    Such as M-orthonormal ones that were corrected a little; twin of `linalg.ritz.ritz_rotation`.
    """
    clock = clock or device_clock(columns.device)
    for _ in range(2):  # what rounding in an ill-conditioned Gram matrix left oblique is put right
        gram = _gram(columns, mass, torch.float64)
        whitening = _whitening(gram, math.inf)
        if whitening is None:
            raise InvalidInputError(
                "columns",
                "be finite and far from dependent",
                f"{columns.shape[1]} whose Gram matrix is not positive definite",
                advice="smooth them less, or use `rayleigh_ritz`",
            )
        projected = _project(stiffness, columns, torch.float64)
        values, columns = _lift(projected, whitening, columns, columns.shape[1])
        if _whitening(gram, _SPREAD) is not None:
            break
    clock.stage("settle")
    return RitzPairs(values, columns, clock.seconds)


def _single_whitening(basis: Tensor, mass: Tensor) -> Tensor | None:
    """Return `_whitening` by float32 products where these are as good as the basis, else None.

    Not on CUDA: there doubles are about as fast, and a user may have traded float32 for TF32.
    """
    if basis.dtype == torch.float64 or basis.device.type != "cpu":
        return None
    return _whitening(_gram(basis, mass, torch.float32), _SINGLE_LIMIT)


def _gram(basis: Tensor, mass: Tensor, dtype: torch.dtype) -> Tensor:
    """Return ``F^T M F`` in float64: products in `dtype`, sums over blocks of rows in float64."""
    if mass.ndim == 2:
        return _project(mass, basis, dtype)
    m, mean = basis.shape[1], mass.double().mean()
    gram = torch.zeros(m, m, dtype=torch.float64, device=basis.device)
    root = (mass / mean).sqrt().to(dtype).unsqueeze(1)
    rows = _SINGLE_ROWS if dtype == torch.float32 else _ROWS
    for part, weight in zip(torch.split(basis, rows), torch.split(root, rows), strict=True):
        weighted = part.to(dtype) * weight
        gram += weighted.mT @ weighted
    return gram.mul_(mean)


def _whitening(gram: Tensor, limit: float) -> Tensor | None:
    """Return W, upper triangular, with ``W^T gram W = I``; None if that would lose accuracy.

    With R the Cholesky factor of the Gram matrix of unit columns, the squared Frobenius norm of
    R^-1 is at least 1 / (its lowest eigenvalue): by so much a rounding of the Gram matrix grows.
    The triangle keeps a first column that is the constant function the constant function.
    """
    scale = gram.diagonal().rsqrt()
    factor, info = torch.linalg.cholesky_ex(scale.unsqueeze(1) * gram * scale, upper=True)
    identity = torch.eye(len(gram), dtype=gram.dtype, device=gram.device)
    inverse = torch.linalg.solve_triangular(factor, identity, upper=True)
    good = (info == 0) & (inverse.square().sum() <= limit)
    return scale.unsqueeze(1) * inverse if bool(good) else None


def _resolved(gram: Tensor) -> Tensor:
    """Return W with ``W^T gram W = I`` on what of a semi-definite Gram matrix is not rounding."""
    sizes, axes = torch.linalg.eigh(gram)
    kept = sizes > _NOTHING * sizes[-1]
    whitening: Tensor = axes[:, kept] / sizes[kept].sqrt()
    return whitening


def _project(stiffness: Tensor, basis: Tensor, dtype: torch.dtype) -> Tensor:
    """Return ``F^T L F`` in float64, of which the lower triangle is computed.

    L F is always a float64 product, for in it the high frequencies of L cancel; what `dtype` rounds
    is the result.
    """
    m = basis.shape[1]
    projected = torch.zeros(m, m, dtype=torch.float64, device=basis.device)
    rows = _SINGLE_ROWS if dtype == torch.float32 else _ROWS
    for first in range(0, m, _COLUMNS):
        columns = slice(first, first + _COLUMNS)
        image = csr_product(stiffness, basis[:, columns], torch.float64).to(dtype)
        target = projected[first:, columns]
        for part, block in zip(
            torch.split(basis[:, first:], rows), torch.split(image, rows), strict=True
        ):
            target += part.to(dtype).mT @ block
    return projected.tril() + projected.tril(-1).mT


def _lift(projected: Tensor, whitening: Tensor, basis: Tensor, most: int) -> tuple[Tensor, Tensor]:
    """Solve the small problem; return its lowest values, and their vectors of n rows, float64."""
    small = whitening.mT @ projected @ whitening
    values, vectors = torch.linalg.eigh((small + small.mT) / 2)
    coefficients = whitening @ vectors[:, :most]
    lifted = torch.empty(
        len(basis), coefficients.shape[1], dtype=torch.float64, device=basis.device
    )
    for part, target in zip(torch.split(basis, _ROWS), torch.split(lifted, _ROWS), strict=True):
        torch.mm(part.double(), coefficients, out=target)
    return values[:most].clone(), lifted


def _multiply_rows(Q: Tensor, factor: Tensor) -> Tensor:
    """Return ``Q @ factor``, overwriting the leading columns of `Q` a block of rows at a time."""
    narrow = Q[:, : factor.shape[1]]
    for block, target in zip(torch.split(Q, _ROWS), torch.split(narrow, _ROWS), strict=True):
        target.copy_(block @ factor)
    return narrow
