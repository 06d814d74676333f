"""`measure`: every method on every problem, interleaved, into a file that a rerun continues."""

from __future__ import annotations

import hashlib
import json
import platform
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import IO

from tqdm import tqdm

from spectra_kit._validate import check_count, check_positive
from spectra_kit.benchmarks.code import code_digest
from spectra_kit.benchmarks.journal import Journal, Record
from spectra_kit.benchmarks.machine import available_memory, current_commit
from spectra_kit.benchmarks.methods import METHODS
from spectra_kit.benchmarks.problems import KINDS, Problem
from spectra_kit.benchmarks.process import StoppedError, Worker
from spectra_kit.errors import InvalidInputError

#: Of records and reports; raise it where the meaning of a number changes.
SCHEMA = 1
_SHARE = 0.85  # of the memory that is available, for one process
_PATIENCE = 24 * 3600.0  # seconds for assembly and for what is around a solve


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What to measure.

    Attributes
    ----------
    sizes : tuple of int
        Points of the demo animal, or of clouds drawn from a file's mesh.
    k : int
        Modes.
    methods : tuple of str
        Names in `METHODS`.
    kinds : tuple of {"mesh", "cloud"}
        Geometries.
    file : str
        A mesh instead of the demo animal.
    devices : tuple of {"cpu", "cuda"}
        A method that does not know a device is left out there.
    repeats : int
        Solves of each method on each problem.
    time_limit : float
        Seconds for one solve; a method that takes longer is skipped at larger sizes.
    exact_limit : float
        Seconds for the exact modes; without them there are no errors.
    memory_limit : int or None
        Bytes for one process; most of what is available by default.
    threads : int
        The same for every method.
    alone_from : int
        Points from which on no process waits while another one solves; each starts anew.
    machine, commit : str
        For the record; found out by default.
    retry : bool
        Measure again what had failed or was stopped.

    Raises
    ------
    InvalidInputError
        If a name is unknown or a number out of range.
    """

    sizes: tuple[int, ...] = (2000, 8000, 32000, 64000, 131000, 512000)
    k: int = 96
    methods: tuple[str, ...] = tuple(METHODS)
    kinds: tuple[str, ...] = ("mesh", "cloud")
    file: str = ""
    devices: tuple[str, ...] = ("cpu",)
    repeats: int = 3
    time_limit: float = 300.0
    exact_limit: float = 3600.0
    memory_limit: int | None = None
    threads: int = 1
    alone_from: int = 200_000
    machine: str = field(default_factory=platform.node)
    commit: str = field(default_factory=current_commit)
    retry: bool = False

    def __post_init__(self) -> None:
        for name in ("k", "repeats", "threads", "alone_from"):
            check_count(name, getattr(self, name), low=1)
        for size in self.sizes:
            check_count("sizes", size, low=500)
        check_positive("time_limit", self.time_limit)
        check_positive("exact_limit", self.exact_limit)
        if unknown := [name for name in self.methods if name not in METHODS]:
            raise InvalidInputError(
                f"`methods` must be among {', '.join(METHODS)}; got {', '.join(unknown)}"
            )
        if unknown := [name for name in self.devices if name not in ("cpu", "cuda")]:
            raise InvalidInputError(f"`devices` must be cpu or cuda, got {', '.join(unknown)}")
        self.problems()  # checks the rest

    @property
    def operators(self) -> dict[str, str]:
        """From each kind of geometry to the name of its operator."""
        return {kind: KINDS.get(kind, "") for kind in self.kinds}

    def problems(self) -> list[Problem]:
        """Problems, smallest first within each kind; a file's own mesh has one size."""
        return [
            Problem(kind=kind, points=points, operator=self.operators[kind], file=self.file)
            for kind in self.kinds
            for points in ((0,) if self.file and kind == "mesh" else sorted(set(self.sizes)))
        ]

    def candidates(self) -> list[tuple[str, str]]:
        """Methods with a device that they can run on."""
        return [
            (name, device)
            for device in self.devices
            for name in self.methods
            if device in METHODS[name].devices
        ]


def measure(settings: Settings, folder: Path, *, progress: bool = False) -> list[Record]:
    """Measure what `folder` does not hold yet.

    Parameters
    ----------
    settings : Settings
        What to measure.
    folder : Path
        Made if missing. ``measurements.jsonl`` gets a line for each solve as soon as it ends, also
        for those that fail; ``cache`` holds operators and exact modes (n * k numbers for each
        problem, made anew by other code) and may be deleted. Measurements made at other commits are
        kept, those of a method with other options are not.
    progress : bool, default False
        Show a bar on a terminal.

    Returns
    -------
    list of dict
        One for each solve asked for: measured now or before, or why it was not.

    Raises
    ------
    InvalidInputError
        If ``measurements.jsonl`` is damaged before its last line.

    Notes
    -----
    Every method gets a process of its own on every problem, all with the same number of threads,
    and solves something small first. The processes solve in turn, repeat by repeat, never two at
    once: a slow minute of the machine hits all alike. Between its turns a process holds its
    operator but no modes; from ``alone_from`` points on it ends after each turn. The certificate's
    time is left out. Peak memory is the largest resident size above the one before the solve, with
    the operator loaded.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from spectra_kit.benchmarks import Settings, measure
    >>> settings = Settings(sizes=(600,), k=6, methods=("arpack",), kinds=("mesh",), repeats=1)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     [record] = measure(settings, Path(folder))
    >>> record["status"], record["n"], record["missed"]
    ('ok', 600, 0)
    """
    (folder / "cache").mkdir(parents=True, exist_ok=True)
    journal = Journal(folder / "measurements.jsonl", retry=settings.retry)
    problems, candidates = settings.problems(), settings.candidates()
    solvers = {name: METHODS[name].options for name in settings.methods}
    given_up: dict[tuple[str, str, str], str] = {}
    found: list[Record] = []
    bar = tqdm(
        total=len(problems) * len(candidates) * settings.repeats,
        unit="solve",
        disable=None if progress else True,
    )
    with bar, (folder / "worker.log").open("ab") as log:
        for problem in problems:
            bar.set_description(f"{problem.kind}, {problem.points:,} points")
            with _Stand(problem, settings, folder, log) as stand:
                for repeat in range(settings.repeats):
                    for method, device in candidates:
                        key = {
                            **stand.key,
                            "method": method,
                            "solver": solvers[method],
                            "device": device,
                            "threads": settings.threads,
                            "machine": settings.machine,
                            "repeat": repeat,
                        }
                        course = problem.kind, method, device
                        record = journal.get(key) or _excuse(method, given_up.get(course))
                        if record is None:
                            record = journal.add(key, stand.solve(method, device))
                        if record["status"] == "stopped":
                            at = f"stopped at {problem.points:,} points: {record['reason']}"
                            given_up.setdefault(course, at)
                        found.append({"key": key, **record})
                        bar.update()
    return found


def _excuse(method: str, given_up: str | None) -> Record | None:
    """Return why a method is not even tried, if so."""
    if not METHODS[method].present:
        return {"status": "absent", "reason": f"not installed: pip install {METHODS[method].pip}"}
    return {"status": "skipped", "reason": given_up} if given_up else None


class _Stand:
    """One problem, and the processes of the methods that solve it."""

    def __init__(self, problem: Problem, settings: Settings, folder: Path, log: IO[bytes]) -> None:
        self.problem, self.settings, self.log = problem, settings, log
        self.key = {"schema": SCHEMA, **problem.key(), "k": settings.k}
        made_by = {**self.key, "code": code_digest()}
        name = hashlib.sha256(json.dumps(made_by, sort_keys=True).encode()).hexdigest()[:24]
        self._files = {
            part: str(folder / "cache" / f"{name}-{part}.npz") for part in ("operator", "exact")
        }
        free = available_memory()
        self._memory = settings.memory_limit or (free and int(free * _SHARE))
        self._workers: dict[tuple[str, str], tuple[Worker, Record]] = {}
        self._compared: set[tuple[str, str]] = set()
        self._failures: dict[tuple[str, str], Record] = {}
        self._exits = ExitStack()

    def __enter__(self) -> _Stand:
        return self

    def __exit__(self, *error: object) -> None:
        self._exits.close()

    @cached_property
    def facts(self) -> Record:
        """Size and assembly of the problem, once its files are written, or why they are not."""
        operator, exact = self._files["operator"], self._files["exact"]
        with Worker(threads=self.settings.threads, log=self.log) as worker:
            request: Record = {
                "do": "assemble",
                "recipe": asdict(self.problem),
                "operator": operator,
            }
            try:
                facts = self._ask(worker, request)
            except StoppedError as error:
                facts = {"status": "failed", "reason": str(error)}
            if facts["status"] != "ok":
                return {**facts, "reason": f"no operator: {facts['reason']}"}
            request = {"do": "refer", "operator": operator, "exact": exact, "k": self.settings.k}
            try:
                reference = self._ask(worker, request, seconds=self.settings.exact_limit)
            except StoppedError as error:
                reference = {"reason": str(error)}
        return {**facts, "no_errors": reference.get("reason", "")}

    def solve(self, method: str, device: str) -> Record:
        """Measure a method once; what failed or was stopped is not tried again here."""
        who = method, device
        if self.facts["status"] != "ok":
            return self.facts
        if who in self._failures:
            return self._failures[who]
        try:
            record = {**self.facts, **self._solve(who)}
        except StoppedError as error:
            record = {**self.facts, "status": "stopped", "reason": str(error)}
        if record["status"] != "ok":
            self._failures[who] = record
        if record["status"] != "ok" or self.facts["n"] >= self.settings.alone_from:
            self._end(who)
        return record

    def _solve(self, who: tuple[str, str]) -> Record:
        worker, loaded = self._workers.get(who) or self._start(who)
        if loaded["status"] != "ok":
            return loaded
        # Later solves return the same, or peers with random starts nearly so.
        compare = who not in self._compared and not self.facts["no_errors"]
        request = {"do": "solve", "keep": compare}
        answer = self._ask(worker, request, seconds=self.settings.time_limit)
        if answer["status"] == "ok" and compare:
            answer |= self._ask(worker, {"do": "compare"})
            self._compared.add(who)
        return {**loaded, **answer, "commit": self.settings.commit}

    def _start(self, who: tuple[str, str]) -> tuple[Worker, Record]:
        """Start a process, have it load the operator and warm up."""
        worker = self._exits.enter_context(Worker(threads=self.settings.threads, log=self.log))
        load = {"do": "load", "method": who[0], "device": who[1], "k": self.settings.k}
        loaded = self._ask(worker, {**load, **self._files})
        self._workers[who] = worker, loaded
        return worker, loaded

    def _end(self, who: tuple[str, str]) -> None:
        if who in self._workers:  # not if it was stopped while it loaded
            self._workers.pop(who)[0].close()

    def _ask(self, worker: Worker, request: Record, seconds: float = _PATIENCE) -> Record:
        return worker.ask(request, seconds=seconds, memory=self._memory)
