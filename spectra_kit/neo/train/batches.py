"""Batches: samples of a corpus in the pose and size that a step asks for."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from spectra_kit._core.threads import ranges
from spectra_kit.eigen.subspaces.frame import POSES, canonical_frame
from spectra_kit.neo.smoothing import Smoother
from spectra_kit.neo.train.config import TrainConfig
from spectra_kit.neo.train.shards import Batch

_BEGIN = 4  # batches of samples that a stream begins with
_FEW = 4  # samples at a time whose features fit a CPU's caches: a tenth quicker than sixteen


class Samples(NamedTuple):
    """Samples as the network sees them; modes float16 where they are only kept."""

    points: Tensor  #: (b, n, 3)
    mass: Tensor  #: (b, n)
    modes: Tensor  #: (b, n, k)
    smoothers: tuple[Smoother, ...] = ()  #: one for each of the `parts`, where there are any

    def parts(self, count: int) -> Iterator[Samples]:
        """Return equal shares, one after the other."""
        for i, part in enumerate(_shares(len(self.points), count)):
            arrays = self.points[part], self.mass[part], self.modes[part]
            yield Samples(*arrays, self.smoothers[i : i + 1])

    def to(self, device: torch.device) -> Samples:
        """Return the same on a device."""
        return Samples(
            self.points.to(device, non_blocking=True),
            self.mass.to(device, non_blocking=True),
            self.modes.to(device, non_blocking=True),
            tuple(smoother.to(device) for smoother in self.smoothers),
        )


def share_count(n: int, workers: int, device: torch.device) -> int:
    """Return in how many shares workers take on n samples: one each, or more of few on a CPU."""
    return workers * (-(-n // (_FEW * workers)) if device.type == "cpu" else 1)


def _shares(n: int, count: int) -> list[slice]:
    """Return the places of at most `count` equal shares of n samples."""
    return [slice(*places) for places in ranges(n, -(-n // count))]


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


def window(config: TrainConfig, step: int, capacity: int) -> tuple[int, int]:
    """Return of which samples of a stream a step shows some: from one number up to another.

    At most `capacity`; with every step, as many leave as each is shown ``config.shown`` times.
    """
    stop = min(capacity, _BEGIN * config.batch) + step * config.batch // config.shown
    return max(0, stop - capacity), stop


def drawn_samples(config: TrainConfig, step: int, capacity: int) -> NDArray[np.int64]:
    """Return the numbers of the samples of a stream that a step shows, shape (batch,)."""
    first, stop = window(config, step, capacity)
    rng = np.random.default_rng((config.seed, 0, step))
    return first + rng.choice(stop - first, config.batch, replace=stop - first < config.batch)


def posed(batch: Batch, config: TrainConfig, parts: int = 1) -> Samples:
    """Return samples as tensors, the points posed, with the smoothers of so many `parts`.

    In the principal frame where the network expects it, else centred; modes stay float16. There
    are smoothers where the samples have operators.
    """
    points = np.empty_like(batch.points, dtype=np.float32)
    for out, x, w in zip(points, batch.points, batch.mass, strict=True):
        if config.network.frame == "principal":
            real = w > 0  # the rest is padding
            out[:] = canonical_frame(x[real], w[real]).pose(x)
        else:
            out[:] = x - (w.astype(np.float64) / w.sum(dtype=np.float64)) @ x
    mass, modes = np.ascontiguousarray(batch.mass), np.ascontiguousarray(batch.eigenvectors)
    return Samples(
        torch.from_numpy(points),
        torch.from_numpy(mass),
        torch.from_numpy(modes),
        _smoothers(batch, config, parts),
    )


def _smoothers(batch: Batch, config: TrainConfig, parts: int) -> tuple[Smoother, ...]:
    if batch.operators is None:
        return ()
    shares = [batch[part] for part in _shares(len(batch.mass), parts)]
    return tuple(
        Smoother.of(
            [share.operators.stiffness(i) for i in range(len(share.mass))],
            share.mass,
            share.operators.eigenvalues,
            share.eigenvectors,
            degree=config.smoothing,
        )
        for share in shares
        if share.operators is not None
    )


def vary(samples: Samples, config: TrainConfig, step: int, share: slice = slice(None)) -> Samples:
    """Return posed samples as a step shows them: turned and resized.

    All random numbers follow from (seed, step), the kind of device and the place in the batch, on
    one device or on several: `share` tells which places of the batch the samples are. Comes with
    points in [-1, 1]^3, and in float32.
    """
    points, device = samples.points, samples.points.device
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
    return _shown(samples, points)


def for_validation(samples: Samples, config: TrainConfig, first: int) -> Samples:
    """Return posed samples; without a canonical frame, turned the same way every time."""
    points = samples.points
    if config.network.frame == "none":
        rng = np.random.default_rng((config.seed, 2, first))
        quaternions = torch.from_numpy(rng.standard_normal((len(points), 4))).float()
        points = points @ random_rotations(quaternions).to(points.device)
        points = points / points.abs().amax((1, 2), keepdim=True)
    return _shown(samples, points)


def _shown(samples: Samples, points: Tensor) -> Samples:
    return Samples(points, samples.mass.float(), samples.modes.float(), samples.smoothers)


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
