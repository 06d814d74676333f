"""What runs over many things share: jobs, who does them, and a report of what came of each."""

from __future__ import annotations

import os
import random
import socket
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Literal, NamedTuple, Protocol, TypeVar, runtime_checkable

from spectra_kit._core.checked import checked
from spectra_kit._core.clock import Clock
from spectra_kit._core.records import Brief
from spectra_kit._core.threads import usable_cores
from spectra_kit.datasets.files import MapRecord, ShapeRecord
from spectra_kit.datasets.inputs import Input, Named, Pair
from spectra_kit.datasets.store import SpectrumStore
from spectra_kit.errors import InvalidInputError, StoreError

Thing = TypeVar("Thing")
Record = TypeVar("Record", ShapeRecord, MapRecord)
Progress = Callable[[int, int], object]


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Completed(Brief, Generic[Record]):
    """What a store holds of a file, or of a pair, now.

    Attributes
    ----------
    record : ShapeRecord or MapRecord
        What is known of it, and the keys of everything.
    computed : bool
        Whether a spectrum was solved for, or a map searched for; or was there.
    replaced : tuple of str
        What was damaged and computed again.
    renewed : bool
        Whether its name stood for other bytes before, of a file that has changed since or of
        another: what was known of these is known by this name no more.
    seconds : float
        That it took, with what was solved for at the same time.
    """

    record: Record
    computed: bool
    replaced: tuple[str, ...]
    renewed: bool = False
    seconds: float


class Failed(NamedTuple):
    """An input that could not be computed, or a pair that could not be matched.

    Attributes
    ----------
    input : Input or Pair
        Which.
    error : Exception
        Why.
    """

    input: Input | Pair
    error: Exception


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class BatchReport(Brief, Generic[Named, Record]):
    """What came of a run.

    Attributes
    ----------
    of : {"shapes", "pairs"}
        What it was about.
    completed : tuple of (Input or Pair, Completed)
        In the order of the inputs, or of the pairs.
    failed : tuple of Failed
        In that order, too.
    seconds : float
        That it took.
    """

    of: Literal["shapes", "pairs"]
    completed: tuple[tuple[Named, Completed[Record]], ...]
    failed: tuple[Failed, ...]
    seconds: float

    @property
    def computed(self) -> int:
        """How many spectra were solved for, or maps searched for; the others were there."""
        return sum(done.computed for _, done in self.completed)

    @property
    def replaced(self) -> tuple[str, ...]:
        """What was damaged, and made again."""
        return tuple(text for _, done in self.completed for text in done.replaced)


@runtime_checkable
class Task(Protocol):
    """Something to be done, here or elsewhere: it can be pickled, and called.

    What gains from several tasks of its kind at once may have a static method ``begin(tasks)``. It
    yields a function for each, in their order, that does what is left of it.
    """

    @property
    def name(self) -> str:
        """By which it is known among the others of a run."""

    def __call__(self) -> Any:
        """Do it, and return what came of it."""


@runtime_checkable
class Engine(Protocol):
    """Who works: takes tasks, and hands over each with its result, or what it raised."""

    def __call__(self, tasks: Iterable[Task]) -> Iterator[tuple[Task, Any | BaseException]]:
        """Do the tasks, in any order."""


@dataclass(frozen=True)
class Job:
    """A task: what is done with a store, of what is given; by `together`, of several at once."""

    name: str
    store: Path
    given: tuple[Any, ...]
    do: Callable[..., Completed[Any]]
    together: Callable[..., Iterator[Callable[[], Completed[Any]]]] | None = None

    def __call__(self) -> Completed[Any]:
        """Do it."""
        return self.do(SpectrumStore(self.store), *self.given)

    @staticmethod
    def begin(jobs: Sequence[Job]) -> Iterable[Callable[[], Completed[Any]]]:
        """Return what is left of those of one run."""
        first = jobs[0]
        if first.together is None:
            return jobs
        return first.together(SpectrumStore(first.store), [job.given for job in jobs])

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle it with paths from the root: who works may have another folder as theirs."""
        given = tuple(one.absolute() if isinstance(one, Path) else one for one in self.given)
        return Job, (self.name, self.store.absolute(), given, self.do, self.together)


def run(
    of: Literal["shapes", "pairs"],
    things: Sequence[Named],
    look: Callable[[Named], Completed[Any] | Exception | Job],
    order: Callable[[list[int]], list[int]],
    *,
    engine: Engine | None,
    strict: bool,
    progress: Progress | None,
) -> BatchReport[Named, Any]:
    """Do what is left to do of things, in some order of their places, and report of all.

    A `look` at each tells what there is of it, why there will be nothing, or the job.
    """
    clock = Clock()
    found: list[Any] = []
    places: dict[int, int] = {}  # of the jobs, by their identity
    for i, one in enumerate(things):
        found.append(look(one))
        if isinstance(found[i], Job):
            places[id(found[i])] = i
        elif strict and isinstance(found[i], Exception):
            raise found[i]
        elif progress is not None:
            progress(len(found) - len(places), len(things))
    done, jobs = len(things) - len(places), [found[i] for i in order([*places.values()])]
    results = (engine or in_this_process)(jobs) if jobs else iter(())  # no engine for nothing
    if not isinstance(results, Iterable):
        raise InvalidInputError("engine", "return tasks with their results", repr(results))
    try:
        for job, result in results:
            if isinstance(result, BaseException) and (
                strict or not isinstance(result, Exception) or isinstance(result, StoreError)
            ):
                raise result
            if id(job) not in places:
                raise InvalidInputError("engine", "return the tasks that it is given, each once")
            found[places.pop(id(job))] = result
            done += 1
            if progress is not None:
                progress(done, len(things))
    finally:
        if isinstance(results, Generator):
            results.close()  # workers end now, not when somebody collects what is left of them
    if places:
        raise InvalidInputError(
            "engine",
            "return all tasks with their results",
            f"{len(jobs) - len(places)} of {len(jobs)}",
        )
    told: list[tuple[Any, Any]] = [*zip(things, found, strict=True)]
    return BatchReport(
        of=of,
        completed=tuple((one, done) for one, done in told if not isinstance(done, Exception)),
        failed=tuple(Failed(one, done) for one, done in told if isinstance(done, Exception)),
        seconds=clock.total,
    )


def own_order(things: Sequence[Thing]) -> list[Thing]:
    """Return things in an order of this process's own, for runs that share a store.

    Not just from another beginning: one that comes to where another is would go on in step.
    """
    own = random.Random(f"{socket.gethostname()} {os.getpid()}")
    return own.sample(things, len(things))


def in_this_process(
    tasks: Iterable[Task],
) -> Generator[tuple[Task, Any | BaseException], None, None]:
    """Do one task after the other, here."""
    todo = list(tasks)
    begin = getattr(todo[0], "begin", None) if todo else None
    for task, rest in zip(todo, begin(todo) if begin else todo, strict=True):
        try:
            yield task, rest()
        except Exception as error:  # noqa: BLE001  # one task's failure, told with its name
            yield task, error


@dataclass(frozen=True)
class Spared:
    """Works here, and goes on with an engine once its start is worth it.

    A worker takes as long to start as this process took: its imports, and what the first task took
    more than the others. All of it comes twice: Dask is imported and started here, the workers
    after that. They gain the cores beside the threads that are busy here already. Seconds are those
    of processors, which other programs do not stretch.
    """

    engine: Engine

    def __call__(self, tasks: Iterable[Task]) -> Iterator[tuple[Task, Any | BaseException]]:
        """Do the tasks, in any order."""
        todo = list(tasks)
        imported, start, first = time.process_time(), time.perf_counter(), 0.0
        with closing(in_this_process(todo)) as results:
            for done, (task, result) in enumerate(results, start=1):
                yield task, result
                busy = time.process_time() - imported
                if done == 1:
                    first = busy
                    continue
                each = (busy - first) / (done - 1)
                threads = max(1.0, busy / (time.perf_counter() - start))
                left, begun = (len(todo) - done) * each, imported + max(first - each, 0.0)
                if left * (1 / threads - 1 / usable_cores()) > 2 * begun:
                    break
            else:
                return
        yield from self.engine(todo[done:])
