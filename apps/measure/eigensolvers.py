"""Eigensolvers side by side: seconds, memory and errors of every backend and of other packages."""

from __future__ import annotations

import hashlib
import itertools
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from measure import peers, tables
from measure.figures import dots, draw_pareto, legend, panels, save, ticks, undominated
from measure.machine import machine_line
from measure.shapes import read_operator, shape_at, write_operator
from measure.store import Record
from measure.study import Repeats, Result, Study, repeats_of
from measure.worker import clocked
from spectra_kit._validate import check_count
from spectra_kit.catalogue import OPERATORS, SOLVERS, SUBSPACES
from spectra_kit.eigensolvers import Eigensolver, eigensolve
from spectra_kit.errors import ConvergenceError
from spectra_kit.geometry import creature, sample, sphere
from spectra_kit.metrics import compare_spectra
from spectra_kit.operators import Laplacian
from spectra_kit.spectra import Spectrum
from spectra_kit.viz import ParetoPoint

Item = TypeVar("Item")
Name = TypeVar("Name")

#: The call that everybody writes: speeds are given as multiples of its.
BASELINE = "eigsh"
#: Geometries, and the operator of each.
KINDS = {"mesh": "robust", "cloud": "delaunay"}
#: Below this many points a solve is mostly overhead: such sizes take no part in exponents.
FIT_FROM = 7500
#: A line through two sizes fits always, and says nothing about a third.
FIT_SIZES = 3

_LARGE = 10_000  # points; a sphere of five subdivisions has 10,242
_BUSY = 0.05  # of a solve's time without a core; times are longer than they should be


# --- who ---


@dataclass(frozen=True, kw_only=True)
class Method:
    """A backend to measure.

    Attributes
    ----------
    make : callable
        From the device, "cpu" or "cuda", to the backend.
    stops : str
        Where it stops: at a tolerance, "rounding" of float64, its package's "default", or "" for
        a prediction, which has no such test.
    devices : tuple of str
        Where it can run.
    needs : str
        A module beyond the dependencies of this package, called as on PyPI, or nothing.
    peer : bool
        Whether it is another package's.
    slow : bool
        Whether it takes many times longer than the rest, and a quick comparison leaves it out.
    """

    make: Callable[[str], Eigensolver]
    stops: str = ""
    devices: tuple[str, ...] = ("cpu",)
    needs: str = ""
    peer: bool = False
    slow: bool = False

    @property
    def present(self) -> bool:
        """Whether what it needs is installed."""
        return not self.needs or find_spec(self.needs) is not None


_RTOL, _AT_RTOL = 1e-6, "1e-6"  # of every method of ours that takes one
_EXACT = "rounding"


def _ours(
    name: str, *, neo: str = "", device: bool = False, needs: str = "", **options: Any
) -> Method:
    """Return a solver of the catalogue; one that goes to a tolerance goes to ours.

    The network takes the place of its option `neo`; with `device` it has an option of that name.
    """
    solver = SOLVERS[name]
    if solver.accuracy == "to tolerance":
        options["rtol"] = _RTOL

    def make(where: str) -> Eigensolver:
        placed = {"device": where} if device else {}
        start = {neo: SUBSPACES["neo"](**placed)} if neo else {}
        made: Eigensolver = solver(**options, **start, **placed)
        return made

    return Method(
        make=make,
        stops={"exact": _EXACT, "to tolerance": _AT_RTOL}.get(solver.accuracy, ""),
        devices=("cpu", "cuda") if device else ("cpu",),
        needs=needs,
        slow=name == "lobpcg",
    )


def _theirs(solver: Eigensolver, stops: str, *, needs: str = "", slow: bool = False) -> Method:
    return Method(make=lambda device: solver, stops=stops, needs=needs, peer=True, slow=slow)


#: Name -> backend, in the order of tables: predictions, solvers to a tolerance, other packages.
METHODS: dict[str, Method] = {
    "fourier": _ours("fourier", subspace=SUBSPACES["fourier"](m=320, bandwidth=7.0)),
    "neo": _ours("neo", device=True),
    "neo-2": _ours("neo", device=True, poses=2),
    "neo-cap": _ours("neo", device=True, cap=4096),
    "capped-neo-raw": _ours("capped", neo="subspace", n_points=2048, sweeps=0, smoothing=0),
    "capped-neo-2k": _ours("capped", neo="subspace", n_points=2048),
    "capped-neo": _ours("capped", neo="subspace"),
    "capped": _ours("capped"),
    "polished": _ours("polished"),
    "polished-neo": _ours("polished", neo="start"),
    "multilevel": _ours("multilevel"),
    "refined": _ours("refined"),
    "refined-neo": _ours("refined", neo="start"),
    "chebyshev": _ours("chebyshev", device=True),
    "chebyshev-neo": _ours("chebyshev", neo="start", device=True),
    "lobpcg": _ours("lobpcg"),
    "lobpcg-amg": _ours("lobpcg", preconditioner="amg", needs="pyamg"),
    "arpack": _ours("arpack"),
    "eigsh": _theirs(peers.ScipyEigsh(), _EXACT),
    "eigsh-1e-6": _theirs(peers.ScipyEigsh(tol=_RTOL), _AT_RTOL),
    "eigsh-dnet": _theirs(peers.DiffusionNetEigsh(), _EXACT),
    "lapy": _theirs(peers.LapySolver(), _EXACT, needs="lapy"),
    "spectra": _theirs(peers.LibiglSpectra(), "default", slow=True),
    "lobpcg-pyamg": _theirs(peers.PyamgLobpcg(rtol=_RTOL), _AT_RTOL, needs="pyamg", slow=True),
}
#: What a quick comparison measures.
QUICK = tuple(name for name, method in METHODS.items() if not method.slow)


@dataclass(frozen=True)
class Contender:
    """A method on a device.

    Attributes
    ----------
    name : str
        In `METHODS`.
    device : {"cpu", "cuda"}
        Where it runs.
    """

    name: str
    device: str = "cpu"

    def __str__(self) -> str:
        return self.name if self.device == "cpu" else f"{self.name} ({self.device})"

    @property
    def method(self) -> Method:
        """What the name stands for."""
        return METHODS[self.name]

    @cached_property
    def solver(self) -> str:
        """Every option of the backend, whatever the device; "" where it is not installed."""
        return repr(self.method.make("cpu")) if self.method.present else ""


def contenders(names: Sequence[str], devices: Sequence[str] = ("cpu",)) -> list[Contender]:
    """Return methods on every device that they can run on, in the order of `METHODS`."""
    return [
        Contender(name, device)
        for device in devices
        for name, method in METHODS.items()
        if name in names and device in method.devices
    ]


# --- on what ---


@dataclass(frozen=True)
class Problem:
    """One eigenproblem, by its recipe, scaled to unit area.

    Attributes
    ----------
    kind : {"mesh", "cloud"}
        A cloud is drawn uniformly from the surface of the mesh.
    points : int
        To ask for; the demo animal meets it within 1 per cent. 0 for a file's own mesh.
    file : str
        A mesh; the demo animal without one.
    """

    kind: str
    points: int
    file: str = ""

    def __str__(self) -> str:
        return f"{self.kind}, {self.points:,} points" if self.points else self.kind

    @cached_property
    def facts(self) -> dict[str, object]:
        """All that decides the eigenproblem, as JSON."""
        model = "creature"
        if self.file:
            model = hashlib.blake2b(Path(self.file).read_bytes(), digest_size=12).hexdigest()
        return {
            "geometry": self.kind,
            "points": self.points,
            "model": model,
            "operator": KINDS[self.kind],
        }

    def assemble(self) -> Laplacian:
        """Assemble the operator and scale it to unit area; its `seconds` are of assembly alone."""
        mesh = shape_at(Path(self.file)).mesh if self.file else creature(self.points, seed=0)
        geometry = mesh if self.kind == "mesh" else sample(mesh, self.points, seed=0)
        start = time.perf_counter()
        assembled = OPERATORS[KINDS[self.kind]](geometry)
        seconds = time.perf_counter() - start
        return Laplacian(
            assembled.stiffness,  # of a surface: the same at every scale
            assembled.mass / assembled.area,
            assembled.points / np.sqrt(assembled.area),
            operator=assembled.operator,
            seconds=seconds,
        )


def problems(sizes: Iterable[int], kinds: Iterable[str] = KINDS, file: str = "") -> list[Problem]:
    """Return problems, smallest first within each kind; a file's own mesh has one size."""
    sizes = sorted({check_count("sizes", size, low=500) for size in sizes})
    return [
        Problem(kind, points, file)
        for kind in kinds
        for points in ((0,) if file and kind == "mesh" else sizes)
    ]


# --- how ---

OPERATOR, EXACT = "operator", "exact modes"


@dataclass(frozen=True, eq=False, kw_only=True)
class Preparation(Study[str, Problem]):
    """The operator of every problem, and its modes to machine precision.

    Attributes
    ----------
    k : int
        Modes.
    """

    name = "problem"
    fresh = False
    contenders: Sequence[str] = (OPERATOR, EXACT)
    k: int

    def facts(self, contender: str, problem: Problem) -> dict[str, object]:
        """See `Study`."""
        return {**problem.facts, "k": self.k if contender == EXACT else None}

    def excuse(
        self, contender: str, problem: Problem, before: Sequence[Result[str, Problem]]
    ) -> str:
        """See `Study`."""
        failed = [r.reason for r in before if r.problem == problem and not r.ok]
        return f"no operator: {failed[0]}" if failed else ""

    def measure(self, contender: str, problem: Problem) -> Record:
        """See `Study`."""
        path = self.file(contender, problem, ".npz")
        files = {"files": [f"files/{path.name}"]}
        if contender == EXACT:
            laplacian = read_operator(self.file(OPERATOR, problem, ".npz"))
            with clocked():
                spectrum = eigensolve(laplacian, self.k, SOLVERS["arpack"](tol=0.0))
            spectrum.save(path)
            return files
        ball = sphere(subdivisions=3).geometry  # so that no loading or compiling is measured
        OPERATORS[KINDS[problem.kind]](ball if problem.kind == "mesh" else ball.as_cloud())
        laplacian = problem.assemble()
        write_operator(laplacian, path)
        return {"n": laplacian.n, "assembly_seconds": laplacian.seconds, **files}


@dataclass(frozen=True, eq=False, kw_only=True)
class Solves(Study[Contender, Problem]):
    """Every method on every problem, each time in a process of its own that is warm.

    Attributes
    ----------
    prepared : Preparation
        Of the same problems.
    unprepared : mapping
        Why an operator or exact modes are missing, by `str` of what and of the problem.
    threads : int
        The same for every method.
    machine : str
        Whose seconds they are.
    """

    name = "solve"
    prepared: Preparation
    unprepared: Mapping[tuple[str, str], str] = field(default_factory=dict)
    threads: int = 1
    machine: str = ""

    @classmethod
    def of(
        cls, prepared: Preparation, results: Iterable[Result[str, Problem]], **options: Any
    ) -> Solves:
        """Return the study of what `prepared` has prepared, with these results."""
        missing = {(r.contender, str(r.problem)): r.reason for r in results if not r.ok}
        check_count("repeats", options.get("repeats", 1), low=1)
        return cls(
            folder=prepared.folder,
            problems=prepared.problems,
            prepared=prepared,
            unprepared=missing,
            **options,
        )

    def facts(self, contender: Contender, problem: Problem) -> dict[str, object]:
        """See `Study`."""
        return {
            **problem.facts,
            "k": self.prepared.k,
            "compared": (EXACT, str(problem)) not in self.unprepared,
            "solver": contender.solver,
            "device": contender.device,
            "threads": self.threads,
            "machine": self.machine,
        }

    def excuse(
        self,
        contender: Contender,
        problem: Problem,
        before: Sequence[Result[Contender, Problem]],
    ) -> str:
        """Leave out what is not there, what has failed here, and what was too slow before."""
        if not contender.method.present:
            return f"not installed: pip install {contender.method.needs}"
        if reason := self.unprepared.get((OPERATOR, str(problem))):
            return f"no operator: {reason}"
        for result in before:
            status = result.record["status"]
            if result.contender != contender or result.problem.kind != problem.kind:
                continue
            if result.problem == problem and not result.ok:
                return result.reason
            if status == "stopped":
                return f"stopped at {result.problem.points:,} points: {result.reason}"
        return ""

    def measure(self, contender: Contender, problem: Problem) -> Record:
        """See `Study`."""
        k, device = self.prepared.k, contender.device
        solver = contender.method.make(device)
        laplacian = read_operator(self.prepared.file(OPERATOR, problem, ".npz"))
        # So that no compiling, loading of weights or starting of a device is measured. Large
        # enough that no solver takes a shortcut that it will not take afterwards.
        ball = sphere(subdivisions=4 if laplacian.n < _LARGE else 5).geometry
        eigensolve(OPERATORS["robust"](ball), min(k, 16), solver)
        # Kept with the operator by its first user, and any of them may be the first.
        _ = laplacian.kernel_dimension, laplacian.component_spacings
        try:
            with clocked(device=device) as clock:
                spectrum = eigensolve(laplacian, k, solver)
        except ConvergenceError as error:
            reason = f"{error.n_converged} of {k} modes converged: {error}"
            return {"status": "failed", "reason": reason, "n": laplacian.n}
        certificate = spectrum.certificate
        assert certificate is not None
        residuals = certificate.relative_residuals
        return {
            "n": laplacian.n,
            "solver": contender.solver,
            "assembly_seconds": laplacian.seconds,
            "seconds": spectrum.provenance.solving_seconds,
            "stages": dict(spectrum.provenance.seconds),
            "waiting": clock.waited_seconds / clock.seconds,
            "iterations": spectrum.provenance.iterations,
            "peak_bytes": clock.peak_bytes,
            "device_peak_bytes": clock.device_peak_bytes,
            "residual_max": float(residuals.max()),
            "residual_median": float(np.median(residuals)),
            **self._errors(problem, spectrum),
        }

    def _errors(self, problem: Problem, spectrum: Spectrum) -> Record:
        if (EXACT, str(problem)) in self.unprepared:
            return {}
        exact = Spectrum.load(self.prepared.file(EXACT, problem, ".npz"), mmap=True)
        comparison = compare_spectra(exact, spectrum)
        return {
            "eigenvalue_error": comparison.mean_eigenvalue_error,
            "span_error": comparison.mean_span_error,
            # More than half of its energy is outside all that was found.
            "missed": int((comparison.span_error > 0.5).sum()),
        }


# --- what follows ---

Row = Repeats[Contender, Problem]


class Fit(NamedTuple):
    """An exponent, and the number of sizes that it was fitted to."""

    exponent: float
    sizes: int


def exponents(rows: Iterable[Row]) -> dict[tuple[str, Contender], Fit]:
    """Fit an exponent for each geometry and contender with enough sizes from `FIT_FROM` on."""
    lines: dict[tuple[str, Contender], dict[int, float]] = {}
    for row in rows:
        seconds = row.median("seconds")
        if seconds is not None and row.first("n") >= FIT_FROM:
            line = lines.setdefault((row.problem.kind, row.contender), {})
            line[row.first("n")] = seconds
    return {
        name: Fit(float(np.polyfit(np.log([*line]), np.log([*line.values()]), 1)[0]), len(line))
        for name, line in lines.items()
        if len(line) >= FIT_SIZES
    }


def write_report(
    study: Solves, results: Iterable[Result[Contender, Problem]], machine: Record
) -> list[Path]:
    """Write ``benchmark.json``, ``benchmark.md`` and the plots into the folder of the study.

    Parameters
    ----------
    study : Solves
        What was measured.
    results : iterable of Result
        Of `run`.
    machine : dict
        Of `describe_machine`.

    Returns
    -------
    list of Path
        What was written: JSON, Markdown, then ``time-KIND.png`` and ``accuracy-KIND-POINTS.png``.
    """
    rows, folder = repeats_of(results), study.folder
    fitted = exponents(rows)
    record = {
        "schema": 2,
        "machine": machine,
        "settings": {"k": study.prepared.k, "repeats": study.repeats, "operators": KINDS},
        "methods": {
            row.contender.name: {
                "solver": row.contender.solver,
                "stops_at": row.contender.method.stops,
                "peer": row.contender.method.peer,
            }
            for row in rows
        },
        "results": [_as_json(row) for row in rows],
        "exponents": [
            {"geometry": kind, "device": who.device, "method": who.name, **fit._asdict()}
            for (kind, who), fit in fitted.items()
        ],
    }
    paths = [tables.write_json(folder / "benchmark.json", record), folder / "benchmark.md"]
    tables.write_markdown(paths[1], _markdown(study, rows, machine))
    for kind, these in _grouped(rows, lambda row: row.problem.kind):
        if any(row.ok for row in these):
            paths.append(_draw_times(kind, these, fitted, folder / f"time-{kind}.png"))
        for problem, here in _grouped(these, lambda row: row.problem):
            if len(points := _pareto_points(here)) > 1:
                n = here[0].first("n")
                paths.append(
                    draw_pareto(
                        folder / f"accuracy-{kind}-{problem.points or n}.png",
                        points,
                        ylabel="mean relative eigenvalue error",
                        title=f"{kind}, {n or problem.points:,} points: accuracy against time",
                    )
                )
    return paths


def _as_json(row: Row) -> Record:
    seconds = {"seconds": row.values("seconds"), "median_seconds": row.median("seconds")}
    last = row.results[-1].record
    return {
        "geometry": row.problem.kind,
        "points": row.problem.points,
        "method": row.contender.name,
        "device": row.contender.device,
        **{name: value for name, value in last.items() if name not in ("key", "study", "time")},
        **seconds,
    }


def _markdown(study: Solves, rows: Sequence[Row], machine: Record) -> list[str]:
    waiting = max((value for row in rows for value in row.values("waiting")), default=0.0)
    return [
        f"k = {study.prepared.k} modes; median of {study.repeats} interleaved runs."
        f" {machine_line(machine)}",
        "Seconds leave out assembly and certificate; each solve has a process of its own, which"
        f" has solved something small before. Speed-up: over {BASELINE}. GB: peak above the"
        " operator. Residuals are relative; eigenvalue and span errors are means against ARPACK at"
        " machine precision; missed: exact modes with more than half of their energy outside the"
        " modes found. Bold: no other method on that device is both faster and more accurate.",
        "Stops at: the tolerance, each in the sense of its own stopping test (the residuals say"
        " what came of it); *rounding* is machine precision, *default* what the package has set;"
        " predictions have no tolerance. A speed-up compares like with like only where both stop"
        " at the same.",
        f"**Something else was running**: up to {waiting:.0%} of a solve's time was spent waiting"
        " for a core." * (waiting > _BUSY),
        *(_table(here) for _, here in _grouped(rows, lambda row: row.problem)),
        *_exponent_lines(rows),
        *_solver_lines(rows),
        *_missing(study, rows),
    ]


_COLUMNS = (
    *("method", "stops at", "seconds", "speed-up", "with assembly", "GB"),
    *("residual, max", "median", "eigenvalue error", "span error", "missed"),
)


def _table(here: Sequence[Row]) -> str:
    problem, good = here[0].problem, [row for row in here if row.ok]
    if not good:
        return f"### {problem}\n\nNothing was measured."
    n, assembly = good[0].first("n"), good[0].first("assembly_seconds")
    base = next((row.median("seconds") for row in good if row.contender.name == BASELINE), None)
    best = undominated(_pareto_points(good))
    lines = []
    for row in good:
        name, seconds = str(row.contender), row.median("seconds")
        assert seconds is not None
        memory = (row.largest("peak_bytes") or 0) + (row.largest("device_peak_bytes") or 0)
        errors = (row.largest(name) for name in ("residual_max", "residual_median"))
        lines.append(
            [
                f"**{name}**" if name in best else name,
                row.contender.method.stops,
                tables.seconds(seconds),
                tables.number(tables.ratio(base, seconds), ".2f"),
                tables.seconds(seconds + assembly),
                f"{memory / 1e9:.2f}",
                *map(tables.error, errors),
                tables.error(row.first("eigenvalue_error")),
                tables.error(row.first("span_error")),
                tables.count(row.first("missed")),
            ]
        )
    return (
        f"### {problem.kind}, {n:,} points\n\nOperator: {KINDS[problem.kind]}, assembled in"
        f" {tables.seconds(assembly)} s.\n\n{tables.table(_COLUMNS, lines)}"
    )


def _exponent_lines(rows: Sequence[Row]) -> list[str]:
    lines: dict[str, list[str]] = {}
    for (kind, who), fit in exponents(rows).items():
        told = f"{who.name} {fit.exponent:.2f} ({fit.sizes} sizes)"
        lines.setdefault(f"{kind}, {who.device}", []).append(told)
    told = tables.listed(f"{place}: {', '.join(values)}" for place, values in lines.items())
    return [f"Exponents of time against points, from {FIT_FROM:,} points on:", told] if told else []


def _solver_lines(rows: Sequence[Row]) -> list[str]:
    solvers = {row.contender.name: row.contender.solver for row in rows if row.contender.solver}
    return ["What the names stand for:", tables.listed(f"{n}: `{s}`" for n, s in solvers.items())]


def _missing(study: Solves, rows: Sequence[Row]) -> list[str]:
    reasons: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        why = study.unprepared.get((EXACT, str(row.problem)), "")
        reason = f"no errors: {why}" * bool(why) if row.ok else row.reason
        if reason:
            reasons.setdefault((str(row.contender), reason), []).append(str(row.problem))
    if not reasons:
        return []
    lines = (f"{who} ({'; '.join(at)}): {reason}" for (who, reason), at in reasons.items())
    return ["Not measured, or not to the end:", tables.listed(lines)]


def _pareto_points(rows: Iterable[Row]) -> list[ParetoPoint]:
    """Return what has an error as points of a Pareto plot, a league each device."""
    points = []
    for row in rows:
        seconds, error = row.median("seconds"), row.first("eigenvalue_error")
        if seconds is not None and error is not None:
            method = row.contender.method
            group = f"to {method.stops}" if method.stops else "predictions"
            points.append(
                ParetoPoint(
                    name=str(row.contender),
                    group="other packages" if method.peer else group,
                    seconds=seconds,
                    error=error,
                    league=row.contender.device,
                )
            )
    return points


def _draw_times(
    kind: str, rows: Sequence[Row], fitted: Mapping[tuple[str, Contender], Fit], path: Path
) -> Path:
    """Draw seconds against points, both logarithmic, a line for each method."""
    figure, (panel,) = panels(f"{kind}: time to solve", width=9)
    lines: dict[Contender, dict[int, float]] = {}
    for row in rows:
        seconds = row.median("seconds")
        if seconds is not None:
            lines.setdefault(row.contender, {})[row.first("n")] = seconds
    for who, line in lines.items():
        fit = fitted.get((kind, who))
        style = dots(list(METHODS).index(who.name))  # the same in every figure
        if who.method.peer:
            style |= {"ls": "--", "mfc": "white"}
        power = "" if fit is None else f"  $N^{{{fit.exponent:.2f}}}$"
        panel.plot(list(line), list(line.values()), label=f"{who}{power}", **style)
    panel.set(xlabel="points N", ylabel="seconds", yscale="log")
    ticks(panel, (n for line in lines.values() for n in line))
    legend(figure, panel, beside=True)
    return save(figure, path)


def _grouped(items: Iterable[Item], key: Callable[[Item], Name]) -> list[tuple[Name, list[Item]]]:
    """Group neighbours that share a key."""
    return [(name, list(group)) for name, group in itertools.groupby(items, key)]
