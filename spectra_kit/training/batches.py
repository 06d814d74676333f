"""Batches: samples of a corpus in the pose, size and number of points that a step asks for."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from spectra_kit.subspaces.frame import POSES, canonical_frame
from spectra_kit.training.config import TrainConfig
from spectra_kit.training.shards import Batch

Tensors = tuple[Tensor, Tensor, Tensor]


def chosen_samples(n: int, config: TrainConfig, step: int) -> NDArray[np.int64]:
    """Return which of n samples a step shows, shape (batch,).

    Every sample comes once per epoch, in an order drawn from (seed, epoch), as long as n stays
    the same; in a stream, whose n grows, some come again earlier and some later.
    """
    places = np.arange(step * config.batch, (step + 1) * config.batch)
    orders = {
        int(epoch): np.random.default_rng((config.seed, 0, int(epoch))).permutation(n)
        for epoch in np.unique(places // n)
    }
    return np.array([orders[int(place // n)][place % n] for place in places])


def posed(batch: Batch, config: TrainConfig) -> Tensors:
    """Return points (b, n, 3), mass (b, n) and modes (b, n, k) as tensors, the points posed.

    In the principal frame where the network expects it, else centred; modes stay float16.
    """
    points = np.empty_like(batch.points, dtype=np.float32)
    for out, x, w in zip(points, batch.points, batch.mass, strict=True):
        if config.network.frame == "principal":
            out[:] = canonical_frame(x, w).pose(x)
        else:
            out[:] = x - (w.astype(np.float64) / w.sum(dtype=np.float64)) @ x
    mass, modes = np.ascontiguousarray(batch.mass), np.ascontiguousarray(batch.eigenvectors)
    return torch.from_numpy(points), torch.from_numpy(mass), torch.from_numpy(modes)


def vary(samples: Tensors, config: TrainConfig, step: int, share: slice = slice(None)) -> Tensors:
    """Return posed samples as a step shows them: turned, resized, and some of their points.

    All random numbers follow from (seed, step), the kind of device and the place in the batch, on
    one device or on several: `share` tells which places of the batch the samples are. Comes as
    points (b, N, 3) in [-1, 1]^3, mass (b, N) and modes (b, N, k), float32.
    """
    points, mass, modes = samples
    n, device = points.shape[1], points.device
    seed = np.random.SeedSequence((config.seed, 1, step)).generate_state(1, np.uint64)[0]
    generator = torch.Generator(device).manual_seed(int(seed >> np.uint64(1)))

    def normal(*shape: int) -> Tensor:
        return torch.randn(config.batch, *shape, generator=generator, device=device)[share]

    def uniform(*shape: int) -> Tensor:
        return torch.rand(config.batch, *shape, generator=generator, device=device)[share]

    if config.network.frame == "principal":
        flip = torch.where(uniform() < config.flips, (4 * uniform()).long(), 0)
        poses = torch.from_numpy(POSES.astype(np.float32)).to(device)
        points = (points * poses[flip, None]) @ rotations(config.jitter * normal(3))
        size = 1 - config.jitter * uniform()
    else:
        points, size = points @ random_rotations(normal(4)), torch.ones(len(points), device=device)
    points = points * (size / points.abs().amax((1, 2)))[:, None, None]
    if config.points < n:
        keep = uniform(n).topk(config.points, dim=1, sorted=False).indices[..., None]
        points = points.gather(1, keep.expand(-1, -1, 3))
        mass = mass.gather(1, keep[..., 0])
        modes = modes.gather(1, keep.expand(-1, -1, modes.shape[-1]))
    return points, mass.float(), modes.float()


def for_validation(samples: Tensors, config: TrainConfig, first: int) -> Tensors:
    """Return whole posed samples; without a canonical frame, turned the same way every time."""
    points, mass, modes = samples
    if config.network.frame == "none":
        rng = np.random.default_rng((config.seed, 2, first))
        quaternions = torch.from_numpy(rng.standard_normal((len(points), 4))).float()
        points = points @ random_rotations(quaternions).to(points.device)
        points = points / points.abs().amax((1, 2), keepdim=True)
    return points, mass.float(), modes.float()


def rotations(vectors: Tensor) -> Tensor:
    """Return rotations (b, 3, 3) about `vectors` (b, 3), by their length in radians."""
    axes = torch.eye(3, device=vectors.device).expand(len(vectors), 3, 3)
    turned: Tensor = torch.linalg.matrix_exp(torch.linalg.cross(vectors[:, None], axes).mT)
    return turned


def random_rotations(normals: Tensor) -> Tensor:
    """Return rotations (b, 3, 3), uniform on SO(3) for normal (b, 4) (Shoemake 1992)."""
    w, x, y, z = torch.nn.functional.normalize(normals, dim=-1).unbind(-1)
    rows = [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]
    return torch.stack(rows, -1).view(-1, 3, 3)
