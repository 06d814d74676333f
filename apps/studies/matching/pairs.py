"""The two studies of matching: `Spectra` of subjects, and `Pairs` that are matched with them."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import ClassVar, Literal, NamedTuple

import numpy as np

from spectra_kit._core.files import atomic_path
from spectra_kit._core.types import Ints
from spectra_kit._core.validate import check_count
from spectra_kit.catalogue import SOLVERS, SUBSPACES
from spectra_kit.eigen import Eigensolver, Spectrum, eigensolve
from spectra_kit.geometry import Geometry, TriangleMesh
from spectra_kit.geometry.shapes import distinct_rows
from spectra_kit.maps import Truth, geodesic_errors, inverse_map
from spectra_kit.operators import laplacian
from studies.matching.measures import Geodesics, best_candidate, measure_map
from studies.matching.methods import METHODS, Side
from studies.matching.subjects import Subject, truth_between
from studies.store import Record, Store
from studies.study import Result, Study, run

Kind = Literal["mesh", "cloud"]
KINDS: tuple[Kind, ...] = ("mesh", "cloud")
#: From the weights to what solves: exactly, the network, refined to the end.
BACKENDS: dict[str, Callable[[str], Eigensolver]] = {
    "exact": lambda weights: SOLVERS["automatic"](),
    "neo": lambda weights: SOLVERS["neo"](weights=weights),
    "neo-refined": lambda weights: SOLVERS["refined"](start=SUBSPACES["neo"](weights)),
}
_POINTS = 300  # of a pair whose own errors are kept
_HELD = 8  # spectra in the memory of a process


class Pair(NamedTuple):
    """The names of two subjects."""

    source: str
    target: str

    def __str__(self) -> str:
        return "--".join(self)


class Basis(NamedTuple):
    """Which modes: of meshes or of their vertices alone, by one of `BACKENDS`."""

    kind: Kind
    backend: str

    def __str__(self) -> str:
        return "-".join(self)


class Way(NamedTuple):
    """Which modes, and which of `METHODS` matches with them."""

    basis: Basis
    method: str

    def __str__(self) -> str:
        return f"{self.basis}-{self.method}"

    @property
    def label(self) -> str:
        """For tables and figures; clouds are named, and of methods that solve no backend."""
        own = METHODS[self.method].own
        label = self.method if own else f"{self.method}, {self.basis.backend}"
        return label + (", clouds" if self.basis.kind == "cloud" else "")


@dataclass(frozen=True, eq=False, kw_only=True)
class Spectra(Study[Basis, str]):
    """Modes of subjects, given by their names; `k` of them, by a network of these `weights`."""

    name: ClassVar[str] = "spectrum"
    fresh: ClassVar[bool] = False

    subjects: Mapping[str, Subject]
    k: int = 150
    weights: str = "small"

    def facts(self, contender: Basis, problem: str) -> dict[str, object]:
        return {
            "subject": [problem, self.subjects[problem].digest],  # the file has its name
            "kind": contender.kind,
            "solver": _options(contender.backend, self.weights),
            "k": self.k,
        }

    def path(self, basis: Basis, name: str) -> Path:
        """Return where a spectrum lies."""
        return self.folder / "spectra" / f"{name}-{basis}-{self.key(basis, name)}.npz"

    def measure(self, contender: Basis, problem: str) -> Record:
        """Solve into the file."""
        geometry = geometry_of(self.subjects[problem], contender.kind)
        solver = BACKENDS[contender.backend](self.weights)
        spectrum = eigensolve(laplacian(geometry), self.k, solver)
        path = self.path(contender, problem)
        path.parent.mkdir(exist_ok=True)
        spectrum.save(path)
        return {"seconds": spectrum.provenance.solving_seconds, "files": [f"spectra/{path.name}"]}


@dataclass(frozen=True, eq=False, kw_only=True)
class Pairs(Study[Way, Pair]):
    """Maps between subjects, and their errors."""

    name: ClassVar[str] = "pair"
    version: ClassVar[int] = 3
    fresh: ClassVar[bool] = False

    spectra: Spectra  #: Of all subjects.
    #: Why there is no spectrum, where there is none.
    unsolved: Mapping[tuple[Basis, str], str] = field(default_factory=dict)
    geodesics: Geodesics = "edges"  #: How errors are measured; see `measure_map`.
    pyfm_python: str | None = None  #: The Python that has pyFM, if another.

    def facts(self, contender: Way, problem: Pair) -> dict[str, object]:
        """See `Study`; the spectra by their keys."""
        return {
            "subjects": [self.spectra.subjects[name].digest for name in problem],
            "spectra": [self.spectra.key(contender.basis, name) for name in problem],
            "method": contender.method,
            "python": self.pyfm_python if METHODS[contender.method].own else None,
            "geodesics": self.geodesics,
        }

    def excuse(self, contender: Way, problem: Pair, before: Sequence[Result[Way, Pair]]) -> str:
        """See `Study`; without spectra there is no map."""
        for name in problem:
            if reason := self.unsolved.get((contender.basis, name)):
                return f"{name}: {reason}"
        return ""

    def map_path(self, way: Way, pair: Pair) -> Path:
        """Return where a map lies: the source vertex of each target vertex."""
        return self.folder / "maps" / str(way) / f"{pair}--{self.key(way, pair)}.npy"

    def measure(self, contender: Way, problem: Pair) -> Record:
        """Match, write the map and measure it."""
        run = METHODS[contender.method].run
        if METHODS[contender.method].own and self.pyfm_python:
            run = partial(run, python=self.pyfm_python)
        basis = contender.basis
        source, target = (self.spectra.subjects[name] for name in problem)
        a, b = (
            Side(geometry_of(s, basis.kind), _loaded(self.spectra.path(basis, s.name)))
            for s in (source, target)
        )
        outcome = run(a, b)
        (vertex_1, point_1), (vertex_2, point_2) = (
            _points_of(s, basis.kind) for s in (source, target)
        )
        back, best = inverse_map(a.spectrum, b.spectrum, outcome.point_map), None
        if outcome.candidates:
            best = best_candidate(
                source, target, (a.spectrum, b.spectrum), outcome.candidates, vertex_1, point_2
            )
        # From points of the spectra to vertices of the meshes.
        outcome = replace(outcome, point_map=vertex_1[outcome.point_map[point_2]])
        measured = measure_map(
            source,
            target,
            outcome,
            vertex_2[back[point_1]],
            best=None if best is None else vertex_1[best[point_2]],
            geodesics=self.geodesics,
        )
        path = self.map_path(contender, problem)
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(path) as part:
            np.save(part, outcome.point_map.astype(np.int32))
        files = [path]
        if len(outcome.seen):
            files.append(path.with_suffix(".points.npz"))
            truth = truth_between(source, target)
            some = np.linspace(0, len(truth.source) - 1, min(_POINTS, len(truth.source))).astype(
                int
            )
            truth = Truth(truth.source[some], truth.target[some])
            errors = geodesic_errors(source.mesh, outcome.point_map, truth)
            with atomic_path(files[1]) as part:
                np.savez(part, seen=outcome.seen[point_2[truth.target]], errors=errors)
        return {**measured, "files": [str(file.relative_to(self.folder)) for file in files]}


def ways(
    kinds: Iterable[Kind] = ("mesh",),
    backends: Iterable[str] = ("exact",),
    methods: Iterable[str] = ("match",),
) -> list[Way]:
    """Combine; a method that solves for itself, on meshes, is asked once."""
    bases = [Basis(kind, backend) for kind, backend in itertools.product(kinds, backends)]
    ours = [method for method in methods if not METHODS[method].own]
    own = [Way(Basis("mesh", "exact"), method) for method in methods if METHODS[method].own]
    return [Way(basis, method) for method in ours for basis in bases] + own


def match_all(pairs: Pairs, *, jobs: int = 1, progress: bool = False) -> list[Result[Way, Pair]]:
    """Match what is not remembered, `jobs` pairs side by side, after the spectra for it.

    Each process has one thread, so times of one job are those of many; with 0 all is done in this
    process. What failed is tried again.
    """
    check_count("jobs", jobs, low=0)
    store = Store(pairs.folder)
    names = {
        name: None
        for way, pair, _ in pairs.tasks()
        if (store.get(pairs.key(way, pair)) or {"status": ""})["status"] != "ok"
        for name in pair
    }
    spectra = replace(pairs.spectra, problems=list(names))
    solved = run(spectra, store, jobs=jobs, retry=True, progress=progress)
    unsolved = {(r.contender, r.problem): r.reason for r in solved if not r.ok}
    pairs = replace(pairs, unsolved=unsolved)
    return run(pairs, store, jobs=jobs, retry=True, progress=progress)


def geometry_of(subject: Subject, kind: Kind) -> Geometry:
    """Return the geometry, or its points alone, of those at one place the first."""
    geometry = subject.geometry
    if kind == "mesh" or not isinstance(geometry, TriangleMesh):
        return geometry
    return geometry.as_cloud().without_duplicates()


def _points_of(subject: Subject, kind: Kind) -> tuple[Ints, Ints]:
    """Return the point of the subject for each of `geometry_of`, and the other way round."""
    geometry = subject.geometry
    if geometry_of(subject, kind) is geometry:
        same = np.arange(geometry.n)
        return same, same
    return distinct_rows(geometry.points)


@cache
def _options(backend: str, weights: str) -> str:
    """All that a solver is made of, a hash of its weights included."""
    return repr(BACKENDS[backend](weights))


@lru_cache(maxsize=_HELD)
def _loaded(path: Path) -> Spectrum:
    return Spectrum.load(path)
