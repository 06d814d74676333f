"""Many operators at once on a device: Ritz pairs of predicted functions, smoothed as one batch.

What `ritz_pairs` and `prolonged` do to one block of columns, for clouds of similar size side by
side: their matrices are the blocks of one, their columns are padded by rows without mass. Neither
launches nor waits for the device grow with their number. Where a Gram matrix is not clearly well
conditioned, or a Ritz value rises, an operator is left to those who take one after the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import sparse
from torch import Tensor

from spectra_kit._core.clock import Clock
from spectra_kit._sparse.batched_eigh import eigh
from spectra_kit._sparse.torch_device import csr_like, csr_product, csr_tensor
from spectra_kit.eigen.multigrid import estimates, smoothing
from spectra_kit.eigen.multigrid.cascade import _MORE, _ROUNDING, _SURE, Smoothed
from spectra_kit.operators.laplacian import Laplacian

_CUT = 1e-12  # lowest eigenvalue of a scaled Gram matrix that hides nothing, as `ritz_pairs` has it
_SPREAD = 1e-3  # the same, of corrected modes, as `ritz_rotation` has it


class Batch(NamedTuple):
    """Operators side by side, b of at most N points each."""

    stiffness: Tensor  # (b N, b N) sparse: their matrices, one after the other
    singles: Tensor  # the same in float32
    mass: Tensor  # (b, N, 1): 0 beyond their points, as is the diagonal
    diagonal: Tensor  # (b, N, 1): preconditioner
    inverse: Tensor  # the same, float32
    highest: Tensor  # (b, 1) of ``diagonal^-1 L``
    spacing: Tensor  # (b, 1) of eigenvalues

    @classmethod
    def of(cls, laplacians: Sequence[Laplacian], device: str) -> Batch:
        """Put operators together on a device."""
        b, most = len(laplacians), max(laplacian.n for laplacian in laplacians)
        masses, rows, columns = np.zeros((b, most)), [np.zeros(1, dtype=np.int64)], []
        for i, laplacian in enumerate(laplacians):
            L = laplacian.stiffness
            masses[i, : laplacian.n] = laplacian.mass
            ends = np.append(L.indptr[1:], np.full(most - laplacian.n, L.nnz))
            rows.append(ends + rows[-1][-1])
            columns.append(L.indices + i * most)
        values = np.concatenate([laplacian.stiffness.data for laplacian in laplacians])
        arrays = values, np.concatenate(columns), np.concatenate(rows)
        whole = sparse.csr_array(arrays, shape=(b * most, b * most))
        stiffness = csr_tensor(whole, device=device)
        mass = torch.from_numpy(masses).to(device)
        spacing = [laplacian.eigenvalue_spacing for laplacian in laplacians]
        diagonal, highest = _preconditioner(stiffness, mass)
        return cls(
            stiffness=stiffness,
            singles=csr_like(stiffness, stiffness.values().float()),
            mass=mass.unsqueeze(2),
            diagonal=diagonal.unsqueeze(2),
            inverse=torch.where(diagonal > 0, 1 / diagonal, 0.0).float().unsqueeze(2),
            highest=highest,
            spacing=torch.tensor(spacing, dtype=mass.dtype, device=device).unsqueeze(1),
        )

    def product(self, Y: Tensor) -> Tensor:
        """Return ``L Y`` of columns (b, N, c), in their precision."""
        matrix = self.stiffness if Y.dtype == torch.float64 else self.singles
        return csr_product(matrix, Y.reshape(-1, Y.shape[-1]), Y.dtype).reshape(Y.shape)

    def gram(self, Y: Tensor) -> Tensor:
        """Return ``Y^T M Y``, (b, c, c)."""
        return (self.mass * Y).mT @ Y

    def residual(self, values: Tensor, U: Tensor) -> Tensor:
        """Return ``L U - M U diag(values)``."""
        return self.product(U) - self.mass * U * values.unsqueeze(1)

    def energies(self, Y: Tensor) -> Tensor:
        """Return the diagonal of ``Y^T D Y``, (b, c), with the preconditioner D."""
        return (self.diagonal * Y.square()).sum(1)

    def ritz(self, Y: Tensor, keep: int, lowest: float) -> tuple[Tensor, Tensor, Tensor]:
        """Return the lowest Ritz values (b, keep) and vectors, and whose columns are fit for it.

        Those whose Gram matrix, of unit columns, surely has no eigenvalue below `lowest`.
        """
        gram = self.gram(Y)
        scale = gram.diagonal(dim1=1, dim2=2).clamp(min=0).sqrt()
        scale = torch.where(scale.isfinite() & (scale > 0), scale, 1.0)
        eye = torch.eye(Y.shape[-1], dtype=Y.dtype, device=Y.device)
        factor, failed = torch.linalg.cholesky_ex(gram / scale[:, None] / scale[..., None])
        root = torch.linalg.solve_triangular(factor, eye, upper=False).mT  # W^T G W is one
        keep = min(keep, Y.shape[-1])
        fit = (failed == 0) & (root.square().sum((1, 2)) < 1 / lowest)
        whitener = torch.where(fit[:, None, None], root / scale[..., None], eye)
        inside = whitener.mT @ (Y.mT @ self.product(Y)) @ whitener
        fit &= inside.isfinite().all(2).all(1)
        inside = torch.where(fit[:, None, None], (inside + inside.mT) / 2, eye)
        values, rotation, right = eigh(inside, keep)
        U = Y @ (whitener @ rotation)
        # Rounding of the Gram matrix that is left: one step towards the orthonormal nearby.
        U = U @ (1.5 * eye[:keep, :keep] - 0.5 * self.gram(U))
        return values, U, fit & right

    def correction(
        self, residual: Tensor, values: Tensor, lowest: Tensor, degrees: Tensor
    ) -> Tensor:
        """Return c after Chebyshev steps of ``(L - lambda M) c = -residual``, float32.

        They damp what lies between `lowest` (b, c) of each column and the highest, with so many
        steps of each operator, (b, 1). See `_sparse.device.correction` and `chebyshev_steps`.
        """
        residual, mass, shifts = residual.float(), self.mass.float(), values.float().unsqueeze(1)
        centre, radius = (self.highest + lowest) / 2, (self.highest - lowest) / 2
        ratio = radius / centre
        kept, step = torch.zeros_like(ratio), 1 / centre
        direction, found = torch.zeros_like(residual), torch.zeros_like(residual)
        for i in range(int(degrees.max())):
            image = residual
            if i:
                image = residual + self.product(found) - mass * found * shifts
            goes = (i < degrees).to(step)
            direction = (goes * kept).float().unsqueeze(1) * direction - (
                self.inverse * (goes * step).float().unsqueeze(1) * image
            )
            found = found + direction
            following = 1 / (2 * centre / radius - ratio)
            kept, step, ratio = ratio * following, 2 * following / radius, following
        return torch.where(found.isfinite().all(1, keepdim=True), found, 0.0)


def _preconditioner(stiffness: Tensor, mass: Tensor) -> tuple[Tensor, Tensor]:
    """Return diagonals (b, N) and bounds (b, 1): `smoothing.preconditioner`, batched."""
    sizes, columns, values = (
        stiffness.crow_indices().diff(),
        stiffness.col_indices(),
        stiffness.values(),
    )
    places = torch.arange(len(sizes), device=mass.device)
    on = torch.repeat_interleave(places, sizes, output_size=len(values)) == columns
    ones = torch.ones_like(mass).reshape(-1, 1)
    diagonal, sums = (
        csr_product(csr_like(stiffness, some), ones, ones.dtype).reshape(mass.shape)
        for some in (torch.where(on, values, 0.0), values.abs())
    )
    held = mass > 0

    def median(of: Tensor) -> Tensor:
        return torch.where(held, of, torch.nan).nanquantile(0.5, dim=1, keepdim=True)

    diagonal = torch.maximum(diagonal, smoothing._FLOOR * median(diagonal))
    diagonal = diagonal + smoothing._MASS * median(diagonal / mass) * mass
    highest = torch.where(held, sums / diagonal, 0.0).amax(1, keepdim=True)
    return torch.where(held, diagonal, 0.0), highest


def predicted_and_smoothed(
    laplacians: Sequence[Laplacian],
    basis: Tensor,
    k: int,
    *,
    keep: int,
    target: float,
    max_steps: int,
    rank_tol: float = 0.0,
    clock: Clock,
) -> list[Smoothed | None]:
    """Return what `prolonged` reaches from the Ritz pairs of predicted functions, of each operator.

    Nothing of one that is to be solved on its own. The basis, (b, N, m), is padded; what is found,
    k vectors of each, are arrays.
    """
    batch = Batch.of(laplacians, str(basis.device))
    values, U, fit = batch.ritz(basis.double(), keep, max(_CUT, rank_tol**2))
    clock.stage("coarse")
    residual = batch.residual(values, U)
    clock.stage("smooth")
    ends: list[Smoothed | None] = [None] * len(laplacians)
    open_ = fit.nonzero()[:, 0].tolist()
    if not max_steps:
        unknown = torch.full_like(values[:, :k], torch.inf)
        _end(ends, laplacians, open_, open_, (values, U[..., :k], unknown), 0)
        return ends
    chosen, off = open_, None
    met = spared = torch.zeros_like(batch.highest, dtype=torch.bool)  # see `prolonged`
    for step in range(1, max_steps + 1):
        if not len(open_):
            break
        if len(chosen) < len(batch.mass):
            batch = Batch.of([laplacians[i] for i in open_], str(basis.device))
            rows = batch.mass.shape[1]
            values, U, residual = values[chosen], U[chosen, :rows], residual[chosen, :rows]
            off = None if off is None else off[chosen]
            met, spared = met[chosen], spared[chosen]
        sparing = met & ~spared
        spared = spared | sparing
        goal = torch.where(sparing, target / _SURE, target / (_SURE * _MORE))
        before, c = values, _smoothing(batch, values, U, residual, k, off, goal, sparing)
        clock.stage("smooth")
        values, U, fit = batch.ritz(U + c, keep, _SPREAD)
        rises = values[:, :k] > before[:, :k] + _ROUNDING * before[:, -1:]
        clock.stage("rayleigh_ritz")
        residual = batch.residual(values, U)
        least = torch.maximum(values, batch.spacing)[:, :k]
        falls = (before - values)[:, :k].clamp(min=0)
        excess = _excess(batch, values, U, residual, falls)
        off = excess / least
        left = values[:, :k] - excess
        sorts = left.sort(1).values
        errors = torch.where(sorts == left, excess, values[:, :k] - sorts) / least
        mean = errors.mean(1, keepdim=True)
        met, done = mean <= target, (mean[:, 0] <= target / _SURE) | (step == max_steps)
        fit &= ~rises.any(1)
        state = (fit.int() + (fit & done).int()).tolist()  # left to others, going on, ended
        ended, chosen = ([j for j, what in enumerate(state) if what == its] for its in (2, 1))
        own = [open_[j] for j in ended]
        _end(ends, laplacians, own, ended, (values, U[..., :k], errors), step)
        open_ = [open_[j] for j in chosen]
        clock.stage("smooth")
    return ends


def _end(
    ends: list[Smoothed | None],
    laplacians: Sequence[Laplacian],
    which: Sequence[int],
    rows: Sequence[int],
    found: tuple[Tensor, ...],
    steps: int,
) -> None:
    """Bring what was found of some operators, in these rows of a batch, to the host at once."""
    U = _on_host(found[1][rows])
    values, errors = (part[rows].cpu().numpy() for part in found[::2])
    for j, i in enumerate(which):
        ends[i] = Smoothed(values[j], U[j, : laplacians[i].n], errors[j], steps)


def _on_host(tensor: Tensor) -> NDArray[np.float64]:
    """Return a copy on the host, of CUDA's in memory that its copies are quick to, and rare."""
    if tensor.device.type != "cuda":
        return np.asarray(tensor.cpu().numpy())
    there = torch.empty(tensor.shape, dtype=tensor.dtype, pin_memory=True)
    return np.asarray(there.copy_(tensor).numpy())


def _smoothing(
    batch: Batch,
    values: Tensor,
    U: Tensor,
    residual: Tensor,
    k: int,
    errors: Tensor | None,
    goal: Tensor,
    sparing: Tensor,
) -> Tensor:
    """Return what `Smoothing.smoothed` adds to the columns."""
    guards = max(1, values.shape[1] - k)
    last = slice(max(values.shape[1] - guards - 1, 0), None)
    energies = batch.energies(U[..., last])
    wanted, top = (values[:, last] / energies).max(1, keepdim=True)
    most = batch.highest / (1 + smoothing._REACH * smoothing._MOST**2)
    lowest = torch.maximum(wanted, most)
    steps = ((batch.highest / lowest - 1) / smoothing._REACH).sqrt()
    degrees = (steps - 1e-9).ceil()
    bottoms = lowest.expand(values.shape)
    if errors is not None:
        nearest = smoothing._NEAREST * lowest
        bottoms = bottoms - torch.minimum((values / energies.gather(1, top)).clamp(min=0), nearest)
        least, most = torch.where(sparing, 1.0, degrees), smoothing._LONGER * degrees
        degrees = _degrees(bottoms[:, :k], batch.highest, errors, goal, least, most)
    fills = lowest >= 0.9 * batch.highest  # the columns fill the space of the points
    degrees = torch.where(fills, 0.0, degrees)
    return batch.correction(residual, values, bottoms, degrees)


def _degrees(
    lowest: Tensor, highest: Tensor, errors: Tensor, goal: Tensor, least: Tensor, most: Tensor
) -> Tensor:
    """Return how many steps bring errors to the goal, (b, 1): `smoothing._degree`, batched."""
    apart = ((highest + lowest) / (highest - lowest)).acosh()  # (b, k)
    degrees = torch.arange(1, smoothing._LONGER * smoothing._MOST + 1, device=errors.device)
    left = (errors[:, None] / (degrees[None, :, None] * apart[:, None]).cosh() ** 2).mean(2)
    tried = (degrees >= least) & (degrees <= most)
    return torch.minimum(least + (tried & (left > goal)).sum(1, keepdim=True), most)


def _excess(batch: Batch, values: Tensor, U: Tensor, residual: Tensor, falls: Tensor) -> Tensor:
    """Estimate by how much the first k Ritz values are too high: `estimates.excess`, batched."""
    k, m = falls.shape[1], values.shape[1]
    first = int(k > estimates._COLUMNS)
    columns = np.linspace(first, k - 1, min(estimates._COLUMNS, k)).round().astype(int)
    known_at = torch.from_numpy(columns).to(U.device)
    last = slice(3 * m // 4, None)
    thetas = values[:, last] / batch.energies(U[..., last])
    share = estimates._LOWEST * thetas.quantile(0.5, dim=1, keepdim=True) / batch.highest
    share = share.clamp(1 / (estimates._REACH * estimates._MOST**2), estimates._WHOLE)
    degrees = ((1 / (estimates._REACH * share)).sqrt() - 1e-9).ceil()
    some = residual[..., known_at]
    lowest = (share * batch.highest).expand(-1, len(columns))
    c = batch.correction(some, torch.zeros_like(lowest), lowest, degrees).double()
    gain = -(some * c).sum(1).clamp(max=-estimates._TINY)
    nearness = values[:, known_at] * (batch.mass * c.square()).sum(1) / gain
    known = gain / (1 - nearness.clamp(0.0, estimates._NEAREST))
    if len(columns) == k:
        return known
    sizes = torch.where(batch.diagonal > 0, residual.square() / batch.diagonal, 0.0).sum(1)[:, :k]
    size, fall = (x.clamp(min=estimates._TINY).log() for x in (sizes, falls))
    ratio = size - fall
    within = ratio[:, known_at]
    apart = ratio.clamp(within.amin(1, keepdim=True), within.amax(1, keepdim=True))
    place = torch.arange(k, device=U.device).to(apart) / k
    features = torch.stack([torch.ones_like(apart), place.expand_as(apart), apart], dim=2)
    mean = (size + fall) / 2
    left = (known.log() - mean[:, known_at]).unsqueeze(2)
    chosen = features[:, known_at]
    weights = torch.linalg.pinv(chosen, rtol=1e-6) @ left
    rest = left - chosen @ weights
    freedom = len(columns) - features.shape[2]
    spread = ((rest - rest.mean(1, keepdim=True)).square().sum(1) / freedom).sqrt()
    found = (mean + (features @ weights).squeeze(2) + estimates._UNSURE * spread).exp()
    return torch.index_copy(found, 1, known_at, known)
