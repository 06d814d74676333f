"""The way of samples to the device: posed one step ahead, and kept there where they fit."""

from __future__ import annotations

import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import NamedTuple, Self

import numpy as np
import torch
from numpy.typing import NDArray

from spectra_kit.errors import InvalidInputError
from spectra_kit.neo.train.batches import (
    Samples,
    chosen_samples,
    drawn_samples,
    posed,
    share_count,
    vary,
    window,
)
from spectra_kit.neo.train.config import TrainConfig
from spectra_kit.neo.train.shards import Corpus
from spectra_kit.neo.train.stream import SampleStream

_REFRESH = 1.0  # seconds between looks at a stream
_ROOM = 0.5  # share of an accelerator's free memory that samples may fill


class _Ahead(NamedTuple):
    """What is on its way for a step."""

    step: int
    keys: list[int]  # of the samples that the step shows
    new: list[int]  # of those that are read
    reading: Future[Samples | None]


class Feed:
    """Batches of a run, each following from (seed, step) and the samples there are.

    A thread reads and poses the samples of the next step while the device works on the last. On an
    accelerator with room for all that there may be, they stay in its memory, posed, in the
    precisions of the shards, and a batch of them is drawn there without a transfer; `resident`
    says whether, where that is not to be found out. Operators, for smoothing, are always read. A
    stream is looked at once a second; where the configuration says how often samples are shown, the
    thread waits for all that a step may show. `share` are the places of the batch that this process
    works on.
    """

    def __init__(
        self,
        source: Corpus | SampleStream,
        config: TrainConfig,
        device: torch.device,
        *,
        share: slice = slice(None),
        resident: bool | None = None,
    ) -> None:
        self._source, self._config, self._device, self._share = source, config, device, share
        self._paced = source if config.shown and isinstance(source, SampleStream) else None
        self._thread = ThreadPoolExecutor(1)
        self._ahead: _Ahead | None = None
        self._store: _Store | None = None
        if self._paced is not None:
            return
        self._look()
        room = len(self._corpus)
        if not isinstance(source, Corpus):
            room = max(room, source.capacity)
        n, k = self._corpus.n_points, self._corpus.k
        if resident is None:
            need = room * n * (3 * 4 + 4 + 2 * k)
            room_for_all = device.type == "cuda" and not config.beta
            resident = room_for_all and need < _ROOM * torch.cuda.mem_get_info(device)[0]
        if resident:
            self._store = _Store(room, n, k, device)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._thread.shutdown(cancel_futures=True)

    def __call__(self, step: int) -> Samples:
        """Return this process's share of the batch of a step."""
        there = self._ahead if self._ahead and self._ahead.step == step else self._begin(step)
        samples = there.reading.result()
        if samples is not None:
            samples = samples.to(self._device)
        if self._store is not None:
            if samples is not None:
                self._store.add(there.new, samples)
            samples = self._store.batch(there.keys)
        assert samples is not None  # without a store, all are read
        self._ahead = self._begin(step + 1)
        return vary(samples, self._config, step, self._share)

    def _look(self) -> None:
        self._corpus = self._source if isinstance(self._source, Corpus) else self._source.corpus()
        self._looked = time.monotonic()
        if not len(self._corpus):
            raise InvalidInputError(
                "source", "have a sample to begin with", "none", advice="wait with `stream.ready`"
            )
        # In a stream samples come and go, so their place says nothing; in shards, where folders
        # may be joined, the index is not unique.
        fixed = isinstance(self._source, Corpus)
        self._keys = np.arange(len(self._corpus)) if fixed else self._corpus.labels["index"]

    def _begin(self, step: int) -> _Ahead:
        """Have the thread read what a step shows and the device does not hold."""
        if self._paced is not None:
            return _Ahead(step, [], [], self._thread.submit(self._awaited, self._paced, step))
        if not isinstance(self._source, Corpus) and time.monotonic() > self._looked + _REFRESH:
            self._look()
            if self._store is not None:
                self._store.keep(self._keys)
        chosen = chosen_samples(len(self._corpus), self._config, step)[self._share]
        new = keys = self._keys[chosen].tolist()
        if self._store is not None:
            places = {k: i for k, i in zip(keys, chosen, strict=True) if k not in self._store.slots}
            new, chosen = [*places], np.array([*places.values()], dtype=np.int64)
        reading = self._thread.submit(self._read, self._corpus, chosen)
        return _Ahead(step, keys, new, reading)

    def _awaited(self, stream: SampleStream, step: int) -> Samples | None:
        """Read what a step shows of a stream, when all that it may show is there."""
        first, stop = window(self._config, step, stream.capacity)
        numbers = drawn_samples(self._config, step, stream.capacity)[self._share]
        return self._read(stream.window(first, stop), numbers - first)

    def _read(self, corpus: Corpus, chosen: NDArray[np.int64]) -> Samples | None:
        if not len(chosen):
            return None
        batch = corpus.batch(chosen)
        if not self._config.beta:
            batch = replace(batch, operators=None)
        count = share_count(len(chosen), self._config.workers, self._device)
        samples = posed(batch, self._config, count)
        if self._device.type == "cuda":
            return samples._replace(
                **{
                    name: getattr(samples, name).pin_memory()
                    for name in ("points", "mass", "modes")
                }
            )
        return samples


class _Store:
    """Room in the memory of a device for so many posed samples, each under its key."""

    def __init__(self, room: int, n: int, k: int, device: torch.device) -> None:
        self.parts = (
            torch.empty(room, n, 3, device=device),
            torch.empty(room, n, device=device),
            torch.empty(room, n, k, dtype=torch.float16, device=device),
        )
        self.slots: dict[int, int] = {}  # key of a sample -> its place in the parts
        self.free = list(range(room))

    def keep(self, keys: NDArray[np.int64]) -> None:
        """Make room: forget the samples of other keys than these."""
        for key in self.slots.keys() - set(keys.tolist()):
            self.free.append(self.slots.pop(key))

    def add(self, keys: list[int], samples: Samples) -> None:
        """Take in samples under new keys."""
        slots = [self.free.pop() for _ in keys]
        self.slots |= zip(keys, slots, strict=True)
        for part, values in zip(self.parts, samples[:3], strict=True):
            part[torch.tensor(slots)] = values

    def batch(self, keys: list[int]) -> Samples:
        """Return the samples of these keys."""
        slots = torch.tensor([self.slots[key] for key in keys], device=self.parts[0].device)
        points, mass, modes = (part[slots] for part in self.parts)
        return Samples(points, mass, modes)
