"""Samples made while they are needed: processes fill a bounded buffer that training reads.

So an accelerator neither waits for a corpus nor needs gigabytes of files.
"""

from __future__ import annotations

import math
import os
import shutil
import threading
import time
from collections import deque
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from itertools import count as count_from
from itertools import islice
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.validate import check_count
from spectra_kit._core.warn import warn
from spectra_kit.errors import InvalidInputError, SpectraKitWarning
from spectra_kit.neo.train.config import TrainConfig
from spectra_kit.neo.train.corpus import (
    Corpus,
    Reader,
    Source,
    claim,
    open_shards,
    produced,
    shard_number,
    shuffled,
    write_shard,
)
from spectra_kit.neo.train.samples import CorpusConfig, Samples

_BEGIN = 4  # batches of samples that a run on a stream begins with
_PATIENCE = 60.0  # seconds that a run waits for more than one sample
_LOOK = 0.1  # seconds between looks of a reader that waits
_SPARE = 4  # shards before the last window that are kept: a run may go on from some steps before


class SampleStream(Source):
    """An endless corpus: sample `start`, `start` + 1, ... of a configuration, the newest at hand.

    Sample number i is the one that `make_sample` makes. The buffer grows to `capacity`; then the
    oldest samples make room. Reading waits for nothing. With `ahead`, samples are made as they are
    asked for, by `window`, which waits for them.

    Parameters
    ----------
    config : CorpusConfig
        What the samples are made of.
    workers : int
        Processes that make them, each of one thread.
    capacity : int
        Samples to hold; one of 2,048 points and 96 modes takes 0.5 MB.
    start : int, default 0
        Number of the first sample. With a `folder`, a multiple of the shard size.
    folder : path, optional
        Save whole shards there: those from `start` on that are there already fill the buffer at
        once, and the stream goes on behind the last. Without `keep` it is for nothing else: shards
        that are older than the last `capacity` samples are removed, and at first those that are not
        needed from `start` on, or come behind a gap.
    keep : bool, default False
        Remove no shard: the folder becomes a corpus, as of `generate`, and may be one already.
    ahead : int, optional
        Make at most about so many samples beyond the last `window`.

    Notes
    -----
    Use it in a ``with`` block: entering starts the processes, and leaving it ends them, also on
    Ctrl-C. They end by themselves if this process is killed. Scripts must guard their top level
    with ``if __name__ == "__main__"``, because the processes are spawned.

    Examples
    --------
    >>> from spectra_kit.neo.train.samples import CorpusConfig
    >>> from spectra_kit.neo.train.stream import SampleStream
    >>> config = CorpusConfig(seed=0, n_points=128, k=4)
    >>> with SampleStream(config, workers=1, capacity=64) as stream:
    ...     enough = stream.ready(3, timeout=60)
    ...     points = stream.corpus().batch([0, 2]).points
    >>> enough, points.shape
    (True, (2, 128, 3))
    """

    def __init__(
        self,
        config: CorpusConfig,
        *,
        workers: int,
        capacity: int,
        start: int = 0,
        folder: str | os.PathLike[str] | None = None,
        keep: bool = False,
        ahead: int | None = None,
    ) -> None:
        self._workers = check_count("workers", workers, low=1)
        self.capacity = check_count("capacity", capacity, low=1)
        self._start = self._next = check_count("start", start, low=0)
        if folder is not None and start % config.shard_size:
            raise InvalidInputError(
                "start",
                f"be a multiple of the shard size {config.shard_size} where shards are saved",
                start,
            )
        self._ahead = None if ahead is None else check_count("ahead", ahead, low=1)
        self._first = self._asked = start  # of the last window, and where it ends
        self.n_points, self.k, self.has_operators = config.n_points, config.k, True
        self._config, self._keep = config, keep
        self._folder = None if folder is None else Path(folder)
        self._samples: deque[Samples] = deque(maxlen=None if ahead is not None else capacity)
        self._unsaved: list[Samples] = []
        self._lock, self._stop = threading.Lock(), threading.Event()
        self._thread = ThreadPoolExecutor(1)
        self._collecting: Future[None] | None = None

    def __enter__(self) -> Self:
        if self._folder is not None:
            self._folder.mkdir(parents=True, exist_ok=True)
            claim(self._folder, self._config)
            if not self._keep:
                _mark(self._folder)
            self._load(self._folder)
        self._collecting = self._thread.submit(self._collect)
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the processes; what is in the buffer stays readable."""
        self._stop.set()
        self._thread.shutdown()

    @property
    def fewest(self) -> int:
        """Points of the smallest sample that may come."""
        return self._config.fewest

    @property
    def made(self) -> int:
        """Samples so far, those that made room included."""
        return self._next - self._start

    def identity(self, config: TrainConfig) -> dict[str, Any] | None:
        """See `Source`: something where it is said how often samples are shown."""
        if not config.shown:
            return None
        return {"capacity": self.capacity, "corpus": self._config.fingerprint()}

    def begin(self, config: TrainConfig) -> None:
        """Have more to show than the same few samples, where what is there is shown."""
        if not config.shown:
            most = self.capacity if self._ahead is None else min(self.capacity, self._ahead)
            self.ready(min(most, _BEGIN * config.batch), timeout=_PATIENCE)
            if not self.made and not self._stop.is_set():
                warn("waiting for the first sample", SpectraKitWarning)
                self.ready(1, timeout=math.inf)

    def draw(self, config: TrainConfig, step: int) -> tuple[NDArray[np.int64], Reader]:
        """See `Source`; waits for the samples where it is said how often each is shown."""
        if config.shown:
            first, stop = window(config, step, self.capacity)
            numbers = drawn(config, step, self.capacity)
            there = self.window(first, stop)
            return numbers, lambda places: there.batch(numbers[places] - first)
        self._check()
        with self._lock:
            n, stop = len(self._samples), self._next
            if not n:
                raise InvalidInputError(
                    "corpus", "have a sample to begin with", "none", advice="wait with `ready`"
                )
            chosen = shuffled(n, config, step)
            samples = [self._samples[i] for i in chosen]
        numbers = stop - n + chosen
        return numbers, lambda places: Samples.joined([samples[i] for i in places])

    def corpus(self) -> Corpus:
        """Return what is there now, one sample at least: samples that stay as they are."""
        self._check()
        with self._lock:
            return Corpus(self._samples)

    def window(self, first: int, stop: int) -> Corpus:
        """Wait for the samples from number `first` to `stop`, and return them, in this order.

        Those before are forgotten: windows move on. For streams with `ahead`.
        """
        if self._ahead is None or first < self._first or stop <= first:
            raise InvalidInputError(
                f"windows must move on, in a stream with `ahead`, got {first} to {stop} after one"
                f" from {self._first}, and ahead = {self._ahead}"
            )
        with self._lock:
            self._first, self._asked = first, max(self._asked, stop)
        if not self._came(stop, math.inf):
            raise InvalidInputError("stop", "be a sample that the closed stream holds", stop)
        with self._lock:
            while self._next - len(self._samples) < first:
                self._samples.popleft()
            return Corpus(list(islice(self._samples, stop - first)))

    def ready(self, n: int, timeout: float) -> bool:
        """Wait until `n` samples have come in, at most `timeout` seconds; say whether they have."""
        check_count("n", n, low=1, high=self.capacity)
        return self._came(self._start + n, time.monotonic() + timeout)

    def _came(self, stop: int, end: float) -> bool:
        """Wait for the samples up to number `stop`, to a time; say whether they have come."""
        while self._next < stop:
            self._check()
            if self._stop.is_set() or time.monotonic() > end:  # closed: none will come
                return False
            self._stop.wait(_LOOK)
        return True

    def __len__(self) -> int:
        """Return the number of samples at hand."""
        return len(self._samples)

    def _check(self) -> None:
        """Raise here what ended the thread that collects."""
        if self._collecting is not None and self._collecting.done():
            self._collecting.result()

    def _load(self, folder: Path) -> None:
        """Take over the shards that are there."""
        size = self._config.shard_size
        numbers = set(_numbers(folder))
        first = end = self._next // size
        while end in numbers:
            end += 1
        if not self._keep:
            _remove(folder, numbers - set(range(first, end)))  # what is behind a gap, too
            numbers &= set(range(first, end))
        if not numbers:
            return
        there = open_shards(folder)
        if not np.array_equal(there.labels["index"], np.arange(first * size, end * size)):
            raise InvalidInputError(
                "folder",
                f"hold whole shards of the samples from `start` = {self._next} on",
                f"others in {folder}",
                advice="take another folder",
            )
        for shard in there.shards:
            for i in range(size):
                self._samples.append(shard[i : i + 1])
        self._next += len(there)

    def _collect(self) -> None:
        made = produced(self._config, count_from(self._next), self._workers)
        with closing(made) as samples:
            for sample in samples:
                if self._stop.is_set():
                    return
                self._take(sample)
                while self._ahead is not None and self._next >= self._asked + self._ahead:
                    if self._stop.wait(_LOOK):
                        return

    def _take(self, sample: Samples) -> None:
        with self._lock:
            self._samples.append(sample)
            self._next += 1
        size = self._config.shard_size
        if self._folder is None:
            return
        self._unsaved.append(sample)
        if len(self._unsaved) < size:
            return
        index = self._next // size - 1
        write_shard(self._folder, index, Samples.joined(self._unsaved))
        self._unsaved = []
        if self._keep:
            return
        last = self._first // size - _SPARE
        last = index - max(1, self.capacity // size) if self._ahead is None else last
        _remove(self._folder, [number for number in _numbers(self._folder) if number <= last])


def window(config: TrainConfig, step: int, capacity: int) -> tuple[int, int]:
    """Return of which samples of a stream a step shows some: from one number up to another.

    At most `capacity`; with every step, as many leave as each is shown ``config.shown`` times.
    """
    stop = min(capacity, _BEGIN * config.batch) + step * config.batch // config.shown
    return max(0, stop - capacity), stop


def drawn(config: TrainConfig, step: int, capacity: int) -> NDArray[np.int64]:
    """Return the numbers of the samples of a stream that a step shows, shape (batch,)."""
    first, stop = window(config, step, capacity)
    rng = np.random.default_rng((config.seed, 0, step))
    return first + rng.choice(stop - first, config.batch, replace=stop - first < config.batch)


def _mark(folder: Path) -> None:
    """Tell a folder as that of a stream, whose old shards may go; refuse any other."""
    mark = folder / "stream"
    if not mark.exists() and any(folder.glob("shard_*")):
        raise InvalidInputError(
            "folder",
            "have been begun by a stream, which removes shards",
            f"a corpus in {folder}",
            advice="take another folder, let the stream `keep` its shards, or train without one",
        )
    mark.touch()


def _numbers(folder: Path) -> list[int]:
    return [shard_number(path) for path in folder.glob("shard_*")]


def _remove(folder: Path, numbers: Iterable[int]) -> None:
    for number in numbers:  # open maps of them stay readable
        path = folder / f"shard_{number:04d}"
        gone = path.rename(folder / f".gone_{path.name}")  # never half a shard by its name
        shutil.rmtree(gone)
