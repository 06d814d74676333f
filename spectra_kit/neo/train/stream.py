"""Samples made while they are needed: processes fill a bounded buffer that training reads.

So an accelerator neither waits for a corpus nor needs gigabytes of files.
"""

from __future__ import annotations

import os
import shutil
import threading
import time
from collections import deque
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import count as count_from
from itertools import islice
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.validate import check_count
from spectra_kit.errors import InvalidInputError
from spectra_kit.neo.train.corpus import (
    CorpusReport,
    as_batch,
    claim,
    count,
    produced,
    write_samples,
)
from spectra_kit.neo.train.samples import LABELS, CorpusConfig, Sample
from spectra_kit.neo.train.shards import Batch, Corpus, Operators, open_shards

_LOOK = 0.1  # seconds between looks of a reader that waits
_SPARE = 4  # shards before the last window that are kept: a run may go on from some steps before


class SampleStream:
    """An endless corpus: sample `start`, `start` + 1, ... of a configuration, the newest at hand.

    Sample number i is the one that `make_sample` makes, in the precisions of the shards. The
    buffer grows to `capacity`; then the oldest samples make room. Reading waits for nothing. With
    `ahead`, samples are made as they are asked for, by `window`, which waits for them.

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
        Save whole shards there, as `generate` does. Those from `start` on that are there already
        fill the buffer at once, and the stream goes on behind the last.
    bounded : bool, default False
        Remove shards from the folder that are older than the last `capacity` samples, and at first
        those that are not needed from `start` on, or come behind a gap.
    ahead : int, optional
        Make at most about so many samples beyond the last `window`.

    Raises
    ------
    InvalidInputError
        If a count is too small; (on entering) if the folder holds another corpus, or other
        samples than those from `start` on, or half a shard, or, of a bounded stream, shards that
        none has made.
    WorkerError
        (from every method but ``close``) If a process that makes samples has died.

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
        bounded: bool = False,
        ahead: int | None = None,
    ) -> None:
        self._workers = check_count("workers", workers, low=1)
        self._capacity = check_count("capacity", capacity, low=1)
        self._start = self._next = check_count("start", start, low=0)
        if folder is not None and start % config.shard_size:
            raise InvalidInputError(
                "start",
                f"be a multiple of the shard size {config.shard_size} where shards are saved",
                start,
            )
        self._ahead = None if ahead is None else check_count("ahead", ahead, low=1)
        self._first = self._asked = start  # of the last window, and where it ends
        self._config, self._bounded = config, bounded
        self._folder = None if folder is None else Path(folder)
        # The first one is none, and tells of what size the others are.
        n, k = config.n_points, config.k
        self._none = Batch(
            np.empty((0, n, 3), np.float32),
            np.empty((0, n), np.float32),
            np.empty((0, n, k), np.float16),
            Operators(
                np.empty((0, k), np.float32),
                np.empty((0, n + 1), np.int32),
                np.empty(0, np.int32),
                np.empty(0, np.float32),
            ),
        )
        self._samples: deque[Batch] = deque(maxlen=None if ahead is not None else capacity)
        self._labels: list[tuple[int, ...]] = []  # of all so far
        self._unsaved: list[Sample] = []
        self._lock, self._stop = threading.Lock(), threading.Event()
        self._thread: ThreadPoolExecutor | None = None
        self._collecting: Future[None] | None = None

    def __enter__(self) -> Self:
        if self._folder is not None:
            self._folder.mkdir(parents=True, exist_ok=True)
            claim(self._folder, self._config)
            if self._bounded:
                _mark(self._folder)
            self._load(self._folder)
        self._thread = ThreadPoolExecutor(1)
        self._collecting = self._thread.submit(self._collect)
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the processes; what is in the buffer stays readable."""
        self._stop.set()
        if self._thread is not None:
            self._thread.shutdown()

    @property
    def config(self) -> CorpusConfig:
        """What its samples are made of."""
        return self._config

    @property
    def capacity(self) -> int:
        """The number of samples that it holds at most."""
        return self._capacity

    def corpus(self) -> Corpus:
        """Return what is there now, possibly nothing: samples that stay as they are."""
        self._check()
        with self._lock:
            samples = tuple(self._samples)
            labels = self._labels[len(self._labels) - len(samples) :]
        return Corpus((self._none, *samples), _columns(labels))

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
        while self._next < stop:
            self._check()
            if self._stop.is_set():
                raise InvalidInputError("stop", "be a sample that the closed stream holds", stop)
            self._stop.wait(_LOOK)
        with self._lock:
            count = stop - first
            while self._next - len(self._samples) < first:
                self._samples.popleft()
            samples = tuple(islice(self._samples, count))
            labels = self._labels[len(self._labels) - len(self._samples) :][:count]
        return Corpus((self._none, *samples), _columns(labels))

    def ready(self, n: int, timeout: float) -> bool:
        """Wait until `n` samples have come in, at most `timeout` seconds; say whether they have."""
        check_count("n", n, low=1, high=self._capacity)
        end = time.monotonic() + timeout
        while self._next - self._start < n:
            self._check()
            if self._stop.is_set() or time.monotonic() > end:  # closed: none will come
                return False
            self._stop.wait(_LOOK)
        return True

    def __len__(self) -> int:
        """Return the number of samples at hand."""
        return len(self._samples)

    def report(self) -> CorpusReport:
        """Count all samples so far, those that made room included, and what was turned down."""
        self._check()
        with self._lock:
            labels = list(self._labels)
        return count(_columns(labels))

    def _check(self) -> None:
        """Raise here what ended the thread that collects."""
        if self._collecting is not None and self._collecting.done():
            self._collecting.result()

    def _load(self, folder: Path) -> None:
        """Take over the shards that are there."""
        size = self._config.shard_size
        if self._bounded:
            numbers = set(_numbers(folder))
            first = end = self._next // size
            while end in numbers:
                end += 1
            _remove(folder, numbers - set(range(first, end)))  # what is behind a gap, too
        if not any(folder.glob("shard_*")):
            return
        there = open_shards(folder)
        if not np.array_equal(there.labels["index"], self._next + np.arange(len(there))):
            raise InvalidInputError(
                "folder",
                f"hold the samples from `start` = {self._next} on without gaps",
                f"others in {folder}",
                advice="take another folder, or its own start",
            )
        if len(there) % size:
            raise InvalidInputError(
                "folder",
                f"hold whole shards of {size}",
                f"{len(there)} samples in {folder}",
                advice="delete its last shard",
            )
        for shard in there.shards:
            for i in range(size):
                self._samples.append(shard[i : i + 1])
        self._labels = list(zip(*(there.labels[name].tolist() for name in LABELS), strict=True))
        self._next += len(there)

    def _collect(self) -> None:
        with produced(self._config, count_from(self._next), self._workers) as samples:
            for sample in samples:
                if self._stop.is_set():
                    return
                self._take(sample)
                while self._ahead is not None and self._next >= self._asked + self._ahead:
                    if self._stop.wait(_LOOK):
                        return

    def _take(self, sample: Sample) -> None:
        with self._lock:
            self._samples.append(as_batch([sample], self._config.n_points))
            self._labels.append(tuple(sample.labels[name] for name in LABELS))
            self._next += 1
        size = self._config.shard_size
        if self._folder is not None:
            self._unsaved.append(sample)
            if len(self._unsaved) == size:
                index = sample.labels["index"] // size
                write_samples(self._folder, index, self._unsaved, self._config.n_points)
                self._unsaved = []
                if self._bounded and self._ahead is None:
                    _thin(self._folder, index - max(1, self._capacity // size))
                elif self._bounded:
                    _thin(self._folder, self._first // size - _SPARE)


def _mark(folder: Path) -> None:
    """Tell a folder as that of a bounded stream, whose old shards may go; refuse any other."""
    mark = folder / "stream"
    if not mark.exists() and any(folder.glob("shard_*")):
        raise InvalidInputError(
            "folder",
            "have been begun by a bounded stream, which removes shards",
            f"a corpus in {folder}",
            advice="take another folder, or train on this one without a stream",
        )
    mark.touch()


def _thin(folder: Path, last: int) -> None:
    """Remove the shards of a folder up to number `last`; open maps of them stay readable."""
    _remove(folder, (number for number in _numbers(folder) if number <= last))


def _numbers(folder: Path) -> list[int]:
    return [int(path.name.removeprefix("shard_")) for path in folder.glob("shard_*")]


def _remove(folder: Path, numbers: Iterable[int]) -> None:
    for number in numbers:
        path = folder / f"shard_{number:04d}"
        gone = path.rename(folder / f".gone_{path.name}")  # never half a shard by its name
        shutil.rmtree(gone)


def _columns(labels: list[tuple[int, ...]]) -> dict[str, NDArray[np.int64]]:
    columns = np.array(labels, dtype=np.int64).reshape(-1, len(LABELS)).T
    return dict(zip(LABELS, columns, strict=True))
