"""What follows from the measurements, as JSON, tables and plots."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TypeVar

from measure import tables
from measure.eigensolvers.methods import BASELINE, Contender
from measure.eigensolvers.studies import FACTOR, KINDS, OPERATOR, SEEN, Solves
from measure.eigensolvers.summary import LIMITS, Row, Summary, memory, summaries
from measure.figures import draw_pareto, undominated
from measure.machine import machine_line
from measure.plots import ParetoPoint
from measure.recipes import Recipe
from measure.store import Record
from measure.study import Repeats, Result, repeats_of

Item = TypeVar("Item")
Name = TypeVar("Name")

_BUSY = 0.05  # of a solve's time without a core; times are longer than they should be


def write_report(
    study: Solves,
    results: Iterable[Result[Contender, Recipe]],
    prepared: Iterable[Result[str, Recipe]],
    machine: Record,
) -> list[Path]:
    """Write ``benchmark.json``, ``benchmark.md`` and the plots into the folder of the study.

    Return their paths: JSON, Markdown, then ``accuracy.png`` over the members of the set.
    """
    rows, ready, folder = repeats_of(results), repeats_of(prepared), study.folder
    groups = {name: summaries(some) for name, some in _groups(rows).items()}
    record = {
        "schema": 5,
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
        "summaries": {
            name: [summary_as_json(one) for one in found] for name, found in groups.items()
        },
        "results": [row_as_json(row) for row in rows],
    }
    paths = [tables.write_json(folder / "benchmark.json", record), folder / "benchmark.md"]
    parts = [
        *head(study, rows, machine),
        *(part for name, found in groups.items() for part in _summary(name, found)),
        *_promises(groups.get(ALL, ())),
        *_members(ready),
        *(_table(here) for _, here in _grouped(rows, lambda row: row.problem)),
        *solver_lines(rows),
        *missing([*ready, *rows]),
    ]
    tables.write_markdown(paths[1], parts)
    if len(points := _pareto_points(groups.get(ALL, ()))) > 1:
        labels = {
            "xlabel": f"time, {BASELINE} = 1: geometric mean; bars lead to the worst",
            "ylabel": "mean relative eigenvalue error",
        }
        title = f"{len({row.problem for row in rows})} real meshes and clouds"
        paths.append(draw_pareto(folder / "accuracy.png", points, title=title, **labels))
    return paths


#: The group of all members.
ALL = "all"


def _groups(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Gather what was measured on the set: all, one side of it, one kind, one trait."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        member = row.problem
        if member.traits:
            side = "held back" if member.held_back else "for tuning"
            for name in (ALL, side, member.kind, *member.traits):
                groups.setdefault(name, []).append(row)
    first = (ALL, "held back", "for tuning", *KINDS)
    return {
        name: groups[name] for name in (*first, *sorted({*groups} - {*first})) if name in groups
    }


def summary_as_json(one: Summary) -> Record:
    """Return a summary as JSON."""
    return {
        **{"method": one.contender.name, "device": one.contender.device},
        **{"members": one.members, "lost": one.lost, "above": one.above},
        **{figure: over._asdict() for figure, over in one.over.items()},
    }


def row_as_json(row: Row) -> Record:
    """Return all that was measured of one method on one problem."""
    seconds = {"seconds": row.values("seconds"), "median_seconds": row.median("seconds")}
    last = row.results[-1].record
    return {
        "geometry": row.problem.kind,
        "recipe": row.problem.told,
        "traits": row.problem.traits,
        "held_back": row.problem.held_back,
        "method": row.contender.name,
        "device": row.contender.device,
        **{name: value for name, value in last.items() if name not in ("key", "study", "time")},
        **seconds,
    }


def head(study: Solves, rows: Sequence[Row], machine: Record) -> list[str]:
    """Return settings, what the columns are, where solvers stop, and whether it was quiet."""
    waiting = max((value for row in rows for value in row.values("waiting")), default=0.0)
    return [
        f"k = {study.prepared.k} modes; median of {study.repeats} interleaved runs."
        f" {machine_line(machine)}",
        "Seconds leave out assembly and certificate; each solve has a process of its own, which"
        f" has solved something small before. Speed-up: over {BASELINE}. GB: peak above the"
        " operator. Residuals are relative, the largest of all modes; eigenvalue errors are"
        " relative, by place, against ARPACK at machine precision: the mean over the modes, and"
        " the worst. Over a set, speed-ups have a geometric mean, all else an arithmetic one; who"
        f" did not solve every member has no mean. What {BASELINE} did not solve has no speed-up,"
        " and what has no exact eigenvalues no error, for all alike. Bold: no other method on that"
        " device is both faster and more accurate.",
        "Stops at: the tolerance, each in the sense of its own stopping test (the residuals say"
        " what came of it); *rounding* is machine precision, *default* what the package has set;"
        " predictions have no tolerance. A speed-up compares like with like only where both stop"
        " at the same.",
        f"**Something else was running**: up to {waiting:.0%} of a solve's time was spent waiting"
        " for a core." * (waiting > _BUSY),
    ]


_OVER = (
    *("method", "stops at", "solved", "speed-up", "worst", "eigenvalue error", "worst"),
    *("residual", "worst", "GB", "worst"),
)


def _summary(name: str, found: Sequence[Summary]) -> list[str]:
    """Tell of a group: means and worst, the worst with its member."""
    best = undominated(_pareto_points(found))
    lines = []
    for one in found:
        who = str(one.contender)
        cells = [f"**{who}**" if who in best else who, one.contender.method.stops]
        cells.append(f"{one.members - len(one.lost)}/{one.members}")
        for figure, form in (("slowdown", ".2f"), ("eigenvalue_error", ".1e")):
            over = one.over.get(figure)
            if over is None:
                cells += [tables.NONE] * 2
            elif figure == "slowdown":
                at = f"none ({one.lost[0]})" if one.lost else f"{1 / over.worst:.2f} ({over.where})"
                cells += [tables.number(1 / over.mean, form), at]
            else:
                cells += [tables.number(over.mean, form), f"{over.worst:{form}} ({over.where})"]
        for figure, form, unit in (("residual_max", ".1e", 1.0), ("bytes", ".2f", 1e9)):
            over = one.over.get(figure)
            both = (over.mean / unit, over.worst / unit) if over else (None, None)
            cells += [tables.number(value, form) for value in both]
        lines.append(cells)
    return [f"## {name}: {found[0].members} members" if found else "", tables.table(_OVER, lines)]


_PROMISES = (
    *("method", f"within {FACTOR:g}", "worst", "too low", "worst"),
    *("asked", "error", "met", "time", "worst", f"above {LIMITS['behind']:g}"),
)


def _promises(found: Iterable[Summary]) -> list[str]:
    """Tell of estimates, and of what was asked for: how many members, and what became of them."""
    lines = []
    for one in found:
        asked, over = one.contender.method.accuracy, one.over
        cells = [str(one.contender)]
        for figure, good in (("apart", True), ("low", False)):
            if figure in over:
                shares = over[figure].mean, over[figure].worst
                mean, worst = (1 - share if good else share for share in shares)
                cells += [tables.number(mean, ".1%"), f"{worst:.0%} ({over[figure].where})"]
            else:
                cells += [tables.NONE] * 2
        cells += [f"{asked:g}"] if asked else [tables.NONE]
        if "over_asked" in over:
            error, solved = over["over_asked"], one.members - len(one.lost)
            cells.append(f"{asked * error.worst:.1e} ({error.where})")
            cells.append(f"{solved - len(one.above['over_asked'])}/{one.members}")
        else:
            cells += [tables.NONE] * 2
        if "behind" in over:
            cells += [tables.number(over["behind"].mean, ".2f")]
            cells += [f"{over['behind'].worst:.2f} ({over['behind'].where})"]
            cells += [", ".join(one.above["behind"]) or "none"]
        else:
            cells += [tables.NONE] * 3
        # Of other packages, which estimate nothing, residuals and gaps alone have told.
        if {"apart", "over_asked"} & over.keys() and not one.contender.method.peer:
            lines.append(cells)
    told = (
        f"Estimates of errors: the share within a factor {FACTOR:g} of the true error, and of those"
        " that are too low by more, in the mean over members and on the worst. Modes whose error is"
        f" below {SEEN:g} are left out, as the exact eigenvalues are not exact enough to tell."
        " Where an accuracy was asked for: the largest error of a member, on how many it was met,"
        " and the time over that of the quickest method that met it without being asked."
    )
    return ["## What is promised", told, tables.table(_PROMISES, lines)] if lines else []


def _members(prepared: Iterable[Repeats[str, Recipe]]) -> list[str]:
    """List the set: what each member is made of, and the hash of what came of it."""
    header = ("member", "kind", "traits", "made of", "points", "for", "hash")
    lines = [
        [
            *(str(row.problem), row.problem.kind, ", ".join(row.problem.traits), row.problem.told),
            f"{row.first('n'):,}",
            "checking" if row.problem.held_back else "tuning",
            row.first("digest"),
        ]
        for row in prepared
        if row.contender == OPERATOR and row.ok and row.problem.traits
    ]
    return ["## The set", tables.table(header, lines)] if lines else []


_COLUMNS = (
    *("method", "stops at", "seconds", "speed-up", "with assembly", "GB"),
    *("residual, max", "median", "eigenvalue error", "worst mode"),
)


def _table(here: Sequence[Row]) -> str:
    problem, good = here[0].problem, [row for row in here if row.ok]
    if not good:
        return f"### {problem}\n\nNothing was measured."
    n, assembly = good[0].first("n"), good[0].first("assembly_seconds")
    base = next((row.median("seconds") for row in good if str(row.contender) == BASELINE), None)
    best = undominated(
        _point(row.contender, row.median("seconds"), row.first("eigenvalue_error"))
        for row in good
        if row.first("eigenvalue_error") is not None
    )
    lines = []
    for row in good:
        name, seconds = str(row.contender), row.median("seconds")
        assert seconds is not None
        errors = [row.largest(name) for name in ("residual_max", "residual_median")]
        errors += [row.first(name) for name in ("eigenvalue_error", "eigenvalue_error_max")]
        lines.append(
            [
                f"**{name}**" if name in best else name,
                row.contender.method.stops,
                tables.number(seconds),
                tables.number(tables.ratio(base, seconds), ".2f"),
                tables.number(seconds + assembly),
                f"{memory(row) / 1e9:.2f}",
                *(tables.number(error, ".1e") for error in errors),
            ]
        )
    return (
        f"### {problem}\n\n{n:,} points; operator: {KINDS[problem.kind]}, assembled in"
        f" {tables.number(assembly)} s.\n\n{tables.table(_COLUMNS, lines)}"
    )


def solver_lines(rows: Sequence[Row]) -> list[str]:
    """Return what the names of methods stand for."""
    solvers = {row.contender.name: row.contender.solver for row in rows if row.contender.solver}
    return ["What the names stand for:", tables.listed(f"{n}: `{s}`" for n, s in solvers.items())]


def missing(rows: Iterable[Row | Repeats[str, Recipe]]) -> list[str]:
    """Return what was not measured, and why."""
    reasons: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        if not row.ok:
            reasons.setdefault((str(row.contender), row.reason), []).append(str(row.problem))
    told = tables.listed(f"{who} ({'; '.join(at)}): {why}" for (who, why), at in reasons.items())
    title = "Not measured, or not to the end; without exact modes there are no errors:"
    return [title, told] if told else []


def _pareto_points(found: Iterable[Summary]) -> list[ParetoPoint]:
    """Return who solved every member as points of a Pareto plot, with their worst."""
    points = []
    for one in found:
        time, error = one.over.get("slowdown"), one.over.get("eigenvalue_error")
        if time and error and not one.lost:
            worst = time.worst, error.worst
            points.append(_point(one.contender, time.mean, error.mean, worst))
    return points


def _point(
    who: Contender, seconds: float | None, error: float, worst: tuple[float, float] | None = None
) -> ParetoPoint:
    """Return a point of a Pareto plot, in a league for each device."""
    assert seconds is not None
    group = f"to {who.method.stops}" if who.method.stops else "approximate"
    return ParetoPoint(
        name=str(who),
        group="other packages" if who.method.peer else group,
        seconds=seconds,
        error=error,
        league=who.device,
        worst=worst,
    )


def _grouped(items: Iterable[Item], key: Callable[[Item], Name]) -> list[tuple[Name, list[Item]]]:
    """Group neighbours that share a key."""
    return [(name, list(group)) for name, group in itertools.groupby(items, key)]
