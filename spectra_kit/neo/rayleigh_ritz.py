"""Rayleigh-Ritz in torch, on CPU or CUDA: the twin of the NumPy solver of the same name."""

from __future__ import annotations

import time
import warnings
from typing import NamedTuple

import torch
from scipy import sparse
from torch import Tensor

from spectra_kit.errors import InvalidInputError

_ROWS = 65_536  # rows of a basis handled at once: bounds the temporaries, not the result
_COLUMNS = 32  # of L @ Y at once, for the same reason
_PASSES = 6  # three suffice down to rank_tol = 1e-14; more mean NaN
_SETTLED = 1e-13  # deviation of the Gram matrix from the identity that rounding alone leaves


class RitzPairs(NamedTuple):
    """The lowest eigenpairs inside a subspace.

    Attributes
    ----------
    eigenvalues : Tensor of shape (k,)
        Ascending, float64, in 1/length^2.
    eigenvectors : Tensor of shape (n, k)
        M-orthonormal, float64.
    seconds : dict of str to float
        ``orthonormalize``, ``project`` and ``eigh``.
    """

    eigenvalues: Tensor
    eigenvectors: Tensor
    seconds: dict[str, float]


def orthonormalize(basis: Tensor, mass: Tensor, *, rank_tol: float = 1e-10) -> Tensor:
    """Return an M-orthonormal basis of the numerical range of `basis`.

    Repeated Cholesky-QR in the eigenvector form (SVQB, Stathopoulos and Wu 2002): the long side
    sees only matrix products, all m x m algebra is float64. One Gram matrix of float64 resolves
    singular values down to 1e-8 of the largest, so smaller ones are first raised by a bounded
    factor and resolved in the next pass, until the Gram matrix is the identity. The accumulated
    triangle then holds the singular values of the columns, on which the cut is made.

    Parameters
    ----------
    basis : Tensor of shape (n, m)
        Columns, any precision; they may be dependent.
    mass : Tensor of shape (n,)
        Positive masses, in length^2.
    rank_tol : float, default 1e-10
        Directions whose singular value (columns scaled to unit M-norm) is below this share of the
        largest are dropped. The share is meaningful down to about 1e-14.

    Returns
    -------
    Tensor of shape (n, r)
        float64, r <= m.

    Raises
    ------
    InvalidInputError
        If `basis` holds NaN or infinite values, or only zeros.

    Examples
    --------
    >>> basis = torch.tensor([[1.0, 2.0, 0.0], [1.0, 2.0, 1.0]])
    >>> orthonormalize(basis, torch.ones(2)).shape
    torch.Size([2, 2])
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
            "`basis` must have finite columns that are not all zero, got"
            f" {int((~norms.isfinite()).sum())} columns with NaN or infinite values of"
            f" {len(norms)}; in half precision try float32"
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
    stiffness: Tensor, mass: Tensor, basis: Tensor, k: int, *, rank_tol: float = 1e-10
) -> RitzPairs:
    """Return the k lowest Ritz pairs of L u = lambda M u in the span of `basis`.

    NEO paper, Eqs. "m_qr", "project_operators" and "uplift": Y M-orthonormal,
    ``L^ = Y^T L Y``, ``L^ v = lambda v``, ``u = Y v``.

    Parameters
    ----------
    stiffness : sparse CSR Tensor of shape (n, n)
        L, symmetric and positive semi-definite, float64; see `sparse_tensor`.
    mass : Tensor of shape (n,)
        Diagonal of M, in length^2.
    basis : Tensor of shape (n, m)
        Any precision, any scale, dependent columns allowed.
    k : int
        Pairs to return.
    rank_tol : float, default 1e-10
        See `orthonormalize`.

    Returns
    -------
    RitzPairs
        Every Ritz value is at least the true eigenvalue of the same number.

    Raises
    ------
    InvalidInputError
        If the numerical rank of the basis is below k, or it holds NaN.

    Examples
    --------
    >>> path = sparse.csr_array([[1.0, -1, 0], [-1, 2, -1], [0, -1, 1]])
    >>> pairs = rayleigh_ritz(sparse_tensor(path), torch.ones(3), torch.eye(3), 2)
    >>> pairs.eigenvalues.abs()
    tensor([0.0, 1.0], dtype=torch.float64)
    """
    clock = Clock(basis.device)
    Y = orthonormalize(basis, mass, rank_tol=rank_tol)
    if Y.shape[1] < k:
        raise InvalidInputError(
            f"`basis` must span at least k = {k} dimensions, got numerical rank {Y.shape[1]} of"
            f" {basis.shape[1]} columns; ask for fewer modes or join more functions"
        )
    clock.stage("orthonormalize")
    projected = torch.cat(
        [Y.mT @ (stiffness @ part) for part in torch.split(Y, _COLUMNS, 1)], dim=1
    )
    clock.stage("project")
    values, vectors = torch.linalg.eigh((projected + projected.mT) / 2)
    eigenvectors = _multiply_rows(Y, vectors[:, :k])
    clock.stage("eigh")
    return RitzPairs(values[:k].clone(), eigenvectors, clock.seconds)


def sparse_tensor(csr: sparse.csr_array, device: str = "cpu") -> Tensor:
    """Return a SciPy array as a float64 sparse CSR tensor.

    Parameters
    ----------
    csr : csr_array of shape (n, n)
        For instance ``laplacian.stiffness``.
    device : str, default "cpu"
        Where to put it.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sparse CSR tensor support is in beta")
        return torch.sparse_csr_tensor(
            torch.tensor(csr.indptr),
            torch.tensor(csr.indices),
            torch.tensor(csr.data, dtype=torch.float64),
            size=csr.shape,
            device=device,
            check_invariants=False,  # SciPy's arrays keep them
        )


class Clock:
    """Wall time by stage; waits for CUDA, which otherwise works on after a call returns."""

    def __init__(self, device: torch.device) -> None:
        self.device, self.seconds = device, dict[str, float]()
        self._last = self._now()

    def stage(self, name: str) -> None:
        """Book the time since the last stage under `name`."""
        now = self._now()
        self.seconds[name] = now - self._last
        self._last = now

    def _now(self) -> float:
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
        return time.perf_counter()


def _multiply_rows(Q: Tensor, factor: Tensor) -> Tensor:
    """Return ``Q @ factor``, overwriting the leading columns of `Q` a block of rows at a time."""
    narrow = Q[:, : factor.shape[1]]
    for block, target in zip(torch.split(Q, _ROWS), torch.split(narrow, _ROWS), strict=True):
        target.copy_(block @ factor)
    return narrow
