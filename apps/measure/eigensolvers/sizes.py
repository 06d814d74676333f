"""Clouds of many models at several sizes: who is quicker and nearer, and where the network pays."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from measure import tables
from measure.eigensolvers.methods import Contender
from measure.eigensolvers.report import head, missing, row_as_json, solver_lines, summary_as_json
from measure.eigensolvers.studies import Solves
from measure.eigensolvers.summary import Row, Summary, summaries
from measure.figures import ROUNDING, colour, dots, legend, panels, save, undominated
from measure.paper import SECONDS_NOTE, seconds_told
from measure.plots import ParetoPoint, pareto_front
from measure.recipes import Recipe
from measure.store import Record
from measure.study import Result, repeats_of
from spectra_kit.show.layout import log_ticks

_SAME = 1.05  # times closer than this are equal
_FIGURES = ("seconds", "typical_error")


class Lead(NamedTuple):
    """A method that begins with the network, and the best without it that takes no longer."""

    contender: Contender
    rival: Contender | None  #: By their means; none, where all take longer.
    ratio: float  #: The rival's typical error over its own.
    models: tuple[str, ...]  #: Where nothing without it is as quick and as near.
    measured: int  #: Models.


def leads(rows: Sequence[Row]) -> list[Lead]:
    """Compare at one size; rivals are on the same device or on the processor."""
    found = {str(one.contender): one for one in summaries(rows) if _compared(one)}
    answers = []
    for one in found.values():
        who = one.contender
        if not who.method.network:
            continue
        others = [
            row
            for row in rows
            if not row.contender.method.network and row.contender.device in ("cpu", who.device)
        ]
        names = dict.fromkeys(str(row.contender) for row in others)
        time, error = (one.over[figure].mean for figure in _FIGURES)
        rivals = [found[name] for name in names if name in found]
        in_time = [o for o in rivals if o.over["seconds"].mean <= _SAME * time]
        best = min(in_time, key=lambda o: o.over["typical_error"].mean, default=None)
        least = max(best.over["typical_error"].mean, ROUNDING) if best else np.inf
        mine = [row for row in rows if row.contender == who and row.values("eigenvalue_error")]
        wins = (row for row in mine if not any(_beats(other, row) for other in others))
        answers.append(
            Lead(
                contender=who,
                rival=best.contender if best else None,
                ratio=least / max(error, ROUNDING),
                models=tuple(str(row.problem) for row in wins),
                measured=len(mine),
            )
        )
    return answers


def _compared(one: Summary) -> bool:
    """Whether it solved every model, and its errors are known."""
    return not one.lost and {*_FIGURES} <= one.over.keys()


def write_sizes(
    study: Solves,
    results: Iterable[Result[Contender, Recipe]],
    prepared: Iterable[Result[str, Recipe]],
    machine: Record,
) -> list[Path]:
    """Write ``sizes.json``, ``sizes.md`` and ``sizes.png`` into the folder; return their paths."""
    rows, folder = repeats_of(results), study.folder
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(row.problem.traits[0], []).append(row)
    found = {size: summaries(these) for size, these in groups.items()}
    told = {size: leads(these) for size, these in groups.items()}
    record = {
        "machine": machine,
        "settings": {"k": study.prepared.k, "repeats": study.repeats},
        "summaries": {size: [*map(summary_as_json, some)] for size, some in found.items()},
        "leads": {size: [lead._asdict() for lead in some] for size, some in told.items()},
        "results": [row_as_json(row) for row in rows],
    }
    paths = [tables.write_json(folder / "sizes.json", record), folder / "sizes.md"]
    points = {size: _points(summed) for size, summed in found.items()}
    settings, _, stops, busy = head(study, rows, machine)
    parts = [
        *("# Time against error", settings),
        "Seconds leave out assembly and certificate; each solve has a process of its own, which has"
        " solved something small before. Errors are those of the eigenvalues, relative, in the mean"
        " over the modes, against ARPACK at machine precision. Both have geometric means over the"
        " models here; then the worst. Bold: no other method on that device is both faster and"
        " more accurate. Exponents are of time against points.",
        *(stops, busy),
        _table(found, points),
        SECONDS_NOTE,
        "## Where the network pays",
        "Beside each method that begins with it: the best without it in its time, whose error is"
        " so many times its own (less than 1: the network does not pay), and on how many models"
        " nothing without it was both as quick and as near.",
        _lead_table(told),
        *solver_lines(rows),
        *missing([*repeats_of(prepared), *rows]),
    ]
    tables.write_markdown(paths[1], parts)
    if any(points.values()):
        paths.append(_draw(points, folder / "sizes.png"))
    return paths


def _beats(other: Row, row: Row) -> bool:
    """Whether another is as quick on the same model, and as near."""
    times = other.median("seconds"), row.median("seconds")
    errors = other.largest("eigenvalue_error"), row.largest("eigenvalue_error")
    if other.problem != row.problem or None in (*times, *errors):
        return False
    own = max(errors[1], ROUNDING)
    return bool(times[0] <= _SAME * times[1] and errors[0] <= own)  # type: ignore[operator]


def _points(found: Iterable[Summary]) -> list[ParetoPoint]:
    """Return who solved every model: geometric means, with their worst."""
    points = []
    for one in found:
        if _compared(one):
            time, error = (one.over[figure] for figure in _FIGURES)
            point = ParetoPoint(
                name=str(one.contender),
                group=one.contender.name,
                seconds=time.mean,
                error=error.mean,
                league=one.contender.device,
                worst=(time.worst, error.worst),
            )
            points.append(point)
    return points


def _table(found: dict[str, list[Summary]], points: dict[str, list[ParetoPoint]]) -> str:
    """Return one row for each method; bold where nothing on its device is quicker and nearer."""
    best = {size: undominated(here) for size, here in points.items()}
    at = {size: {str(one.contender): one for one in some} for size, some in found.items()}
    header = ["method", "exponent"]
    for size in found:
        header += [f"{size}: s", "worst", "the paper's", "error", "worst", "on"]
    lines = []
    for who in dict.fromkeys(name for some in at.values() for name in some):
        cells = [who, tables.number(_exponent({n: at[n].get(who) for n in at}), ".2f")]
        for size in found:
            one = at[size].get(who)
            time, error = (one.over.get(f) if one else None for f in _FIGURES)
            cells += [tables.number(x) for x in time[:2]] if time else [tables.NONE] * 2
            name, points_there = who.partition(" ")[0], _points_of(size)
            cells.append(tables.number(seconds_told(name, points_there)))
            if error:
                cells += [tables.number(x, ".1e") for x in error[:2]]
                cells.append(error.where.rpartition(", ")[0])
            else:
                cells += [tables.NONE] * 3
            if who in best[size]:
                cells[-6] = f"**{cells[-6]}**"
        lines.append(cells)
    return tables.table(header, lines)


def _exponent(ones: Mapping[str, Summary | None]) -> float:
    """Fit time against points; NaN for fewer than three sizes, as a line fits two always."""
    seconds = {_points_of(n): one.over["seconds"].mean for n, one in ones.items() if one}
    known = [(n, s) for n, s in seconds.items() if np.isfinite(s)]
    if len(known) < 3:
        return float("nan")
    points, times = np.log(known).T
    return float(np.polyfit(points, times, 1)[0])


def _points_of(size: str) -> int:
    return int(size.split()[0].replace(",", ""))


def _lead_table(told: dict[str, list[Lead]]) -> str:
    header = ("size", "method", "the best in its time", "times its error", "pays on", "of")
    lines = [
        [
            *(size, str(lead.contender), str(lead.rival or "none")),
            *(tables.number(lead.ratio), str(len(lead.models)), str(lead.measured)),
        ]
        for size, some in told.items()
        for lead in some
    ]
    return tables.table(header, lines)


def _draw(points: dict[str, list[ParetoPoint]], path: Path) -> Path:
    """Draw a panel for each size: means as dots, thin lines to the worst, fronts in grey."""
    figure, axes = panels(
        "Error against time: geometric means over models, thin lines to the worst",
        len(points),
        width=4 + 4.2 * len(points),
    )
    styles = _styles(dict.fromkeys(point.group for here in points.values() for point in here))
    for panel, (size, here) in zip(axes, points.items(), strict=True):
        for league in dict.fromkeys(point.league for point in here):
            front = pareto_front([p for p in here if p.league == league], floor=ROUNDING)
            places = np.array([(p.seconds, max(p.error, ROUNDING)) for p in front])
            panel.plot(*places.T, color="0.8", lw=3, drawstyle="steps-post", zorder=0)
        for point in here:
            style = styles[point.group] | ({} if point.league == "cpu" else {"mfc": "white"})
            x, y = point.seconds, max(point.error, ROUNDING)
            assert point.worst is not None
            slow, far = point.worst[0], max(point.worst[1], y)
            panel.plot([x, slow], [y, y], color=style["color"], alpha=0.35, lw=1)
            panel.plot([x, x], [y, far], color=style["color"], alpha=0.35, lw=1)
            panel.plot([x], [y], ls="", label=point.name, **style)
        panel.set(title=size, xlabel="seconds", xscale="log", yscale="log")
        log_ticks(panel.xaxis, plain=True)
    axes[0].set(ylabel="relative eigenvalue error")
    legend(figure, max(axes, key=lambda panel: len(panel.lines)), beside=True)
    return save(figure, path)


def _styles(names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Give each kind of method, by the first word of its name, a colour; and each its marker."""
    kinds: dict[str, list[str]] = {}
    for name in names:
        kinds.setdefault(name.partition("-")[0], []).append(name)
    return {
        name: dots(j) | {"color": colour(i)}
        for i, members in enumerate(kinds.values())
        for j, name in enumerate(members)
    }
