"""`Study`: who is measured on what; `run` does it, remembers it, and goes on after an interrupt."""

from __future__ import annotations

import statistics
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from tqdm import tqdm

from spectra_kit._core.fingerprint import facts_digest
from studies.store import Record, Store, code_digest
from studies.worker import FailedError, Limits, Pool, StoppedError

Contender = TypeVar("Contender")
Problem = TypeVar("Problem")


@dataclass(frozen=True, eq=False)
class Result(Generic[Contender, Problem]):
    """One measurement, or why there is none."""

    contender: Contender  #: Of the study.
    problem: Problem
    repeat: int  #: Which one.
    #: What `Study.measure` returned, with ``"status"``: ``"ok"``, ``"failed"``, ``"stopped"`` or
    #: ``"skipped"``, the last three with a ``"reason"``.
    record: Record

    @property
    def ok(self) -> bool:
        """Whether it was measured."""
        return bool(self.record["status"] == "ok")

    @property
    def reason(self) -> str:
        """Why it was not."""
        return str(self.record.get("reason", ""))


def measured_by(
    results: Iterable[Result[Contender, Problem]],
) -> dict[Contender, list[Result[Contender, Problem]]]:
    """Gather what was measured of each contender, in the order of the first of each."""
    groups: dict[Contender, list[Result[Contender, Problem]]] = {}
    for result in results:
        if result.ok:
            groups.setdefault(result.contender, []).append(result)
    return groups


@dataclass(frozen=True, eq=False)
class Repeats(Generic[Contender, Problem]):
    """All repeats of one contender on one problem."""

    contender: Contender  #: Of the study.
    problem: Problem
    results: tuple[Result[Contender, Problem], ...]  #: At least one.

    @property
    def ok(self) -> bool:
        """Whether all were measured."""
        return all(result.ok for result in self.results)

    def values(self, name: str) -> list[Any]:
        """Return what the records hold under a name, without those that do not."""
        found = (result.record.get(name) for result in self.results)
        return [value for value in found if value is not None]

    def first(self, name: str) -> Any:
        """Return the first of these, or None."""
        return next(iter(self.values(name)), None)

    def largest(self, name: str) -> Any:
        """Return the largest of these, or None."""
        return max(self.values(name), default=None)

    def median(self, name: str) -> float | None:
        """Return the median of these, or None where something was not measured."""
        values = self.values(name)
        return statistics.median(values) if values and self.ok else None


def repeats_of(results: Iterable[Result[Contender, Problem]]) -> list[Repeats[Contender, Problem]]:
    """Gather the repeats, in the order of the first of each."""
    groups: dict[tuple[str, str], list[Result[Contender, Problem]]] = {}
    for result in results:
        groups.setdefault((str(result.contender), str(result.problem)), []).append(result)
    return [Repeats(some[0].contender, some[0].problem, tuple(some)) for some in groups.values()]


@dataclass(frozen=True, eq=False, kw_only=True)
class Study(ABC, Generic[Contender, Problem]):
    """Who is measured on what, and how.

    It is sent to processes together with a contender and a problem, which name themselves by `str`.
    """

    name: ClassVar[str]  #: Of the class: in keys and files.
    version: ClassVar[int] = 1  #: Of the class: to be raised where the meaning of a number changes.
    #: Of the class: on which files of the package it depends; see `store.code_digest`.
    sources: ClassVar[tuple[str, ...]] = ()
    #: Of the class: whether every measurement has a process of its own.
    fresh: ClassVar[bool] = True

    folder: Path  #: That of the store.
    #: Each with each, problem by problem, all contenders by turns; see `tasks`.
    contenders: Sequence[Contender]
    problems: Sequence[Problem]
    repeats: int = 1  #: Of every measurement; each is remembered.

    @abstractmethod
    def facts(self, contender: Contender, problem: Problem) -> dict[str, object]:
        """Return all that decides the result, but for the code, as JSON.

        The inputs (by their hashes), the options, the hash of weights; for seconds the machine.
        """

    @abstractmethod
    def measure(self, contender: Contender, problem: Problem) -> Record:
        """Measure once; what of it was written by `file` stands under ``"files"``."""

    def tasks(self) -> Iterable[tuple[Contender, Problem, int]]:
        """Return what is to be measured, in order, with the number of the repeat."""
        return [
            (contender, problem, repeat)
            for problem in self.problems
            for repeat in range(self.repeats)
            for contender in self.contenders
        ]

    def excuse(
        self,
        contender: Contender,
        problem: Problem,
        before: Sequence[Result[Contender, Problem]],
    ) -> str:
        """Return why a measurement is not even tried, after those `before`, or nothing."""
        return ""

    def key(self, contender: Contender, problem: Problem, repeat: int = 0) -> str:
        """Hash of everything that decides the result."""
        return facts_digest(
            {
                "study": [self.name, self.version],
                "code": code_digest(self.sources),
                "facts": self.facts(contender, problem),
                "repeat": repeat,
            }
        )

    def file(self, contender: Contender, problem: Problem, suffix: str) -> Path:
        """Return where a measurement leaves its arrays."""
        return self.folder / "files" / f"{self.name}-{self.key(contender, problem)}{suffix}"


def run(
    study: Study[Contender, Problem],
    store: Store,
    *,
    limits: Limits = Limits(),  # noqa: B008, it is frozen
    jobs: int = 1,
    retry: bool = False,
    progress: bool = False,
) -> list[Result[Contender, Problem]]:
    """Measure what the store does not hold yet; return all results in the order of `Study.tasks`.

    The store gets a record as soon as it is there, also of what fails; with `retry` that is
    measured again. So many `jobs` run side by side, each within the limits; with 0 all is measured
    in this process, without any.
    """
    tasks = list(study.tasks())
    results: dict[int, Result[Contender, Problem]] = {}
    running: dict[Future[Any], tuple[int, str]] = {}
    measure = study.measure  # one object: a process keeps it, and the study with it
    with (
        tqdm(total=len(tasks), unit=study.name, disable=None if progress else True) as bar,
        (store.folder / "worker.log").open("ab") as log,
        Pool(jobs, limits, fresh=study.fresh, log=log) as pool,
    ):
        for i, (contender, problem, repeat) in enumerate(tasks):
            key = study.key(contender, problem, repeat)
            record = store.get(key)
            if record is not None and record["status"] != "ok" and retry:
                record = None
            if record is None and (
                reason := study.excuse(contender, problem, list(results.values()))
            ):
                record = {"status": "skipped", "reason": reason}
            if record is not None:
                results[i] = Result(contender, problem, repeat, record)
                bar.update()
                continue
            bar.set_description(f"{problem}, {contender}")
            running[pool.submit(measure, contender, problem)] = i, key
            if len(running) >= max(jobs, 1):
                _collect(study, store, tasks, running, results, bar)
        while running:
            _collect(study, store, tasks, running, results, bar)
    return [results[i] for i in range(len(tasks))]


def _collect(
    study: Study[Contender, Problem],
    store: Store,
    tasks: Sequence[tuple[Contender, Problem, int]],
    running: dict[Future[Any], tuple[int, str]],
    results: dict[int, Result[Contender, Problem]],
    bar: tqdm[Any],
) -> None:
    """Wait until something is measured, and remember it."""
    for future in wait(running, return_when=FIRST_COMPLETED).done:
        i, key = running.pop(future)
        contender, problem, repeat = tasks[i]
        try:
            answer = {"status": "ok", **future.result()}
        except FailedError as error:
            answer = {"status": "failed", "reason": str(error)}
        except StoppedError as error:
            answer = {"status": "stopped", "reason": str(error)}
        names = {"study": study.name, "contender": str(contender), "problem": str(problem)}
        record = store.add(key, {**names, "repeat": repeat, **answer})
        results[i] = Result(contender, problem, repeat, record)
        bar.update()
