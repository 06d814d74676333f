"""The corpus: samples made by any number of processes, kept as shards, read through memory maps.

::

    corpus/corpus.json                   what it is made of
           shard_0000/points.npy, ...    one array each, see `Samples`
                      labels.npz         one integer array of shape (s,) per label
           shard_0001/...

A shard appears under its name only when it is complete, so training may read a folder that
generation still fills. An interrupted generation continues where it stopped, and a corpus does not
depend on who made it.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import re
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spectra_kit._core.files import atomic_path, parsing, temporary_folder
from spectra_kit._core.validate import check_count
from spectra_kit.errors import InvalidInputError, WorkerError
from spectra_kit.neo.train.config import TrainConfig
from spectra_kit.neo.train.families import FAMILIES
from spectra_kit.neo.train.samples import (
    ARRAYS,
    OPERATORS,
    REASONS,
    CorpusConfig,
    Samples,
    common_labels,
    make_sample,
)

_THREAD_LIMITS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_AHEAD = 3  # samples in work or done but not fetched, for each worker
_NAME = re.compile(r"shard_\d{4,}")
#: Reads samples of a draw, by their places in it.
Reader = Callable[[Sequence[int]], Samples]


class Source(Protocol):
    """Where the samples of a run come from: a `Corpus`, or a `SampleStream` that makes them.

    Anything else that has these members will do, also without `begin`.
    """

    n_points: int  #: points per sample
    k: int  #: modes per sample
    has_operators: bool  #: whether all samples come with them
    capacity: int  #: samples that there may be at a time, at most

    @property
    def fewest(self) -> int:
        """Points of the smallest sample, without padding."""
        raise NotImplementedError

    @property
    def made(self) -> int:
        """Samples that there have been so far."""
        return self.capacity

    def identity(self, config: TrainConfig) -> dict[str, Any] | None:
        """Return what a batch follows from beside (seed, step) and the samples, as JSON.

        Nothing for shards: a run may go on when some were added.
        """
        return None

    def begin(self, config: TrainConfig) -> None:
        """Wait until there is enough to show."""
        return  # shards are there; and mypy takes an empty body for abstract

    def draw(self, config: TrainConfig, step: int) -> tuple[NDArray[np.int64], Reader]:
        """Return the numbers of the samples that a step shows, shape (batch,), and their reader.

        A number is always that of the same sample; of those that there are at a time, no two differ
        by `capacity` or more.
        """
        raise NotImplementedError


class Corpus(Source):
    """The samples of shards, numbered through; of folders of them by `open_shards`.

    Parameters
    ----------
    shards : sequence of Samples
        Of folders, memory maps.
    """

    def __init__(self, shards: Sequence[Samples]) -> None:
        sizes = {(s.mass.shape[1], s.eigenvectors.shape[2]) for s in shards}
        if len(sizes) != 1:
            raise InvalidInputError(
                f"shards must have the same (points, modes) per sample, got {sorted(sizes)}",
                advice="keep corpora of different sizes apart, and train on one at a time",
            )
        self.shards = tuple(shards)
        ((self.n_points, self.k),) = sizes
        self.has_operators = all(shard.has_operators for shard in shards)
        self._ends = np.cumsum([len(shard) for shard in shards])  # in samples
        self.capacity = int(self._ends[-1])

    def __len__(self) -> int:
        return self.capacity

    @cached_property
    def labels(self) -> dict[str, NDArray[np.int64]]:
        """Integer labels of all samples, those that every shard has."""
        return common_labels(self.shards)

    @cached_property
    def fewest(self) -> int:
        """See `Source`."""
        counts = self.labels.get("n")
        if counts is None:  # as in shards of before, joined with others
            counts = np.concatenate([np.count_nonzero(s.mass, axis=1) for s in self.shards])
        return int(np.min(counts, initial=self.n_points))

    def batch(self, indices: ArrayLike) -> Samples:
        """Read the samples `indices`, shape (b,), into memory, in that order."""
        chosen = np.asarray(indices)
        which = np.searchsorted(self._ends, chosen, side="right")
        first = self._ends - [len(shard) for shard in self.shards]
        places = zip(which, chosen - first[which], strict=True)
        return Samples.joined([self.shards[i][j : j + 1] for i, j in places])

    def draw(self, config: TrainConfig, step: int) -> tuple[NDArray[np.int64], Reader]:
        """See `Source`."""
        numbers = shuffled(len(self), config, step)
        return numbers, lambda places: self.batch(numbers[places])


def shuffled(n: int, config: TrainConfig, step: int) -> NDArray[np.int64]:
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


def write_shard(folder: str | os.PathLike[str], index: int, samples: Samples) -> Path:
    """Write one shard, all of it or nothing, and return its folder.

    Parameters
    ----------
    folder : path
        The corpus; made if missing.
    index : int
        Number of the shard. An existing shard is never overwritten.
    samples : Samples
        Finite, with masses that sum to one.
    """
    for name, array in samples.arrays().items():
        if not (array.size and np.isfinite(array).all()):
            raise InvalidInputError(name, "be there and finite in the precision that is stored")
    sums = samples.mass.sum(axis=1, dtype=np.float64)
    if not ((samples.mass >= 0).all() and np.allclose(sums, 1, atol=1e-4)):
        raise InvalidInputError(
            "mass",
            "not be negative, and have rows that sum to 1",
            f"sums in [{sums.min():.6g}, {sums.max():.6g}]",
            advice="divide by the sum and multiply the eigenvectors by its root",
        )
    path = Path(folder) / f"shard_{index:04d}"
    path.parent.mkdir(parents=True, exist_ok=True)
    with temporary_folder(path.parent) as temporary:
        for name, array in samples.arrays().items():
            np.save(temporary / f"{name}.npy", array)
        np.savez(temporary / "labels.npz", allow_pickle=False, **samples.labels)
        try:
            temporary.rename(path)
        except OSError as error:
            raise InvalidInputError(
                f"shard {index} of {folder} exists", advice=f"delete {path} or take another index"
            ) from error
    return path


def open_shards(*folders: str | os.PathLike[str]) -> Corpus:
    """Open every complete shard of corpora, in the order of their numbers, without reading it.

    Opening again later sees shards that were added since.

    Parameters
    ----------
    *folders : path
        Where `write_shard` wrote. The samples of one that is named twice count twice.
    """
    return Corpus([_open_shard(path) for folder in folders for path in _paths(Path(folder))])


def _paths(root: Path) -> list[Path]:
    entries = root.iterdir() if root.is_dir() else iter(())
    paths = [path for path in entries if _NAME.fullmatch(path.name)]
    if not paths:
        raise InvalidInputError(
            "folder", "hold shards", f"none in {root}", advice="generate a corpus first"
        )
    return sorted(paths, key=shard_number)


def shard_number(path: Path) -> int:
    """Return the number in the name of a shard."""
    return int(path.name.removeprefix("shard_"))


def _open_shard(path: Path) -> Samples:
    """Map the arrays of one shard; their values are not read, and damage to them is not seen."""
    with parsing(path, "shard", remedy="delete it, and generate the corpus again: it is replaced"):
        dtypes = ARRAYS | OPERATORS if (path / "starts.npy").exists() else ARRAYS
        arrays = {name: np.load(path / f"{name}.npy", mmap_mode="r") for name in dtypes}
        with (path / "labels.npz").open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            labels = dict(file.items())
        for name, array in (arrays | labels).items():
            dtype = np.dtype(dtypes.get(name, np.int64))
            if array.dtype != dtype:
                raise TypeError(f"{name} must be {dtype}, got {array.dtype}")
        return Samples(**arrays, labels=labels)


@dataclass(frozen=True)
class CorpusReport:
    """What lies in a corpus, and what was turned down on the way.

    Parameters
    ----------
    samples : int
        Number of samples.
    families : dict of str to int
        Samples of each family, and of the ``pool``.
    rejected : dict of str to int
        Draws that were thrown away and drawn again: an empty ``mesh``, a cloud whose Laplacian
        falls apart into several ``components``, an eigensolve that failed (``solve``).
    """

    samples: int
    families: dict[str, int]
    rejected: dict[str, int]


def generate(
    folder: str | os.PathLike[str],
    n: int,
    *,
    config: CorpusConfig,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> CorpusReport:
    """Generate a corpus of `n` samples, or what is missing of it.

    Parameters
    ----------
    folder : path
        Made if missing. Shards that it already holds are kept.
    n : int
        Samples in all, existing ones included.
    config : CorpusConfig
        Must equal the one that the folder was begun with.
    workers : int, default 1
        Processes, each of one thread; 1 works in this process. The result does not depend on it.
    progress : callable, optional
        Called after each sample with the numbers of samples done and to do in this run.

    Returns
    -------
    CorpusReport
        Counts over the whole folder.

    Notes
    -----
    Shards appear one by one and whole: training may start on the first, and Ctrl-C loses at most
    the one in work. With ``workers > 1`` a script must guard its top level with
    ``if __name__ == "__main__"``, because the processes are spawned.

    Examples
    --------
    >>> import tempfile
    >>> from spectra_kit.neo.train.corpus import generate
    >>> from spectra_kit.neo.train.samples import CorpusConfig
    >>> config = CorpusConfig(seed=1, n_points=128, k=4, shard_size=2)
    >>> generate(tempfile.mkdtemp(), 3, config=config).samples
    3
    """
    check_count("n", n, low=1)
    check_count("workers", workers, low=1)
    root = Path(folder)
    root.mkdir(parents=True, exist_ok=True)
    claim(root, config)
    shards = range(-(-n // config.shard_size))
    sizes = {i: min(config.shard_size, n - i * config.shard_size) for i in shards}
    missing = [i for i in shards if not _is_there(root, i, sizes[i])]
    indices = [i * config.shard_size + j for i in missing for j in range(sizes[i])]
    # One process is this one: nothing to start, and errors come with their own trace.
    here = (make_sample(config, i) for i in indices)
    with closing(here if workers == 1 else produced(config, indices, workers)) as samples:
        done = 0
        for i in missing:
            shard = []
            for sample in islice(samples, sizes[i]):
                shard.append(sample)
                done += 1
                if progress is not None:
                    progress(done, len(indices))
            write_shard(root, i, Samples.joined(shard))
    return report(root)


def report(folder: str | os.PathLike[str]) -> CorpusReport:
    """Count the samples in the complete shards of a folder, and the draws rejected for them."""
    return count(open_shards(folder).labels)


def count(labels: Mapping[str, ArrayLike]) -> CorpusReport:
    """Count samples by their labels, as `make_sample` gives them, arrays of shape (s,)."""
    names = (*FAMILIES, "pool")  # FROM_POOL = -1 counts from the end
    family = np.asarray(labels["family"], dtype=np.int64)
    counts = np.bincount(family % len(names), minlength=len(names))
    return CorpusReport(
        samples=len(family),
        families={name: int(c) for name, c in zip(names, counts, strict=True)},
        rejected={reason: int(np.sum(labels[f"rejected_{reason}"])) for reason in REASONS},
    )


def claim(root: Path, config: CorpusConfig) -> None:
    """Write the fingerprint of a new corpus, or compare it with that of an old one."""
    path = root / "corpus.json"
    ours = config.fingerprint()
    if not path.exists():
        with atomic_path(path) as temporary:
            temporary.write_text(json.dumps(ours, indent=1))
        return
    theirs = read_fingerprint(path)
    differing = sorted(key for key in ours if ours[key] != theirs.get(key))
    if differing:
        raise InvalidInputError(
            f"`folder` {root} was begun with another configuration: {differing} differ",
            advice="take that one, or another folder",
        )


def read_fingerprint(path: Path) -> dict[str, Any]:
    """Return what `claim` wrote."""
    with parsing(path, "record of a corpus", remedy="restore it, or begin another folder"):
        return dict(json.loads(path.read_text()))


def _is_there(root: Path, index: int, size: int) -> bool:
    path = root / f"shard_{index:04d}" / "mass.npy"
    if not path.exists():
        return False
    with parsing(path, "shard", remedy=f"delete {path.parent}, which is made again then"):
        there = len(np.load(path, mmap_mode="r"))
    if there != size:
        raise InvalidInputError(
            f"shard {index} of {root} holds {there} samples where `n` asks for {size}",
            advice="delete it, or ask for a multiple of the shard size",
        )
    return True


def produced(
    config: CorpusConfig, indices: Iterable[int], workers: int
) -> Generator[Samples, None, None]:
    """Make samples in processes of one thread each, ahead of need, and yield them in order.

    Of any number of `indices`. Raises `WorkerError` if a process has died. Closing ends the
    processes; they also end with this one.
    """
    todo = iter(indices)
    executor = ProcessPoolExecutor(
        workers, multiprocessing.get_context("spawn"), initializer=_begin_worker
    )
    try:
        first = islice(todo, _AHEAD * workers)
        with _one_thread():  # all processes start here, and read this
            ahead = deque(executor.submit(make_sample, config, i) for i in first)
        while ahead:
            sample = ahead.popleft().result()
            ahead.extend(executor.submit(make_sample, config, i) for i in islice(todo, 1))
            yield sample
    except BrokenProcessPool as error:
        raise WorkerError(
            "a process that makes samples has died, perhaps for lack of memory",
            advice="start again with fewer `workers`",
        ) from error
    finally:
        executor.shutdown(cancel_futures=True)


@contextmanager
def _one_thread() -> Generator[None, None, None]:
    """Have processes that start in this block load their libraries for one thread."""
    before = {name: os.environ.get(name) for name in _THREAD_LIMITS}
    os.environ.update(dict.fromkeys(_THREAD_LIMITS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def _begin_worker() -> None:
    """Leave Ctrl-C to the parent, and end with it, even when it is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
