"""Matching as Markdown for readers, JSON and CSV for programs, curves and pictures."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.spatial import cKDTree

from measure import figures, tables
from measure.matching.measures import THRESHOLDS
from measure.matching.methods import METHODS
from measure.matching.pairs import Pair, Pairs, Way
from measure.matching.protocols import PROTOCOLS, Protocol
from measure.matching.pyfm_peer import PARAMETERS
from measure.matching.subjects import truth_between
from measure.store import Record
from measure.study import Result
from spectra_kit._version import VERSION
from spectra_kit.correspondence import FLIP_MARGIN, MapErrors, geodesic_errors
from spectra_kit.viz import MatchedPair, Page, View, plot_correspondences

Results = Sequence[Result[Way, Pair]]

#: A pair with a mean error above this has failed.
BAD = 8.0
_DISTANCES = {
    "edges": "geodesic distances along the edges of",
    "exact": "exact geodesic distances on",
}
_TICKS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50)  # less is drawn as the first
_ARRAYS = ("accuracy", "accuracy_either")


def by_way(results: Results) -> dict[Way, list[Result[Way, Pair]]]:
    """Sort what was measured, in the order in which the ways first appear."""
    groups: dict[Way, list[Result[Way, Pair]]] = {}
    for result in results:
        if result.ok:
            groups.setdefault(result.contender, []).append(result)
    return groups


def counted(record: Record, protocol: Protocol) -> float:
    """Return the error that the protocol counts."""
    return float(record["either" if protocol.symmetric else "direct"])


def summarize(records: Sequence[Record], protocol: Protocol) -> Record:
    """Summarise the pairs that were matched in one way.

    ``bad`` is the share above `BAD`; ``flipped`` are pairs with left for right, ``partly`` others
    where the smaller error at each correspondence is on average smaller than the direct one by more
    than the margin: an arm or a leg went to the other side; both None if a pair has no symmetric
    truth. ``warned`` and ``false_alarms`` are pairs above `BAD` that the method called ambiguous,
    and others.
    """
    errors = [counted(record, protocol) for record in records]
    wrong = [error > BAD for error in errors]
    warned = [record["ambiguous"] for record in records]
    partly = [r["direct"] - r["either"] > FLIP_MARGIN and not r["flipped"] for r in records]
    sided = not any(math.isnan(record["symmetric"]) for record in records)

    def over(what: Any, name: str) -> float:
        return float(what(record[name] for record in records))

    means = ("direct", "symmetric", "either", "coverage", "energy", "bijectivity", "oracle")
    return {
        "pairs": len(records),
        "mean": statistics.fmean(errors),
        "median": statistics.median(errors),
        "bad": statistics.fmean(wrong),
        "auc": over(statistics.fmean, "auc_either" if protocol.symmetric else "auc"),
        **{name: over(statistics.fmean, name) for name in means},
        "flipped": sum(record["flipped"] for record in records) if sided else None,
        "partly": sum(partly) if sided else None,
        "warned": sum(w and b for w, b in zip(warned, wrong, strict=True)),
        "false_alarms": sum(w and not b for w, b in zip(warned, wrong, strict=True)),
        "seconds": over(statistics.median, "seconds"),
        "cpu_seconds": over(statistics.median, "cpu_seconds"),
    }


def write_report(results: Results, pairs: Pairs, protocol: Protocol) -> Path:
    """Write ``matching.md``, its JSON, ``pairs.csv`` and accuracy curves; return the first."""
    folder, groups = pairs.folder, by_way(results)
    rows = {way: summarize([r.record for r in these], protocol) for way, these in groups.items()}
    tables.write_json(
        folder / "matching.json",
        {
            "version": VERSION,
            "protocol": {"name": protocol.name, "pairs": len(protocol.pairs)},
            "k": pairs.spectra.k,
            "geodesics": pairs.geodesics,
            "summaries": [{**_names(way), **row} for way, row in rows.items()],
            "failures": [
                {**_names(r.contender, r.problem), "reason": r.reason} for r in results if not r.ok
            ],
        },
    )
    tables.write_csv(folder / "pairs.csv", [_line(result) for result in results if result.ok])
    if rows:
        _draw_accuracy(groups, protocol, folder / "accuracy.png")
    tables.write_markdown(folder / "matching.md", _paragraphs(results, rows, pairs, protocol))
    return folder / "matching.md"


def _names(way: Way, pair: Pair | None = None) -> dict[str, str]:
    names = {**way.basis._asdict(), "method": way.method}
    return names if pair is None else {**pair._asdict(), **names}


def _line(result: Result[Way, Pair]) -> dict[str, Any]:
    """One pair for the CSV; a list of numbers is one cell."""
    hidden = ("study", "contender", "problem", "repeat", "status", "files", "time")
    cells = {name: value for name, value in result.record.items() if name not in hidden}
    cells |= {name: " ".join(f"{x:.5g}" for x in cells[name]) for name in _ARRAYS}
    return {**_names(result.contender, result.problem), "digest": cells.pop("key"), **cells}


def _paragraphs(
    results: Results, rows: Mapping[Way, Record], pairs: Pairs, protocol: Protocol
) -> list[str]:
    what = "the smaller of direct and symmetric" if protocol.symmetric else "direct"
    peer = f"pyfm: {PARAMETERS}. `-k` does not change that, only how many modes it solves for."
    reasons: dict[str, list[str]] = {}
    for result in (result for result in results if not result.ok):
        way, pair = result.contender, result.problem
        who = f"{pair.source} to {pair.target} ({', '.join(_names(way).values())})"
        reasons.setdefault(result.reason, []).append(who)
    failures = [
        f"{who}{f' and {len(others)} more' if others else ''}: {why}"
        for why, (who, *others) in reasons.items()
    ]
    return [
        "# Matching",
        f"{len(protocol.pairs)} pairs ({protocol.name}: {PROTOCOLS[protocol.name]});"
        f" {pairs.spectra.k} modes; spectra_kit {VERSION}.",
        f"Errors are {_DISTANCES[pairs.geodesics]} the source, in hundredths of the root of"
        f" its area; *mean*, *median*, *over 8* (share of pairs) and *AUC* (up to 10): {what}"
        " errors. *Flipped*: pairs with left for right, whose mean symmetric error is lower than"
        f" the direct one by more than {FLIP_MARGIN:g}; *partly*: others where the smaller error at"
        " each correspondence is lower by as much. Both are blank without a symmetric truth, and"
        " front for back is in neither. *Best finalist*: direct error if, of the map and of the"
        " other candidates that were refined last, finished by plain ZoomOut, the truth chose; no"
        " bound, as the whole method might finish those better."
        " *Warned*: pairs called ambiguous, of those over 8 and of the others. *Coverage*: share of"
        " the source's area hit. *Energy*: Dirichlet, 1 for an isometry."
        " *Back*: mean distance along edges to where the transposed functional map leads back.",
        "Seconds are medians of one pair, spectra given and nothing else. A pair has one thread,"
        " also with `--jobs 1`; with more, as many pairs run side by side and share the machine,"
        " which lengthens *s*.",
        peer if any(METHODS[way.method].own for way in rows) else "",
        _table(rows) if rows else "Nothing was measured.",
        tables.listed(_relative(rows)),
        "![accuracy](accuracy.png)" if rows else "",
        "Not matched:" if failures else "",
        tables.listed(failures),
    ]


def _table(rows: Mapping[Way, Record]) -> str:
    shown = {
        "method, spectra": lambda way, row: way.label,
        "pairs": lambda way, row: str(row["pairs"]),
        "mean": lambda way, row: f"**{row['mean']:.2f}**",
        "median": _digits("median"),
        "over 8": lambda way, row: tables.number(row["bad"], ".0%"),
        "AUC": _digits("auc", ".3f"),
        **{name: _digits(name) for name in ("direct", "symmetric", "either")},
        **{name: _digits(name, "") for name in ("flipped", "partly")},
        "best finalist": _digits("oracle"),
        "warned": lambda way, row: _warned(row),
        **{name: _digits(name) for name in ("coverage", "energy")},
        "back": _digits("bijectivity"),
        "s": _digits("seconds"),
        "CPU s": _digits("cpu_seconds"),
    }
    cells = [[cell(way, row) for cell in shown.values()] for way, row in rows.items()]
    return tables.table(list(shown), cells)


def _digits(name: str, form: str = ".2f") -> Callable[[Way, Record], str]:
    """Return what shows this number of a summary, and nothing where it is not known."""

    def cell(way: Way, row: Record) -> str:
        value = row[name]
        return "" if value is None or math.isnan(value) else format(value, form)

    return cell


def _warned(row: Record) -> str:
    """Share of bad pairs with a warning, and of the others."""
    if math.isnan(row["oracle"]):  # it chooses among nothing
        return ""
    bad = round(row["bad"] * row["pairs"])
    return f"{row['warned']}/{bad}, {row['false_alarms']}/{row['pairs'] - bad}"


def _relative(rows: Mapping[Way, Record]) -> list[str]:
    """How other spectra compare with exact ones, method by method."""
    exact = {
        (way.basis.kind, way.method): row["mean"]
        for way, row in rows.items()
        if way.basis.backend == "exact"
    }
    return [
        f"{way.label}: {row['mean'] / mean:.2f} times the mean error with exact spectra"
        for way, row in rows.items()
        if way.basis.backend != "exact" and (mean := exact.get((way.basis.kind, way.method)))
    ]


def _draw_accuracy(groups: Mapping[Way, Results], protocol: Protocol, path: Path) -> Path:
    """Draw the share of points within each error, for every way, and over the pairs."""
    figure, (points, pairs) = figures.panels("", 2)
    for i, (way, results) in enumerate(groups.items()):
        records = [result.record for result in results]
        curves = [r["accuracy_either" if protocol.symmetric else "accuracy"] for r in records]
        shares = 100 * np.mean(curves, axis=0)
        points.plot(THRESHOLDS, shares, label=way.label, **figures.line(i))
        errors = np.sort([max(counted(record, protocol), _TICKS[0]) for record in records])
        share = 100 * np.arange(len(errors) + 1) / len(errors)
        pairs.step(np.append(errors[0], errors), share, where="post", **figures.line(i))
    points.set(xlim=(0, 10), xlabel="geodesic error (100 / √area)", ylabel="points (%)")
    pairs.set(xscale="log", xlabel="mean error of a pair (100 / √area)", ylabel="pairs (%)")
    low, high = pairs.get_xlim()
    figures.ticks(pairs, [tick for tick in _TICKS if low <= tick <= high])
    pairs.axvline(BAD, color="0.6", lw=0.8, zorder=0)
    for panel in (points, pairs):
        panel.set_ylim(0, 101)
    points.legend(frameon=False, fontsize=8, loc="lower right")
    return figures.save(figure, path)


def draw_extremes(
    results: Results, pairs: Pairs, protocol: Protocol, *, up: Literal["y", "z"] | None = None
) -> list[Path]:
    """Draw the best, median and worst map of each way: ``extremes-KIND-BACKEND-METHOD.png``."""
    drawn = []
    for way, these in by_way(results).items():
        ranked = sorted(these, key=lambda result: counted(result.record, protocol))
        chosen = {len(ranked) - 1: "worst", (len(ranked) - 1) // 2: "median", 0: "best"}
        kind = "meshes" if way.basis.kind == "mesh" else "clouds"
        path = pairs.folder / f"extremes-{way}.png"
        plot_correspondences(
            path,
            [
                _drawn(pairs, way, ranked[i].problem, f"{what}: {error:.2f}")
                for i, what in reversed(chosen.items())
                for error in [counted(ranked[i].record, protocol)]
            ],
            view=View(up),
            page=Page(
                f"{way.method}: {way.basis.backend} spectra of {kind}",
                f"mean geodesic errors of {len(ranked)} pairs, in hundredths of √area",
            ),
        )
        drawn.append(path)
    return drawn


def _drawn(pairs: Pairs, way: Way, pair: Pair, name: str) -> MatchedPair:
    """With direct errors along edges on all target points, that of the nearest landmark each."""
    source, target = (pairs.spectra.subjects[name] for name in pair)
    point_map = np.load(pairs.map_path(way, pair)).astype(np.int64)
    truth = truth_between(source, target)
    errors = geodesic_errors(source.mesh, point_map, truth)
    points = target.mesh.points
    _, nearest = cKDTree(points[truth.target]).query(points)
    as_cloud = way.basis.kind == "cloud"
    return MatchedPair(
        source=source.mesh.as_cloud() if as_cloud else source.mesh,
        target=target.mesh.as_cloud() if as_cloud else target.mesh,
        point_map=point_map,
        errors=MapErrors(errors[nearest], np.arange(len(points))),
        name=name,
        names=(pair.source, pair.target),
    )
