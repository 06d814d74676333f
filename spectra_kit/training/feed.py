"""The way of samples to the device: kept there where they fit, else fetched one step ahead."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Self

import numpy as np
import torch
from numpy.typing import NDArray

from spectra_kit.errors import InvalidInputError
from spectra_kit.training.batches import Tensors, chosen_samples, posed, vary
from spectra_kit.training.config import TrainConfig
from spectra_kit.training.shards import Corpus
from spectra_kit.training.stream import SampleStream

_REFRESH = 1.0  # seconds between looks at a stream
_CHUNK = 64  # samples on their way at a time
_ROOM = 0.5  # share of an accelerator's free memory that samples may fill


def join(corpora: Sequence[Corpus]) -> Corpus:
    """Return the samples of several corpora as one; a corpus given twice counts twice.

    Parameters
    ----------
    corpora : sequence of Corpus
        With equal numbers of points and modes per sample.

    Returns
    -------
    Corpus
        With the labels that all of them have.

    Raises
    ------
    InvalidInputError
        If there is none, or sizes differ.
    """
    sizes = {(corpus.n_points, corpus.k) for corpus in corpora}
    if len(sizes) != 1:
        raise InvalidInputError(
            "corpora",
            "have the same (points, modes) per sample",
            sorted(sizes),
            advice="train on one size at a time",
        )
    common = set.intersection(*(set(corpus.labels) for corpus in corpora))
    return Corpus(
        tuple(shard for corpus in corpora for shard in corpus.shards),
        {name: np.concatenate([c.labels[name] for c in corpora]) for name in sorted(common)},
    )


class Feed:
    """Batches of a run, each following from (seed, step) and the samples there are.

    On an accelerator with room for all that there may be, samples lie in its memory, posed, in the
    precisions of the shards, and a batch is drawn there without a transfer. Otherwise a thread
    reads and poses the samples of the next step while the device works on the last.

    Parameters
    ----------
    source : Corpus or SampleStream
        Where samples come from; a stream is looked at once a second.
    config : TrainConfig
        The run.
    device : torch.device
        Where batches are wanted.
    share : slice
        Places of the batch that this process works on.
    resident : bool, optional
        Keep all samples on the device; by default on an accelerator with room for them.

    Raises
    ------
    InvalidInputError
        If there is no sample.
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
        self._look()
        room = len(self._corpus)
        if not isinstance(source, Corpus):
            room = max(room, source.capacity)
        if resident is None:
            need = room * _bytes(self._corpus)
            resident = device.type != "cpu" and need < _ROOM * _free(device)
        self._store = _Store(config, device, self._corpus, room) if resident else None
        if self._store is not None:
            self._store.update(self._corpus, self._keys())
        self._thread = ThreadPoolExecutor(1)
        self._ahead: tuple[int, Future[Tensors]] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._thread.shutdown(cancel_futures=True)

    def __call__(self, step: int) -> Tensors:
        """Return points (b, N, 3), mass (b, N) and modes (b, N, k) of this process's share."""
        if not isinstance(self._source, Corpus) and time.monotonic() > self._looked + _REFRESH:
            self._look()
            if self._store is not None:
                self._store.update(self._corpus, self._keys())
        if self._store is not None:
            samples = self._store.batch(self._chosen(step))
        else:
            there = self._ahead if self._ahead and self._ahead[0] == step else self._fetch(step)
            samples = there[1].result()
            self._ahead = self._fetch(step + 1)
            points, mass, modes = (part.to(self._device, non_blocking=True) for part in samples)
            samples = points, mass, modes
        return vary(samples, self._config, step, self._share)

    def _look(self) -> None:
        self._corpus = self._source if isinstance(self._source, Corpus) else self._source.corpus()
        self._looked = time.monotonic()
        if not len(self._corpus):
            raise InvalidInputError(
                "source", "have a sample to begin with", "none", advice="wait with `stream.ready`"
            )

    def _keys(self) -> NDArray[np.int64]:
        # In a stream samples come and go, so their place says nothing; in shards, where folders
        # may be joined, the index is not unique.
        if isinstance(self._source, Corpus):
            return np.arange(len(self._corpus))
        return self._corpus.labels["index"]

    def _chosen(self, step: int) -> NDArray[np.int64]:
        return chosen_samples(len(self._corpus), self._config, step)[self._share]

    def _fetch(self, step: int) -> tuple[int, Future[Tensors]]:
        corpus, chosen = self._corpus, self._chosen(step)

        def work() -> Tensors:
            points, mass, modes = posed(corpus.batch(chosen), self._config)
            if self._device.type == "cuda":
                return points.pin_memory(), mass.pin_memory(), modes.pin_memory()
            return points, mass, modes

        return step, self._thread.submit(work)


class _Store:
    """Posed samples in the memory of a device; each is there under a key and moves no more."""

    def __init__(self, config: TrainConfig, device: torch.device, like: Corpus, room: int) -> None:
        self.config, self.device = config, device
        n, k = like.n_points, like.k
        shapes = (
            ((room, n, 3), torch.float32),
            ((room, n), torch.float32),
            ((room, n, k), torch.float16),
        )
        points, mass, modes = (torch.empty(s, dtype=t, device=device) for s, t in shapes)
        self.parts: Tensors = points, mass, modes
        self.slots: dict[int, int] = {}  # key of a sample -> its place in the parts
        self.order: NDArray[np.int64] = np.empty(0, dtype=np.int64)  # places, as in the corpus

    def update(self, corpus: Corpus, keys: NDArray[np.int64]) -> None:
        """Take over what `corpus` has that is not here, in the room of what it has no more."""
        kept = {int(key) for key in keys}
        self.slots = {key: slot for key, slot in self.slots.items() if key in kept}
        new = [place for place, key in enumerate(keys) if int(key) not in self.slots]
        free = sorted(set(range(len(self.parts[0]))) - set(self.slots.values()))[: len(new)]
        for i in range(0, len(new), _CHUNK):
            chosen, slots = new[i : i + _CHUNK], free[i : i + _CHUNK]
            fresh = posed(corpus.batch(chosen), self.config)
            for part, values in zip(self.parts, fresh, strict=True):
                part[torch.tensor(slots)] = values.to(self.device)
            self.slots |= {
                int(keys[place]): slot for place, slot in zip(chosen, slots, strict=True)
            }
        self.order = np.array([self.slots[int(key)] for key in keys], dtype=np.int64)

    def batch(self, chosen: NDArray[np.int64]) -> Tensors:
        """Return the posed samples `chosen`, numbered as in the corpus."""
        places = torch.from_numpy(self.order[chosen]).to(self.device)
        points, mass, modes = (part[places] for part in self.parts)
        return points, mass, modes


def _bytes(corpus: Corpus) -> int:
    """Return what a sample takes in the memory of a device."""
    return corpus.n_points * (3 * 4 + 4 + 2 * corpus.k)


def _free(device: torch.device) -> int:
    return int(torch.cuda.mem_get_info(device)[0]) if device.type == "cuda" else 0
