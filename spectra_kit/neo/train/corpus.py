"""The corpus: samples made by any number of processes, counted, and written as shards.

An interrupted run continues where it stopped, and a corpus does not depend on who made it.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.files import atomic_path, parsing
from spectra_kit._core.validate import check_count
from spectra_kit.errors import InvalidInputError, WorkerError
from spectra_kit.neo.train.families import FAMILIES
from spectra_kit.neo.train.samples import REASONS, CorpusConfig, Sample, make_sample
from spectra_kit.neo.train.shards import Batch, Operators, open_shards, write_shard

__all__ = ["CorpusConfig", "CorpusReport", "Sample", "generate", "make_sample"]

_THREAD_LIMITS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_AHEAD = 3  # samples in work or done but not fetched, for each worker


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

    Raises
    ------
    InvalidInputError
        If the folder was begun with another configuration, or a shard in it has another length
        than `n` asks for.
    WorkerError
        If a process died.

    Notes
    -----
    Shards appear one by one and whole: training may start on the first, and Ctrl-C loses at most
    the one in work. With ``workers > 1`` a script must guard its top level with
    ``if __name__ == "__main__"``, because the processes are spawned.

    Examples
    --------
    >>> import tempfile
    >>> from spectra_kit.neo.train.corpus import CorpusConfig, generate
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
    here = nullcontext(make_sample(config, i) for i in indices)
    with here if workers == 1 else produced(config, indices, workers) as samples:
        done = 0
        for i in missing:
            shard = []
            for sample in islice(samples, sizes[i]):
                shard.append(sample)
                done += 1
                if progress is not None:
                    progress(done, len(indices))
            write_samples(root, i, shard, config.n_points)
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


def write_samples(root: Path, index: int, samples: Sequence[Sample], n_points: int) -> None:
    """Write one shard of samples."""
    labels = {name: [sample.labels[name] for sample in samples] for name in samples[0].labels}
    batch = as_batch(samples, n_points)
    arrays = batch.points, batch.mass, batch.eigenvectors
    write_shard(root, index, *arrays, labels, batch.operators)


def as_batch(samples: Sequence[Sample], n_points: int) -> Batch:
    """Return samples in the precisions of the shards, padded to `n_points` each."""

    def padded(name: str, dtype: type[np.floating], **how: Any) -> Any:
        arrays = [np.asarray(getattr(sample, name), dtype) for sample in samples]
        rest = [((0, n_points - len(array)), *[(0, 0)] * (array.ndim - 1)) for array in arrays]
        return np.stack([np.pad(a, width, **how) for a, width in zip(arrays, rest, strict=True)])

    return Batch(
        padded("points", np.float32, mode="edge"),
        padded("mass", np.float32),
        padded("eigenvectors", np.float16),
        Operators.of(
            [sample.stiffness for sample in samples],
            [sample.eigenvalues for sample in samples],
            n_points,
        ),
    )


@contextmanager
def produced(
    config: CorpusConfig, indices: Iterable[int], workers: int
) -> Iterator[Iterator[Sample]]:
    """Make samples in processes of one thread each, ahead of need, and hand them out in order.

    Of any number of `indices`, in the precisions of the shards. Taking one raises `WorkerError` if
    a process has died. Leaving the block ends the processes; they also end with this one.
    """
    todo = iter(indices)
    executor = ProcessPoolExecutor(
        workers, multiprocessing.get_context("spawn"), initializer=_begin_worker
    )
    try:
        first = islice(todo, _AHEAD * workers)
        with _one_thread():  # all processes start here, and read this
            ahead = deque(executor.submit(packed_sample, config, i) for i in first)
        yield _in_order(executor, config, ahead, todo)
    finally:
        executor.shutdown(cancel_futures=True)


def _in_order(
    executor: ProcessPoolExecutor,
    config: CorpusConfig,
    ahead: deque[Future[Sample]],
    todo: Iterator[int],
) -> Iterator[Sample]:
    while ahead:
        try:
            sample = ahead.popleft().result()
            ahead.extend(executor.submit(packed_sample, config, i) for i in islice(todo, 1))
        except BrokenProcessPool as error:
            raise WorkerError(
                "a process that makes samples has died, perhaps for lack of memory",
                advice="start again with fewer `workers`",
            ) from error
        yield sample


def packed_sample(config: CorpusConfig, index: int) -> Sample:
    """Make a sample in the precisions of the shards: a quarter of the bytes to send."""
    full = make_sample(config, index)
    return replace(
        full,
        points=full.points.astype(np.float32),
        mass=full.mass.astype(np.float32),
        eigenvectors=full.eigenvectors.astype(np.float16),
        stiffness=full.stiffness.astype(np.float32),
    )


@contextmanager
def _one_thread() -> Iterator[None]:
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
