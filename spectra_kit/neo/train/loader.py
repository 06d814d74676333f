"""Batches: the samples that a step asks for, in their pose and size, on the way to the device.

A batch follows from (seed, step) and the samples that there are, so that a run resumes exactly. One
is read and posed ahead, and samples stay on a device that has room for all.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from spectra_kit._core.threads import ranges
from spectra_kit.eigen.subspaces.frame import POSES, canonical_frame
from spectra_kit.neo.loss import Smoother
from spectra_kit.neo.train.config import TrainConfig
from spectra_kit.neo.train.corpus import Source
from spectra_kit.neo.train.samples import Samples

_FEW = 4  # samples at a time whose features fit a CPU's caches: a tenth quicker than sixteen
_ROOM = 0.5  # share of an accelerator's free memory that samples may fill
_Read = tuple[NDArray[np.int64], NDArray[np.int64], "Batch | None"]


class Batch(NamedTuple):
    """Samples as the network sees them, on its device; modes float16 where they are only kept."""

    points: Tensor  #: (b, n, 3)
    mass: Tensor  #: (b, n)
    modes: Tensor  #: (b, n, k)
    smoothers: tuple[Smoother, ...] = ()  #: one for each of the `parts`, where there are any

    def parts(self, count: int) -> Iterator[Batch]:
        """Return equal shares, one after the other."""
        for i, part in enumerate(_shares(len(self.points), count)):
            arrays = self.points[part], self.mass[part], self.modes[part]
            yield Batch(*arrays, self.smoothers[i : i + 1])

    def to(self, device: torch.device) -> Batch:
        """Return the same on a device."""
        return Batch(
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


class Loader:
    """Batches of a run on a device, by their steps.

    A thread reads and poses the samples of the next step while the device works on the last. On an
    accelerator with room for all that there may be, they stay in its memory, posed, in the
    precisions of the shards, and a batch of them is drawn there without a transfer; `resident`
    says whether, where that is not to be found out. Operators, for smoothing, are always read.
    `share` are the places of the batch that this process works on.

    PyTorch's DataLoader would do this in processes: they cannot send the sparse matrices that
    smoothing needs, and know nothing of what the device holds.
    """

    def __init__(
        self,
        source: Source,
        config: TrainConfig,
        device: torch.device,
        *,
        share: slice = slice(None),
        resident: bool | None = None,
    ) -> None:
        self._source, self._config, self._device, self._share = source, config, device, share
        self._thread = ThreadPoolExecutor(1)
        self._ahead: tuple[int, Future[_Read]] | None = None
        room, n, k = source.capacity, source.n_points, source.k
        if resident is None:
            need = room * n * (3 * 4 + 4 + 2 * k)
            room_for_all = device.type == "cuda" and not config.beta
            resident = room_for_all and need < _ROOM * torch.cuda.mem_get_info(device)[0]
        self._store = _Store(room, n, k, device) if resident else None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._thread.shutdown(cancel_futures=True)

    def __call__(self, step: int) -> Batch:
        """Return this process's share of the batch of a step."""
        ahead = self._ahead
        read = ahead[1] if ahead is not None and ahead[0] == step else self._begun(step)
        numbers, new, batch = read.result()
        batch = None if batch is None else batch.to(self._device)
        if self._store is not None:
            if batch is not None:
                self._store.add(new, batch)
            batch = self._store.batch(numbers)
        assert batch is not None  # without a store, all are read
        # What the next step shows and the device does not hold.
        self._ahead = step + 1, self._begun(step + 1)
        return vary(batch, self._config, step, self._share)

    def _begun(self, step: int) -> Future[_Read]:
        return self._thread.submit(self._read, step)

    def _read(self, step: int) -> _Read:
        """Return the numbers of the samples that a step shows, of those that are read, and these.

        Those alone are read that the device does not hold.
        """
        numbers, reader = self._source.draw(self._config, step)
        shown: Sequence[int] = range(len(numbers))[self._share]
        if self._store is not None:
            there = {int(numbers[i]): i for i in shown}
            shown = [i for number, i in there.items() if not self._store.has(number)]
        found = numbers[self._share], numbers[list(shown)]
        if not shown:
            return *found, None
        count = share_count(len(shown), self._config.workers, self._device)
        batch = posed(reader(shown), self._config, count if self._config.beta else 0)
        if self._device.type == "cuda":
            points, mass, modes = (part.pin_memory() for part in batch[:3])
            batch = Batch(points, mass, modes, batch.smoothers)
        return *found, batch


class _Store:
    """Room in the memory of a device for the posed samples that a source has at a time.

    A sample has its place by its number, which it takes from the one that has left the source.
    """

    def __init__(self, room: int, n: int, k: int, device: torch.device) -> None:
        self.parts = (
            torch.empty(room, n, 3, device=device),
            torch.empty(room, n, device=device),
            torch.empty(room, n, k, dtype=torch.float16, device=device),
        )
        self.held = np.full(room, -1)  # the number of the sample in each place

    def has(self, number: int) -> bool:
        """Whether the sample of this number is there."""
        return bool(self.held[number % len(self.held)] == number)

    def add(self, numbers: NDArray[np.int64], batch: Batch) -> None:
        """Take in samples."""
        places = numbers % len(self.held)
        self.held[places] = numbers
        for part, values in zip(self.parts, batch[:3], strict=True):
            part[torch.from_numpy(places)] = values

    def batch(self, numbers: NDArray[np.int64]) -> Batch:
        """Return the samples of these numbers."""
        places = torch.from_numpy(numbers % len(self.held)).to(self.parts[0].device)
        points, mass, modes = (part[places] for part in self.parts)
        return Batch(points, mass, modes)


def posed(samples: Samples, config: TrainConfig, parts: int = 1) -> Batch:
    """Return samples as tensors, the points posed, with the smoothers of so many `parts`.

    In the principal frame where the network expects it, else centred; modes stay float16. There
    are smoothers where the samples have operators, and `parts` is not 0.
    """
    points = np.empty_like(samples.points, dtype=np.float32)
    for out, x, w in zip(points, samples.points, samples.mass, strict=True):
        if config.network.frame == "principal":
            real = w > 0  # the rest is padding
            out[:] = canonical_frame(x[real], w[real]).pose(x)
        else:
            out[:] = x - (w.astype(np.float64) / w.sum(dtype=np.float64)) @ x
    mass, modes = np.ascontiguousarray(samples.mass), np.ascontiguousarray(samples.eigenvectors)
    shares = _shares(len(samples), parts) if parts and samples.has_operators else []
    return Batch(
        torch.from_numpy(points),
        torch.from_numpy(mass),
        torch.from_numpy(modes),
        tuple(_smoother(samples[share], config.smoothing) for share in shares),
    )


def _smoother(samples: Samples, degree: int) -> Smoother:
    L = [samples.stiffness(i) for i in range(len(samples))]
    values = samples.arrays()["eigenvalues"]
    return Smoother.of(L, samples.mass, values, samples.eigenvectors, degree=degree)


def vary(batch: Batch, config: TrainConfig, step: int, share: slice = slice(None)) -> Batch:
    """Return posed samples as a step shows them: turned and resized.

    All random numbers follow from (seed, step), the kind of device and the place in the batch, on
    one device or on several: `share` tells which places of the batch the samples are. Comes with
    points in [-1, 1]^3, and in float32.
    """
    points, device = batch.points, batch.points.device
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
    return _shown(batch, points)


def for_validation(batch: Batch, config: TrainConfig, first: int) -> Batch:
    """Return posed samples; without a canonical frame, turned the same way every time."""
    points = batch.points
    if config.network.frame == "none":
        rng = np.random.default_rng((config.seed, 2, first))
        quaternions = torch.from_numpy(rng.standard_normal((len(points), 4))).float()
        points = points @ random_rotations(quaternions).to(points.device)
        points = points / points.abs().amax((1, 2), keepdim=True)
    return _shown(batch, points)


def _shown(batch: Batch, points: Tensor) -> Batch:
    return Batch(points, batch.mass.float(), batch.modes.float(), batch.smoothers)


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
