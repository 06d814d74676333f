"""`run_tasks`: solve the spectra, match the pairs in processes side by side, remember both."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import cast

import numpy as np

from spectra_kit._files import atomic_path
from spectra_kit._validate import check_count
from spectra_kit.correspondence import way_back
from spectra_kit.errors import InvalidInputError, SpectraKitError
from spectra_kit.evaluation.matching.measure import Geodesics, PairResult, measure_pair
from spectra_kit.evaluation.matching.methods import METHODS, Side, match_pyfm
from spectra_kit.evaluation.matching.oracle import best_candidate
from spectra_kit.evaluation.matching.processes import done, workers
from spectra_kit.evaluation.matching.spectra import (
    BACKENDS,
    KINDS,
    Kind,
    geometry_of,
    load_spectrum,
    points_of,
    solve_to,
    spectrum_path,
)
from spectra_kit.evaluation.matching.subjects import Subject
from spectra_kit.evaluation.matching.table import PairTable, Task
from spectra_kit.spectra import Spectrum

_HELD = 8  # spectra in the memory of a process


@dataclass(frozen=True, eq=False, kw_only=True)
class Settings:
    """What the processes share.

    Attributes
    ----------
    subjects : mapping of str to Subject
        By name.
    folder : Path
        For spectra, maps and the table; made if missing.
    k : int, default 150
        Modes of each spectrum.
    weights : str, default "small"
        Of the network.
    pyfm_python : str, optional
        The Python that has pyFM, if another.
    geodesics : {"edges", "exact"}, default "edges"
        How errors are measured; see `measure_pair`.
    """

    subjects: Mapping[str, Subject]
    folder: Path
    k: int = 150
    weights: str = "small"
    pyfm_python: str | None = None
    geodesics: Geodesics = "edges"

    def spectrum_path(self, name: str, kind: str, backend: str) -> Path:
        """Return where the spectrum of a subject lies."""
        return spectrum_path(
            self.folder / "spectra",
            self.subjects[name],
            cast(Kind, kind),
            backend,
            k=self.k,
            weights=self.weights,
        )

    def map_path(self, task: Task) -> Path:
        """Return where the point map of a task lies: named by what its result is remembered by."""
        run = f"{task.kind}-{task.backend}-{task.method}"
        name = f"{task.source}--{task.target}--{self.digest(task)}.npy"
        return self.folder / "maps" / run / name

    def digest(self, task: Task) -> str:
        """Hash of what a result is remembered by: the inputs and how they are measured.

        Those are the two subjects and the keys of their spectra, which hold the release. The code
        between two releases is not: what it changes is measured anew in another folder.
        """
        digest = hashlib.blake2b(digest_size=12)
        for name in (task.source, task.target):
            digest.update(self.subjects[name].digest.encode())
            digest.update(self.spectrum_path(name, task.kind, task.backend).name.encode())
        if self.geodesics != "edges":
            digest.update(self.geodesics.encode())
        if task.method == "pyfm" and self.pyfm_python:
            digest.update(self.pyfm_python.encode())
        return digest.hexdigest()


@dataclass(frozen=True, eq=False)
class Run:
    """Everything that was asked for, as far as it could be measured.

    Attributes
    ----------
    results : dict of Task to PairResult
        In the order of the tasks.
    failures : dict of Task to str
        Why there is no result. Failures are not remembered.
    """

    results: dict[Task, PairResult] = field(default_factory=dict)
    failures: dict[Task, str] = field(default_factory=dict)


def make_tasks(
    pairs: Iterable[tuple[str, str]],
    *,
    kinds: Sequence[str] = ("mesh",),
    backends: Sequence[str] = ("exact",),
    methods: Sequence[str] = ("match",),
) -> list[Task]:
    """Combine pairs with what is to be run on them.

    Parameters
    ----------
    pairs : iterable of (str, str)
        Names of source and target.
    kinds, backends, methods : sequence of str
        Among `KINDS`, `BACKENDS` and `METHODS`.

    Returns
    -------
    list of Task
        All combinations, pair by pair.

    Raises
    ------
    InvalidInputError
        If a name is none of those known.

    Examples
    --------
    >>> from spectra_kit.evaluation.matching import make_tasks
    >>> len(make_tasks([("a", "b"), ("b", "a")], kinds=["mesh", "cloud"]))
    4

    pyFM solves for itself, and knows no clouds: it is asked once for each pair.

    >>> tasks = make_tasks([("a", "b")], backends=["exact", "neo"], methods=["pyfm"])
    >>> [task.backend for task in tasks]
    ['exact']
    """
    for name, values, known in (
        ("kinds", kinds, KINDS),
        ("backends", backends, BACKENDS),
        ("methods", methods, tuple(METHODS)),
    ):
        if unknown := [value for value in values if value not in known]:
            raise InvalidInputError(
                f"`{name}` must be among {', '.join(known)}, got {', '.join(unknown)}"
            )
    ours = [method for method in methods if method != "pyfm"]
    runs = [(kind, backend, m) for m in ours for kind in kinds for backend in backends]
    if "pyfm" in methods:
        runs.append(("mesh", "exact", "pyfm"))
    return [Task(*pair, *run) for pair in pairs for run in runs]


def run_tasks(
    tasks: Sequence[Task], settings: Settings, *, jobs: int = 1, progress: bool = False
) -> Run:
    """Match every pair whose result or map is missing.

    Parameters
    ----------
    tasks : sequence of Task
        See `make_tasks`.
    settings : Settings
        Subjects and folder.
    jobs : int, default 1
        Processes side by side, of one thread each; with 1 everything runs in this process, on one
        thread, too.
    progress : bool, default False
        Show a bar on a terminal.

    Returns
    -------
    Run
        Each result is a line of ``pairs.csv`` as soon as it is there; the same call after an
        interruption goes on from there.
    """
    check_count("jobs", jobs, low=1)
    (settings.folder / "spectra").mkdir(parents=True, exist_ok=True)
    table = PairTable(settings.folder / "pairs.csv")
    digests = {task: settings.digest(task) for task in tasks}
    missing = [
        task
        for task in tasks
        if table.get(task, digests[task]) is None or not settings.map_path(task).exists()
    ]
    run = Run()
    if missing:
        for path in {settings.map_path(task).parent for task in missing}:
            path.mkdir(parents=True, exist_ok=True)
        with workers(jobs, _begin, settings) as submit:
            wanted = {
                (name, task.kind, task.backend): settings.spectrum_path(
                    name, task.kind, task.backend
                )
                for task in missing
                for name in (task.source, task.target)
            }
            unsolved = [which for which, path in wanted.items() if not path.exists()]
            reasons: dict[tuple[str, str, str], str] = {}
            for which, reason in done(submit, _solve, unsolved, "spectrum", progress):
                if reason is not None:
                    reasons[which] = reason
            ready = []
            for task in missing:
                ends = [(name, task.kind, task.backend) for name in (task.source, task.target)]
                why = [f"{end[0]}: {reasons[end]}" for end in ends if end in reasons]
                if why:
                    run.failures[task] = why[0]
                else:
                    ready.append(task)
            for task, answer in done(submit, _match, ready, "pair", progress):
                if isinstance(answer, str):
                    run.failures[task] = answer
                else:
                    table.add(task, digests[task], answer)
    for task in tasks:
        result = table.get(task, digests[task])
        if result is not None:
            run.results[task] = result
    return run


# --- in the processes ---

_SHARED: list[Settings] = []  # of this process


def _begin(settings: Settings) -> None:
    """Take the settings."""
    _SHARED[:] = [settings]
    _spectrum.cache_clear()


def _solve(which: tuple[str, str, str]) -> str | None:
    """Solve one spectrum; return what went wrong."""
    name, kind, backend = which
    settings = _SHARED[0]
    try:
        solve_to(
            settings.spectrum_path(*which),
            settings.subjects[name],
            cast(Kind, kind),
            backend,
            k=settings.k,
            weights=settings.weights,
        )
    except SpectraKitError as error:
        return str(error)
    return None


def _match(task: Task) -> PairResult | str:
    """Match one pair, write the map and measure it; or return what went wrong."""
    settings = _SHARED[0]
    method = METHODS[task.method]
    if task.method == "pyfm" and settings.pyfm_python:
        method = partial(match_pyfm, python=settings.pyfm_python)
    source, target = (settings.subjects[name] for name in (task.source, task.target))
    kind = cast(Kind, task.kind)
    try:
        a, b = (
            Side(
                geometry_of(subject, kind),
                _spectrum(settings.spectrum_path(subject.name, kind, task.backend)),
            )
            for subject in (source, target)
        )
        outcome = method(a, b)
        (vertex_1, point_1), (vertex_2, point_2) = (points_of(s, kind) for s in (source, target))
        back = way_back(a.spectrum, b.spectrum, outcome.point_map)
        best = None
        if outcome.candidates:
            best = best_candidate(
                source,
                target,
                (a.spectrum, b.spectrum),
                outcome.candidates,
                vertex_1,
                point_2,
            )
        # From points of the spectra to vertices of the meshes.
        outcome = replace(outcome, point_map=vertex_1[outcome.point_map[point_2]])
        result = measure_pair(
            source,
            target,
            outcome,
            vertex_2[back[point_1]],
            best=None if best is None else vertex_1[best[point_2]],
            geodesics=settings.geodesics,
        )
        with atomic_path(settings.map_path(task)) as part:
            np.save(part, outcome.point_map.astype(np.int32))
    except SpectraKitError as error:
        return str(error)
    return result


@lru_cache(maxsize=_HELD)
def _spectrum(path: Path) -> Spectrum:
    return load_spectrum(path)
