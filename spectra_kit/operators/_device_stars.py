"""The stars of many clouds at once, by torch on any device: what `local_delaunay` begins with.

Neither launches nor waits for the device grow with the number of clouds, but for blocks that bound
its memory.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import torch
from torch import Tensor

from spectra_kit._core.threads import ranges
from spectra_kit._core.types import Floats
from spectra_kit._sparse.blocks import device_memory
from spectra_kit.errors import OutOfMemoryError
from spectra_kit.operators._hulls import _PARALLEL, _STRAIGHT
from spectra_kit.operators._planes import _LINE, _THICK
from spectra_kit.operators.local_delaunay import _TIE, FirstStars, Stars, nearest_by_tree

_BLOCK = 16_384  # points
_ENTRIES = 1 << 24  # of the largest arrays, of which there are about eight at once: 1 GB
# Points of a cloud whose distances are all computed, work that grows with their square; they have
# names of so many bits. Neighbours of more are found by a tree, in the threads of the host.
_NAMES = 1 << 14
_SWEEPS = 5  # of rotations: 20,000 matrices of all kinds came to rounding in four


def first_stars(clouds: Sequence[Floats], k: int, device: str) -> list[FirstStars]:
    """Return what `local_delaunay.first_stars` does of each cloud, all of more than k points."""
    try:
        with device_memory():
            return list(_first_stars(clouds, k, torch.device(device)))
    except MemoryError as error:
        raise OutOfMemoryError(
            f"the neighbours of points take about 1 GB on {device!r}, more than is free ({error})",
            advice="free some of it, or leave out `device`",
        ) from error


def _first_stars(clouds: Sequence[Floats], k: int, device: torch.device) -> Iterator[FirstStars]:
    points = torch.from_numpy(np.concatenate(clouds)).to(device)
    near = _neighbors(clouds, k, device)
    first, last = ((points[near[:, j]] - points).square().sum(1).sqrt() for j in (0, -1))
    # Those of each cloud are the first of the largest: the same numbers as it has alone.
    most = max(map(len, clouds))
    draws = np.random.default_rng(0).random(most)
    drawn = torch.from_numpy(np.concatenate([draws[: len(cloud)] for cloud in clouds])).to(device)
    ties = _TIE * first.square() * drawn
    blocks = []
    for b in (slice(*cut) for cut in ranges(len(points), min(_BLOCK, max(1, _ENTRIES // k**2)))):
        offsets = points[near[b]] - points[b, None]
        squares = offsets.square().sum(2)
        u, v, lined = _tangents(offsets, squares)
        squares += ties[b, None] - ties[near[b]]
        x, y = ((offsets @ axis[:, :, None])[:, :, 0] / squares for axis in (u, v))
        places, sizes, closed = _hulls(x, y)
        links = near[b].gather(1, places)
        blocks.append(torch.column_stack([links, sizes, closed, lined]).int())
    found, far = torch.cat(blocks).cpu().numpy(), torch.stack([first, last]).cpu().numpy()
    end = 0
    for n in map(len, clouds):
        start, end = end, end + n
        own = found[start:end, :k]
        sizes, closed, lined = np.ascontiguousarray(found[start:end, k:].T)
        stars = Stars(np.arange(n), own - start, sizes, closed != 0, lined != 0)
        yield FirstStars(stars, *far[:, start:end])


def _neighbors(clouds: Sequence[Floats], k: int, device: torch.device) -> Tensor:
    """Return the k nearest of each point (p, k), as places in all clouds one after the other."""
    sizes = np.array([len(cloud) for cloud in clouds])
    starts, most = np.cumsum(sizes) - sizes, int(sizes.max())
    if most > _NAMES:
        trees = zip(clouds, starts, strict=True)
        found = np.concatenate([nearest_by_tree(cloud, k) + start for cloud, start in trees])
        return torch.from_numpy(found).to(device)
    padded = np.full((len(clouds), most, 3), np.inf)
    held = np.arange(most) < sizes[:, None]
    padded[held] = np.concatenate(clouds)
    there, before = torch.from_numpy(padded).to(device), torch.from_numpy(starts).to(device)
    names = torch.arange(most, device=device)
    parts = []
    for b in (slice(*cut) for cut in ranges(most, max(1, _ENTRIES // padded[:, :, 0].size))):
        x, y, z = (there[:, b, None, c] - there[:, None, :, c] for c in range(3))
        squares = x * x + y * y + z * z
        # Numbers that are not negative are in the order of their bits. The last of these make way,
        # rounded, for a name: of distances that are equal but for rounding the first comes first.
        keys = (squares.view(torch.int64) + _NAMES // 2) & -_NAMES | names
        own, *_ = keys.topk(k + 1, largest=False)
        parts.append(own[:, :, 1:] % _NAMES + before[:, None, None])
    rows = torch.from_numpy(np.flatnonzero(held)).to(device)
    return torch.cat(parts, 1).reshape(-1, k)[rows]


def _tangents(offsets: Tensor, squares: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return frames (p, 3) of planes, and which neighbours lie on lines: as on the host."""
    weights = (1 - squares / (1.001 * squares[:, -1:])).square()
    weighted = weights[:, :, None] * offsets
    sums = weighted.sum(1)
    moments = weighted.mT @ offsets
    moments -= sums[:, :, None] * sums[:, None] / (1 + weights.sum(1))[:, None, None]
    spreads, axes = _eigh(moments)
    normals, along = axes[:, :, 0], axes[:, :, 2]
    largest = normals.gather(1, normals.abs().argmax(1, keepdim=True))
    normals = normals * largest.sign()
    least, across, most = spreads.unbind(1)
    lined = (across - least < _LINE * most) & (across < _THICK * most)
    return along, torch.linalg.cross(normals, along), lined


def _eigh(matrices: Tensor) -> tuple[Tensor, Tensor]:
    """Return ascending eigenvalues (p, 3) of symmetric matrices, and vectors (p, 3, 3), by Jacobi.

    To rounding, as LAPACK does; a device takes one matrix after the other there.
    """
    eye = torch.eye(3, dtype=matrices.dtype, device=matrices.device)
    both = torch.cat([matrices, eye.expand_as(matrices)], 1)  # the matrix, and its vectors below
    A, V = both[:, :3], both[:, 3:]
    for i, j in _SWEEPS * ((0, 1), (0, 2), (1, 2)):
        apart, off = A[:, j, j] - A[:, i, i], 2 * A[:, i, j]
        tangent = off / (apart + torch.hypot(apart, off).copysign(apart))
        tangent = torch.where(off == 0, 0.0, tangent)[:, None]
        cosine = (1 + tangent.square()).rsqrt()
        sine = tangent * cosine
        for sides in (A, both.mT):  # rows, then columns
            one, other = sides[:, i].clone(), sides[:, j].clone()
            sides[:, i], sides[:, j] = cosine * one - sine * other, sine * one + cosine * other
    values, order = A.diagonal(dim1=1, dim2=2).sort(1)
    return values, V.gather(2, order[:, None].expand(-1, 3, -1))


def _hulls(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the hulls that `hulls` finds: places (p, k) of corners, how many, which are closed."""
    k = x.shape[1]
    width = x.abs() + y.abs()
    steep = torch.where(width > 0, y / width, 0.0)
    angle, order = torch.where(x >= 0, steep, 2 - steep).sort(dim=1, stable=True)
    gaps = angle.diff(dim=1, append=angle[:, :1] + 4)
    closed = gaps.amax(1) < 2 - _STRAIGHT
    far = x.gather(1, order).square() + y.gather(1, order).square()
    begin = torch.where(closed, far.argmax(1), gaps.argmax(1) + 1)
    turn = torch.arange(k, device=x.device)
    order = order.gather(1, (begin[:, None] + turn) % k)
    x, y = x.gather(1, order), y.gather(1, order)
    far = x.square() + y.square()
    # In coordinates along a point j and across, a line through j has all points i on the side of
    # the origin if its slope is above those to points on the left, and below those on the right.
    xj, yj, xi, yi = x[:, :, None], y[:, :, None], x[:, None], y[:, None]
    along, across = xj * (xi - xj) + yj * (yi - yj), xj * (yi - yj) - yj * (xi - xj)
    same = across.abs() <= _PARALLEL * (along + far[:, :, None])
    farther = far[:, None] > far[:, :, None]
    farther |= (far[:, None] == far[:, :, None]) & (turn < turn[:, None])
    slope = along / across
    left = torch.where((across > 0) & ~same, slope, -torch.inf).amax(2)
    right = torch.where((across < 0) & ~same, slope, torch.inf).amin(2)
    corner = (left < right) & ~(same & farther).any(2)
    sizes = corner.sum(1)
    first = (~corner).byte().argsort(dim=1, stable=True)  # the corners, in their order
    return order.gather(1, first), torch.where(sizes > 1, sizes, 0), closed
