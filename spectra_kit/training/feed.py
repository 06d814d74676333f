"""The way of samples to the device: posed when they are first shown, and kept where they fit."""

from __future__ import annotations

import time

import numpy as np
import torch
from numpy.typing import NDArray

from spectra_kit.errors import InvalidInputError
from spectra_kit.training.batches import Tensors, chosen_samples, posed, vary
from spectra_kit.training.config import TrainConfig
from spectra_kit.training.shards import Corpus
from spectra_kit.training.stream import SampleStream

_REFRESH = 1.0  # seconds between looks at a stream
_ROOM = 0.5  # share of an accelerator's free memory that samples may fill


class Feed:
    """Batches of a run, each following from (seed, step) and the samples there are.

    On an accelerator with room for all that there may be, samples stay in its memory, posed, in the
    precisions of the shards, and a batch of them is drawn there without a transfer.

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
        Keep samples on the device; by default on an accelerator with room for them.
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
        self._kept: dict[int, Tensors] = {}  # by key
        self._look()
        room = len(self._corpus) if isinstance(source, Corpus) else source.capacity
        need = room * self._corpus.n_points * (3 * 4 + 4 + 2 * self._corpus.k)
        fits = device.type == "cuda" and need < _ROOM * torch.cuda.mem_get_info(device)[0]
        self._resident = fits if resident is None else resident

    def __call__(self, step: int) -> Tensors:
        """Return points (b, N, 3), mass (b, N) and modes (b, N, k) of this process's share."""
        if not isinstance(self._source, Corpus) and time.monotonic() > self._looked + _REFRESH:
            self._look()
        chosen = chosen_samples(len(self._corpus), self._config, step)[self._share]
        samples = self._recalled(chosen) if self._resident else self._read(chosen)
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
        there = set(self._keys.tolist())
        self._kept = {key: sample for key, sample in self._kept.items() if key in there}

    def _read(self, chosen: NDArray[np.int64]) -> Tensors:
        points, mass, modes = posed(self._corpus.batch(chosen), self._config)
        return points.to(self._device), mass.to(self._device), modes.to(self._device)

    def _recalled(self, chosen: NDArray[np.int64]) -> Tensors:
        """Return posed samples from the memory of the device, new ones after they came there."""
        keys = self._keys[chosen].tolist()
        places = {key: i for key, i in zip(keys, chosen, strict=True) if key not in self._kept}
        if places:
            fresh = self._read(np.array([*places.values()]))
            for key, *sample in zip(places, *fresh, strict=True):
                points, mass, modes = (part.clone() for part in sample)  # no view of all the fresh
                self._kept[key] = points, mass, modes
        points, mass, modes = map(torch.stack, zip(*(self._kept[key] for key in keys), strict=True))
        return points, mass, modes
