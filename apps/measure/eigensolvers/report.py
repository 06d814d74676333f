"""What follows from the measurements, as JSON, tables and plots."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from measure import tables
from measure.eigensolvers.methods import BASELINE, METHODS, Contender
from measure.eigensolvers.studies import KINDS, Problem, Solves
from measure.figures import dots, draw_pareto, legend, panels, save, ticks, undominated
from measure.machine import machine_line
from measure.store import Record
from measure.study import Repeats, Result, repeats_of
from spectra_kit.viz import ParetoPoint

Item = TypeVar("Item")
Name = TypeVar("Name")

#: Below this many points a solve is mostly overhead: such sizes take no part in exponents.
FIT_FROM = 7500
#: A line through two sizes fits always, and says nothing about a third.
FIT_SIZES = 3

_BUSY = 0.05  # of a solve's time without a core; times are longer than they should be

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
    study: Solves,
    results: Iterable[Result[Contender, Problem]],
    prepared: Iterable[Result[str, Problem]],
    machine: Record,
) -> list[Path]:
    """Write ``benchmark.json``, ``benchmark.md`` and the plots into the folder of the study.

    Return their paths: JSON, Markdown, then ``time-KIND.png`` and ``accuracy-KIND-POINTS.png``.
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
    missing = _missing([*repeats_of(prepared), *rows])
    tables.write_markdown(paths[1], [*_markdown(study, rows, machine), *missing])
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
        errors = [row.largest(name) for name in ("residual_max", "residual_median")]
        errors += [row.first(name) for name in ("eigenvalue_error", "span_error")]
        lines.append(
            [
                f"**{name}**" if name in best else name,
                row.contender.method.stops,
                tables.number(seconds),
                tables.number(tables.ratio(base, seconds), ".2f"),
                tables.number(seconds + assembly),
                f"{memory / 1e9:.2f}",
                *(tables.number(error, ".1e") for error in errors),
                tables.number(row.first("missed"), ",.0f"),
            ]
        )
    return (
        f"### {problem.kind}, {n:,} points\n\nOperator: {KINDS[problem.kind]}, assembled in"
        f" {tables.number(assembly)} s.\n\n{tables.table(_COLUMNS, lines)}"
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


def _missing(rows: Iterable[Row | Repeats[str, Problem]]) -> list[str]:
    reasons: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        if not row.ok:
            reasons.setdefault((str(row.contender), row.reason), []).append(str(row.problem))
    told = tables.listed(f"{who} ({'; '.join(at)}): {why}" for (who, why), at in reasons.items())
    title = "Not measured, or not to the end; without exact modes there are no errors:"
    return [title, told] if told else []


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
