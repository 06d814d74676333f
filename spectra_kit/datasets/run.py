"""`compute_all`: every input, by whoever works, into one store; failures beside results."""

from __future__ import annotations

import os
import random
import socket
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Generic, NamedTuple, Protocol, TypeVar, runtime_checkable

from spectra_kit._core.checked import checked
from spectra_kit._core.clock import Clock
from spectra_kit._core.threads import ranges
from spectra_kit._core.validate import Brief, quantity, warn
from spectra_kit.datasets.completion import Completed, complete, known
from spectra_kit.datasets.inputs import Input, Named, Pair, refuse_twice
from spectra_kit.datasets.plan import Plan
from spectra_kit.datasets.store import SpectrumStore
from spectra_kit.datasets.together import begin
from spectra_kit.errors import InvalidInputError, SplitSurfaceWarning, StoreError
from spectra_kit.geometry.diagnose import UNJOINED

Thing = TypeVar("Thing")
Result = TypeVar("Result", bound="_Result")

_ALIKE = 32  # inputs of similar size that stay side by side for a solver that takes several


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
class _Completion:
    """An input that is to be completed."""

    input: Input
    store: Path
    plan: Plan

    @property
    def name(self) -> str:
        return self.input.name

    def __call__(self) -> Completed:
        return complete(SpectrumStore(self.store), self.input.name, self.input.path, self.plan)

    @staticmethod
    def begin(tasks: Sequence[_Completion]) -> Iterator[Callable[[], Completed]]:
        """Return what is left of those of one run: see `datasets.together.begin`."""
        store, plan = SpectrumStore(tasks[0].store), tasks[0].plan
        return begin(store, ((task.input.name, task.input.path) for task in tasks), plan)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle it with paths from the root: who works may have another folder as theirs."""
        there = replace(self.input, path=self.input.path.absolute())
        return _Completion, (there, self.store.absolute(), self.plan)


@runtime_checkable
class _Result(Protocol):
    """What a store holds of an input, or of a pair."""

    @property
    def computed(self) -> bool: ...

    @property
    def replaced(self) -> tuple[str, ...]: ...


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class BatchReport(Brief, Generic[Named, Result]):
    """What came of a run.

    Attributes
    ----------
    completed : tuple of (Input, Completed) or (Pair, Matched)
        In the order of the inputs, or of the pairs.
    failed : tuple of Failed
        In that order, too.
    seconds : float
        That it took.
    """

    completed: tuple[tuple[Named, Result], ...]
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


@checked
def compute_all(
    inputs: Sequence[Input],
    store: SpectrumStore,
    plan: Plan,
    *,
    engine: Engine | None = None,
    strict: bool = False,
    progress: Callable[[int, int], object] | None = None,
) -> BatchReport[Input, Completed]:
    """Compute what a plan wants of all inputs, but for what the store has already.

    Interrupted, it loses what is in work; called again, it goes on. Several runs may share a store:
    each goes in an order of its own, and meets what others have done.

    Parameters
    ----------
    inputs : sequence of Input
        As `find_inputs` returns them.
    store : SpectrumStore
        Where all is kept.
    plan : Plan
        What is wanted.
    engine : Engine, optional
        Who works, such as a `DaskEngine`; by default this process, one shape after the other.
    strict : bool, default False
        Stop at the first failure, and raise it; go in the order of the inputs.
    progress : callable, optional
        Told how many inputs of how many are done.

    Returns
    -------
    BatchReport
        Results and failures.

    Raises
    ------
    InvalidInputError
        If two inputs have one name.
    StoreError
        If the store cannot be written: no other shape could be kept either.
    SpectraKitError
        Of the first input that fails, if it is `strict`; or if the engine is lost.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import spectra_kit as sk
    >>> folder = Path(tempfile.mkdtemp())
    >>> sk.geometry.write(sk.geometry.creature(600), folder / "animal.off")
    >>> _ = (folder / "empty.off").write_text("")
    >>> inputs = sk.datasets.find_inputs([folder])
    >>> store = sk.datasets.SpectrumStore(folder / "store")
    >>> report = sk.datasets.compute_all(inputs, store, sk.datasets.Plan(k=12))
    >>> report.computed, [str(failed.error).split(": ")[-1] for failed in report.failed]
    (1, ['the file is empty'])
    """
    refuse_twice("inputs", [one.name for one in inputs])
    clock = Clock()
    found, todo = list[Any](), list[int]()
    for i, one in enumerate(inputs):
        found.append(known(store, one.name, one.path, plan))
        if found[i] is None:
            todo.append(i)
        elif progress is not None:
            progress(len(found) - len(todo), len(inputs))
    if not strict:
        todo = _in_own_order(todo, inputs, plan)
    tasks = [_Completion(inputs[i], Path(store.path), plan) for i in todo]
    before = len(found) - len(todo)
    results = work(tasks, engine=engine, strict=strict, progress=progress, before=before)
    for i, result in zip(todo, results, strict=True):
        found[i] = result
    report = report_of([*zip(inputs, found, strict=True)], clock)
    cut = [
        one.name
        for one, done in report.completed
        if any(UNJOINED in p for p in done.record.problems)
    ]
    if cut:
        warn(
            f"{quantity(len(cut), 'shape')} of {len(inputs):,}, such as {cut[0]!r}: boundary edges"
            f" lie on others, {UNJOINED}, and cut the surface",
            SplitSurfaceWarning,
            advice="join them with {}",
            remedies=("Plan(repair=True)",),
        )
    return report


def report_of(told: Sequence[tuple[Named, Any]], clock: Clock) -> BatchReport[Named, Any]:
    """Return the report of results, some of which are failures."""
    return BatchReport(
        completed=tuple((one, done) for one, done in told if not isinstance(done, Exception)),
        failed=tuple(Failed(one, done) for one, done in told if isinstance(done, Exception)),
        seconds=clock.total,
    )


def _in_own_order(todo: list[int], inputs: Sequence[Input], plan: Plan) -> list[int]:
    """Return the places of inputs in an order of our own, those of one size side by side.

    Unless one by one is as good for the solver.
    """
    if not hasattr(plan.solver, "begin"):
        return own_order(todo)
    alike = sorted(todo, key=lambda i: _bytes(inputs[i].path))
    return [i for cut in own_order(ranges(len(alike), _ALIKE)) for i in alike[slice(*cut)]]


def _bytes(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0  # `read` says why


def own_order(things: Sequence[Thing]) -> list[Thing]:
    """Return things in an order of this process's own, for runs that share a store.

    Not just from another beginning: one that comes to where another is would go on in step.
    """
    own = random.Random(f"{socket.gethostname()} {os.getpid()}")
    return own.sample(things, len(things))


def work(
    tasks: Sequence[Task],
    *,
    engine: Engine | None,
    strict: bool,
    progress: Callable[[int, int], object] | None,
    before: int = 0,
) -> list[Any | Exception]:
    """Return what came of each task, or what it raised.

    So many other things were done `before`. Without a task no engine is begun.
    """
    if not tasks:
        return []
    found, places = dict[int, Any](), {id(task): i for i, task in enumerate(tasks)}
    results = (engine or in_this_process)(tasks)
    if not isinstance(results, Iterable):
        raise InvalidInputError("engine", "return tasks with their results", repr(results))
    try:
        for task, result in results:
            if isinstance(result, BaseException) and (
                strict or not isinstance(result, Exception) or isinstance(result, StoreError)
            ):
                raise result
            found[places[id(task)]] = result
            if progress is not None:
                progress(before + len(found), before + len(tasks))
    finally:
        if isinstance(results, Generator):
            results.close()  # workers end now, not when somebody collects what is left of them
    return [found[i] for i in range(len(tasks))]


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
