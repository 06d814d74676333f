"""`DaskEngine`: the processes of this machine, or of a cluster, as workers of a run."""

from __future__ import annotations

import math
import os
import pickle
import re
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain, islice
from typing import Any

from spectra_kit._core.checked import checked
from spectra_kit._core.optional import optional
from spectra_kit._core.threads import single_threaded, usable_cores
from spectra_kit._core.validate import check_count
from spectra_kit._core.warn import warn
from spectra_kit._sparse.memory import memory_of
from spectra_kit.datasets.run import Task, in_this_process
from spectra_kit.eigen import eigensolve
from spectra_kit.errors import (
    EngineLostError,
    InvalidInputError,
    SpectraKitWarning,
    WorkerError,
)
from spectra_kit.geometry import sphere
from spectra_kit.operators import robust_laplacian

_LONG, _MOST = 0.5, 16  # seconds of work to hand out at once, and tasks
_LOOK = 1.0  # seconds after which workers are counted again
_SIZE = re.compile(r"auto|none|0|[0-9.]+(e[0-9]+)? *([kmgt]i?)?b?", re.IGNORECASE)
_AHEAD = 4  # parcels handed out for each thread: none waits, the scheduler has little to remember
_ALLOWED_FAILURES = 10  # deaths of workers that a shape may be near by chance
# What a task needs is known only while it runs: results are small, nothing is worth spilling, and
# a worker that pauses for memory which its libraries keep would never go on.
_KILL = "distributed.worker.memory.terminate"  # above this share of the limit
_SETTINGS = {
    "distributed.scheduler.allowed-failures": _ALLOWED_FAILURES,
    "distributed.scheduler.worker-ttl": None,
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    _KILL: math.inf,  # until it is known what an idle worker takes
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.nanny.pre-spawn-environ": dict.fromkeys(
        ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), 1
    ),
}


@checked
@dataclass(frozen=True, kw_only=True)
class DaskEngine:
    """Workers of Dask: processes of this machine, one thread each, or those of a cluster.

    A worker that dies is started again and its shape computed elsewhere; a shape near which ten
    have died fails. Where a cluster has its own scheduler, its own settings count for that.

    Parameters
    ----------
    scheduler : str, optional
        Address of a scheduler, such as ``"tcp://10.0.0.1:8786"``.
    scheduler_file : path, optional
        A file in which a scheduler has written its address.
    nworkers : int, optional
        Processes to start here, without a scheduler; by default one for each core that this process
        may use, or for as many as each has threads.
    nthreads : int, default 1
        Shapes that each of them works on at a time.
    memory_limit : str, default "auto"
        What each of them may hold, as ``"3GB"``: it is killed and started again before it has more.
        By default its share of the memory there is.

    Raises
    ------
    MissingDependencyError
        When called, if Dask is not installed.
    EngineLostError
        When called, if the scheduler cannot be reached, or ends.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> engine = sk.datasets.DaskEngine(nworkers=2, memory_limit="3GB")
    """

    scheduler: str | None = None
    scheduler_file: str | os.PathLike[str] | None = None
    nworkers: int | None = None
    nthreads: int = 1
    memory_limit: str = "auto"

    def __post_init__(self) -> None:
        check_count("nthreads", self.nthreads, low=1)
        if self.nworkers is not None:
            check_count("nworkers", self.nworkers, low=1)
        if not _SIZE.fullmatch(self.memory_limit):
            raise InvalidInputError(
                "memory_limit", "be a size such as 3GB, or auto", repr(self.memory_limit)
            )
        if None not in (self.scheduler, self.scheduler_file):
            raise InvalidInputError("scheduler_file", "be left out where `scheduler` is given")
        here = {"nworkers": None, "nthreads": 1, "memory_limit": "auto"}
        told = [name for name, usual in here.items() if getattr(self, name) != usual]
        if self._elsewhere and told:
            raise InvalidInputError(
                told[0],
                "be left out where there is a scheduler, whose workers are there already",
                getattr(self, told[0]),
            )

    def __call__(self, tasks: Iterable[Task]) -> Iterator[tuple[Task, Any | BaseException]]:
        """Hand the tasks out, and yield results as they come."""
        distributed: Any = optional("distributed", extra="batch", needed_by="a run with workers")
        with self._client() as client:
            try:
                yield from _spread(client, tasks)
            except (OSError, distributed.client.ClosedClientError) as error:  # as Dask notices it
                raise EngineLostError(
                    "the scheduler was lost",
                    advice="what is done is kept; the same command goes on with what is not",
                ) from error

    @property
    def _elsewhere(self) -> bool:
        return self.scheduler is not None or self.scheduler_file is not None

    @contextmanager
    def _client(self) -> Iterator[Any]:
        dask: Any = optional("dask", extra="batch", needed_by="a run with workers")
        distributed: Any = optional("distributed", extra="batch", needed_by="a run with workers")
        if self._elsewhere:
            file = self.scheduler_file
            where = {} if file is None else {"scheduler_file": os.fspath(file)}
            try:
                client = distributed.Client(self.scheduler, **where)
            except (OSError, TimeoutError, ValueError) as error:
                raise EngineLostError(
                    f"no scheduler answers at {self.scheduler or self.scheduler_file}: {error}",
                    advice="start one with `dask scheduler`, and workers with `dask worker`",
                ) from error
            with client:
                yield client
            return
        share = dask.config.get(_KILL)
        with (
            dask.config.set(_SETTINGS),
            self._local(distributed) as cluster,
            distributed.Client(cluster) as client,
        ):
            keepers = [nanny.memory_manager for nanny in cluster.workers.values()]
            if share and (limit := keepers[0].memory_limit):
                _check_room(client, limit, share)
                for keeper in keepers:
                    keeper.memory_terminate_fraction = share
            with dask.config.set({_KILL: share}):
                yield client

    def _local(self, distributed: Any) -> Any:
        """Start the workers of this machine."""
        count = self.nworkers or max(1, usable_cores() // self.nthreads)
        limit: str | int = self.memory_limit
        if limit == "auto":
            limit = distributed.system.MEMORY_LIMIT // count
        try:
            return distributed.LocalCluster(
                n_workers=count,
                threads_per_worker=self.nthreads,
                memory_limit=limit,
                processes=True,
                dashboard_address="127.0.0.1:0",
                silence_logs="CRITICAL",
                preload="spectra_kit.datasets.preload",
            )
        except RuntimeError as error:
            raise EngineLostError(
                f"no workers could be started: {error}",
                advice="a script that starts some must do so under `if __name__ == '__main__':`",
            ) from error


def _check_room(client: Any, limit: int, share: float) -> None:
    """Refuse workers that would be killed before they have done anything, for ever."""
    idle = max(client.run(_idle).values())
    if idle > share * limit:
        raise InvalidInputError(
            "memory_limit",
            f"be more than a worker takes before it has a shape, {idle / share / 1e6:.0f} MB",
            f"{limit / 1e6:.0f} MB",
            advice=("raise {}", "lower {}"),
            remedies=("memory_limit", "nworkers"),
        )


def _idle() -> int:
    """Import, in a worker, what all work needs, and return the bytes that it takes then."""
    psutil: Any = optional("psutil", extra="batch", needed_by="a run with workers")
    with single_threaded():
        eigensolve(robust_laplacian(sphere(subdivisions=2).geometry), 4)
    return int(psutil.Process().memory_info().rss)


def _spread(client: Any, tasks: Iterable[Task]) -> Iterator[tuple[Task, Any | BaseException]]:
    """Hand tasks out, several at a time where they are quick, and yield results as they come."""
    distributed: Any = optional("distributed", extra="batch", needed_by="a run with workers")
    todo, waiting = iter(tasks), dict[str, tuple[Task, ...]]()
    ready = distributed.as_completed()
    threads, looked = sum(client.nthreads().values()), time.monotonic()
    if not threads:
        warn("the scheduler has no workers yet; waiting for the first one", SpectraKitWarning)
    _check_pickled(first := next(todo, None))
    todo = chain([first] if first else [], todo)
    together = 1  # so many tasks take about `_LONG` seconds

    def hand_out(some: tuple[Task, ...]) -> None:
        future = client.submit(_do, some, pure=False)
        waiting[future.key] = some
        ready.add(future)

    def fill() -> None:
        while len(waiting) < _AHEAD * max(1, threads) and (some := tuple(islice(todo, together))):
            hand_out(some)

    fill()
    for future in ready:
        some = waiting.pop(future.key)
        if future.cancelled():
            raise OSError("the client has given up")
        error = future.exception()
        if error is None:
            results, seconds = future.result()
            yield from zip(some, results, strict=True)
            together = max(1, min(_MOST, int(_LONG * len(some) / max(seconds, 1e-9))))
        elif len(some) > 1:  # one of them is to blame: each for itself
            for task in some:
                hand_out((task,))
        else:
            if isinstance(error, distributed.KilledWorker):
                error = WorkerError(
                    "the process that worked on it died each time it was tried",
                    advice="as for lack of memory: let fewer workers have more of it",
                )
            yield some[0], error
        if time.monotonic() - looked > _LOOK and client.status == "running":  # workers come and go
            threads, looked = sum(client.nthreads().values()), time.monotonic()
        fill()


def _check_pickled(task: Task | None) -> None:
    """Refuse what cannot be handed to another process."""
    try:
        pickle.dumps(task)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise InvalidInputError(
            "engine",
            "be handed what can be pickled",
            f"{type(task).__name__}: {error}",
            advice="make the parts of its solver frozen dataclasses, or take no workers",
        ) from error


def _do(tasks: tuple[Task, ...]) -> tuple[list[Any | Exception], float]:
    """Do tasks one after the other; return what came of them or was raised, and the seconds."""
    distributed: Any = optional("distributed", extra="batch", needed_by="a run with workers")
    worker = distributed.get_worker()
    limit = worker.memory_manager.memory_limit  # of the process; None for none
    share = limit / 2**30 / worker.state.nthreads if limit else None
    start, results = time.monotonic(), list[Any]()
    with single_threaded(), memory_of(share):
        for _, result in in_this_process(tasks):
            results.append(result)
    if len(tasks) == 1 and isinstance(results[0], Exception):
        raise results[0]  # Dask knows how to hand over what cannot be pickled
    return results, time.monotonic() - start
