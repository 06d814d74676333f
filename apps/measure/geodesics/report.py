"""Tables of what was measured, in Markdown."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from measure.geodesics.contenders import (
    AUTOMATIC,
    CONTENDERS,
    DIRECT,
    ICPCG,
    LIBIGL,
    MANY,
    MODES,
    PLAIN,
    RACE,
    ROBUST,
    UNAIDED,
)
from measure.geodesics.studies import Ball, mean_error
from measure.machine import machine_line
from measure.shapes import Shape
from measure.store import Record
from measure.study import Repeats, Result, repeats_of
from measure.tables import NONE, number, ratio, table, write_json, write_markdown

Row = Repeats[str, Shape]


@dataclass(frozen=True, eq=False)
class Mesh:
    """All that was measured on one mesh."""

    shape: Shape  #: The mesh.
    #: From the name of a study and a contender to what was measured.
    rows: Mapping[tuple[str, str], Row]

    @property
    def name(self) -> str:
        """Of the mesh."""
        return self.shape.name

    @property
    def n(self) -> int:
        """Vertices."""
        return self.shape.mesh.n

    @property
    def title(self) -> str:
        """Name and size."""
        return f"{self.name} ({self.n:,})"

    def iterations(self, name: str) -> float | None:
        """Return the median iterations; None where nothing is iterated."""
        counts = [c for c in self.rows["accuracy", name].first("iterations") or [] if c is not None]
        return statistics.median(counts) if counts else None

    def error(self, name: str, which: str = "mean") -> float | None:
        """Return an error, averaged over sources; None where it failed."""
        errors = self.rows["accuracy", name].first("errors")
        return mean_error(errors, which) if errors else None

    def seconds(self, name: str, *, many: bool = False) -> float | None:
        """Return the seconds, modes at hand; None where it failed."""
        return self.rows["many" if many else "first", name].median("seconds")

    def least(self, study: str, name: str, unit: str) -> float | None:
        """Return the seconds of the fastest run; None where there is none."""
        return min(self.rows[study, name].values(unit), default=None)

    def modes_seconds(self, name: str) -> float:
        """Return what the modes took that a contender used for its first field."""
        # A solver that has chosen to do without them has not used their time.
        given = self.rows.get(("modes", CONTENDERS[name].modes))
        if given is None or self.rows["first", name].first("solver") == "direct":
            return 0.0
        return given.median("seconds") or 0.0

    def seconds_in_all(self, name: str) -> float | None:
        """Return the seconds to the first field, those of the modes with them."""
        own = self.seconds(name)
        return None if own is None else own + self.modes_seconds(name)


def meshes(results: Mapping[str, Iterable[Result[str, Shape]]]) -> list[Mesh]:
    """Gather what was measured, mesh by mesh, from the results of each study."""
    rows = [(study, row) for study, some in results.items() for row in repeats_of(some)]
    shapes = {row.problem.name: row.problem for _, row in rows}
    return [
        Mesh(shape, {(s, r.contender): r for s, r in rows if r.problem.name == name})
        for name, shape in shapes.items()
    ]


def write_report(
    folder: Path,
    results: Mapping[str, Sequence[Result[str, Shape]]],
    balls: Sequence[Result[str, Ball]],
    machine: Record,
    *,
    repeats: int,
    sources: int,
    quick: bool = False,
) -> str:
    """Write ``report.json`` and ``report.md``, and return the latter.

    From results of the studies "modes", "accuracy", "first" and "many", and of `Balls`; `quick` is
    whether everything ran in one process.
    """
    told = {name: [result.record for result in some] for name, some in results.items()}
    told["balls"] = [result.record for result in balls]
    write_json(folder / "report.json", {"machine": machine, **told})
    found = meshes(results)
    parts = [
        "# Geodesic distances",
        machine_line(machine) + " All in one process: the seconds are not comparable." * quick,
        "## In short",
        _summary(found),
        "## Iterations of the Poisson step",
        "To a relative residual of 1e-8; the median of the sources, and how many times fewer"
        f" than {ICPCG}. What the modes took is not in these counts.",
        _by_mesh(CONTENDERS, found, _iterations),
        "## Seconds to the first field",
        "From the arrays of vertices and faces to the distances from one source: checks,"
        " triangulation, factors or preconditioner, heat and Poisson step; of other packages,"
        f" building the solver and its first solve. Medians of {repeats} runs, each in"
        " a process of its own, all contenders by turns. Importing and compiling are not counted:"
        " compiled code is kept on disk, and each process solves on a small sphere first."
        " A solver with modes is handed them: *seconds* does not hold what they took. That is"
        f" in *spectrum*, for all {MODES} of them, though automatic takes fewer; the operator is"
        " not counted twice. *In all* is the sum, what someone pays who wants the distance and"
        " nothing else of the spectrum. *Faster* is the time of potpourri3d, robust (its default),"
        " over either.",
        *map(_first, found),
        "## Seconds for many sources",
        f"{sources} single sources, asked for at once; the same clock. No solver here is handed"
        f" modes. In brackets: over *{DIRECT}*.",
        _by_mesh(MANY, found, partial(_many, sources=sources)),
        "## Errors against exact distances",
        "Relative errors |d - d*| / d* in per cent, the sources aside: mean over vertices / mean"
        " over the surface / largest; averaged over sources, half of them drawn at random, half"
        " far from those before. *Ratio* is the mean over vertices of the direct solver over that"
        " of potpourri3d, robust.",
        _errors(found),
        "## Agreement of the solvers",
        "Largest difference from the fields of the direct solver, over the largest distance.",
        _by_mesh(CONTENDERS, found, _agreement),
        "## The unit sphere",
        "Mean (largest) relative errors against arcs in per cent, and the rate: the power of"
        " 1/sqrt(n) with which the mean error falls from the first to the last.",
        _balls(balls),
    ]
    return write_markdown(folder / "report.md", parts)


def write_race(
    folder: Path,
    results: Mapping[str, Sequence[Result[str, Shape]]],
    machine: Record,
    *,
    repeats: int,
    sources: int,
) -> str:
    """Write ``race.json`` and ``race.md``, and return the latter.

    From results of the studies "accuracy", "first" and "many" for the contenders of `RACE`.
    """
    told = {name: [result.record for result in some] for name, some in results.items()}
    write_json(folder / "race.json", {"machine": machine, **told})
    found, studies = meshes(results), ("first", "many")
    tables = []
    for unit, title in (("seconds", "wall"), ("processor_seconds", "processor")):
        header = ["mesh", *(f"{study}: {name}" for study in studies for name in RACE)]
        header += [
            f"{study}: {name}" for study in studies for name in ("over plain", "over robust")
        ]
        rows, ratios = [], []
        for mesh in found:
            best = [mesh.least(study, name, unit) for study in studies for name in RACE]
            faster = [ratio(best[i + k], best[i]) for i in (0, 3) for k in (1, 2)]
            ratios.append(faster)
            cells = [*(number(b, ".2f") for b in best), *(number(r, ".2f") for r in faster)]
            rows.append([mesh.title, *cells])
        columns = list(zip(*ratios, strict=True))
        rows += [
            [name, *[""] * 6, *(number(_over(column, pick), ".2f") for column in columns)]
            for name, pick in (("geometric mean", statistics.geometric_mean), ("worst", min))
        ]
        tables += [f"## Seconds ({title})", table(header, rows)]
    errors = [
        [mesh.title, *(_per_cent(mesh.error(name)) for name in (DIRECT, PLAIN, ROBUST))]
        for mesh in found
    ]
    parts = [
        "# Distances against potpourri3d",
        machine_line(machine),
        f"From the arrays of a mesh to the field of one source, and to {sources} fields, one call"
        f" each; the least of {repeats} runs, all contenders by turns, each in a warm process of"
        " its own. Then how many times as long potpourri3d takes, of which"
        " there is neither mean nor worst where a mesh was not solved.",
        *tables,
        "## Mean relative errors against exact distances, per cent",
        table(["mesh", "ours", "plain", "robust"], errors),
    ]
    return write_markdown(folder / "race.md", parts)


def _over(ratios: Sequence[float | None], pick: Callable[[list[float]], float]) -> float | None:
    """Return one number for all meshes; None where one is missing, as those left may be easier."""
    known = [ratio for ratio in ratios if ratio is not None]
    return pick(known) if len(known) == len(ratios) else None


def _per_cent(error: float | None) -> str:
    return number(None if error is None else 100 * error, ".3g")


def _summary(found: Sequence[Mesh]) -> str:
    """What matters, as the worst over the meshes."""
    rows = [
        _worst(
            f"{ICPCG} iterations over those of *{name}*",
            [(ratio(m.iterations(ICPCG), m.iterations(name)), m.name) for m in found],
        )
        for name in CONTENDERS
        if name.startswith(("additive", "projected"))
    ]
    clocks: dict[str, Callable[[Mesh], float | None]] = {
        f"*{UNAIDED}*": lambda m: m.seconds(UNAIDED),
        f"*{AUTOMATIC}*, spectrum at hand": lambda m: m.seconds(AUTOMATIC),
        f"*{AUTOMATIC}*, its spectrum counted": lambda m: m.seconds_in_all(AUTOMATIC),
    }
    for note, least in (("", 0), (f", {_HUGE:,} vertices or more", _HUGE)):
        for words, clock in clocks.items():
            faster = [(ratio(m.seconds(ROBUST), clock(m)), m.name) for m in found if m.n >= least]
            rows.append(_worst(f"seconds of potpourri3d over {words}: first field{note}", faster))
    slower = [
        (ratio(m.seconds(UNAIDED, many=True), m.seconds(DIRECT, many=True)), m.name) for m in found
    ]
    rows.append(_worst(f"seconds of *{UNAIDED}* over *{DIRECT}*: many sources", slower, max))
    errors = [(ratio(m.error(DIRECT), m.error(ROBUST)), m.name) for m in found]
    rows.append(_worst("mean error over that of potpourri3d", errors, max, ".3f"))
    apart = [(row.first("difference"), mesh.name) for mesh in found for row in mesh.rows.values()]
    rows.append(_worst("difference between solvers", apart, max, ".1e"))
    return table(["measured", "worst", "on"], rows)


_HUGE = 100_000  # vertices
Worst = Callable[[list[tuple[float, str]]], tuple[float, str]]


def _worst(
    label: str, values: Iterable[tuple[float | None, str]], pick: Worst = min, form: str = ".2f"
) -> list[str]:
    """Return a row: what was measured, the worst, and on which mesh."""
    there = [(value, name) for value, name in values if value is not None]
    if not there:
        return [label, NONE, NONE]
    value, name = pick(there)
    return [label, format(value, form), name]


def _by_mesh(names: Iterable[str], found: Sequence[Mesh], cell: Callable[[Mesh, str], str]) -> str:
    """Return a table with a row for each solver that has something, and a column for each mesh."""
    rows = [[name, *(cell(mesh, name) for mesh in found)] for name in names]
    told = [row for row in rows if set(row[1:]) != {NONE}]
    return table(["solver", *(mesh.title for mesh in found)], told)


def _iterations(mesh: Mesh, name: str) -> str:
    count = mesh.iterations(name)
    fewer = number(ratio(mesh.iterations(ICPCG), count), ".2f")
    return NONE if count is None else f"{count:.0f} ({fewer})"


_STAGES = ("triangulation", "setup", "heat", "poisson")


def _first(mesh: Mesh) -> str:
    rows = []
    robust = mesh.seconds(ROBUST)
    for name in CONTENDERS:
        row = mesh.rows["first", name]
        own, whole, middle = mesh.seconds(name), mesh.seconds_in_all(name), _middle(row)
        stages = middle.get("stages", {})
        rows.append(
            [
                name,
                number(own, ".2f"),
                number(ratio(robust, own), ".2f"),
                number(mesh.modes_seconds(name) or None, ".2f"),
                number(whole, ".2f"),
                number(ratio(robust, whole), ".2f"),
                number((middle.get("iterations") or [None])[0], "d"),
                *(number(stages.get(stage), ".2f") for stage in _STAGES),
                middle.get("solver", "") if row.ok else "failed",
            ]
        )
    header = ["solver", "seconds", "faster", "spectrum", "in all", "faster", "iterations"]
    header += ["triangulation", "setup", "heat", "Poisson", "chosen"]
    return f"### {mesh.title}\n\n{table(header, rows)}"


def _middle(row: Row) -> Record:
    """Return the record of the median run, the faster one of two."""
    good = sorted(
        (result.record for result in row.results if result.ok), key=lambda record: record["seconds"]
    )
    return good[(len(good) - 1) // 2] if good else {}


def _many(mesh: Mesh, name: str, *, sources: int) -> str:
    own, count = mesh.seconds(name, many=True), min(sources, mesh.n)
    if own is None:
        return "failed"
    against = number(ratio(own, mesh.seconds(DIRECT, many=True)), ".2f")
    return f"{own:.2f}, {1e3 * own / count:.0f} ms each ({against})"


def _errors(found: Sequence[Mesh]) -> str:
    names = [DIRECT, AUTOMATIC, ROBUST, PLAIN, LIBIGL]
    rows = []
    for mesh in found:
        cells = []
        for name in names:
            errors = (mesh.error(name, which) for which in ("mean", "weighted", "largest"))
            cells.append(" / ".join(NONE if e is None else f"{100 * e:.3g}" for e in errors))
        against = ratio(mesh.error(DIRECT), mesh.error(ROBUST))
        rows.append([mesh.title, *cells, number(against, ".3f")])
    return table(["mesh", *names, "ratio"], rows)


def _agreement(mesh: Mesh, name: str) -> str:
    return number(mesh.rows["accuracy", name].first("difference"), ".1e")


def _balls(results: Sequence[Result[str, Ball]]) -> str:
    lines: dict[tuple[str, str], list[Record]] = {}
    for result in results:
        lines.setdefault((result.problem.kind, result.contender), []).append(result.record)
    rows = []
    for (kind, name), records in lines.items():
        cells = [f"{100 * r['mean']:.3g} ({100 * r['largest']:.3g})" for r in records]
        ends = np.log([(r["mean"], r["points"] ** 0.5) for r in (records[0], records[-1])])
        fall = ends[0] - ends[1]
        rows.append([f"{kind}: {name}", *cells, number(ratio(-fall[0], fall[1]), ".2f")])
    sizes = dict.fromkeys(result.record["points"] for result in results)
    return table(["geometry: solver", *(f"{n:,}" for n in sizes), "rate"], rows)
