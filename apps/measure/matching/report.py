"""Matching as Markdown for readers, JSON and CSV for programs, curves and pictures."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.spatial import cKDTree

from measure import figures, tables
from measure.matching.calibration import DOUBT, draw_calibration
from measure.matching.measures import THRESHOLDS
from measure.matching.methods import METHODS
from measure.matching.pairs import Pair, Pairs, Way
from measure.matching.protocols import PROTOCOLS, Protocol
from measure.matching.pyfm_peer import PARAMETERS
from measure.matching.sets import PairSet
from measure.matching.subjects import truth_between
from measure.store import Record
from measure.study import Result
from spectra_kit._core.version import VERSION
from spectra_kit.geometry import PointCloud
from spectra_kit.maps import FLIP_MARGIN, MapErrors, geodesic_errors
from spectra_kit.show import MatchedPair, Page, View, plot_correspondences

Results = Sequence[Result[Way, Pair]]

#: A pair with a mean error above this is wrong.
BAD = 8.0
_WORST = 3  # pairs of a set that are drawn, beside the best and the median
_DISTANCES = {
    "edges": "geodesic distances along the edges of",
    "exact": "exact geodesic distances on",
}
_TICKS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50)  # less is drawn as the first
_ARRAYS = ("accuracy", "accuracy_either")


@dataclass(frozen=True, eq=False)
class Matched:
    """A set, the study that matched it, and what came out."""

    set: PairSet
    study: Pairs
    results: Results

    @property
    def by_way(self) -> dict[Way, list[Result[Way, Pair]]]:
        """What was measured, in the order in which the ways first appear."""
        groups: dict[Way, list[Result[Way, Pair]]] = {}
        for result in self.results:
            if result.ok:
                groups.setdefault(result.contender, []).append(result)
        return groups


Row = tuple[PairSet, Way, Record]  # a summary, and of what


def counted(record: Record, protocol: Protocol) -> float:
    """Return the error that the protocol counts."""
    return float(record["either" if protocol.symmetric else "direct"])


def summarize(records: Sequence[Record], protocol: Protocol) -> Record:
    """Summarise the pairs of a set that were matched in one way.

    ``bad`` is the share above `BAD`; ``flipped`` are pairs with left for right, ``partly`` others
    where the smaller error at each correspondence is on average smaller than the direct one by more
    than the margin: an arm or a leg went to the other side; both None if a pair has no symmetric
    truth. ``doubted_wrong`` and ``doubted_right`` are how many pairs above `BAD`, and of the
    others, the method doubts: it has less confidence than `DOUBT`, or where it tells none calls
    them ambiguous.
    """
    errors = [counted(record, protocol) for record in records]
    wrong = [error > BAD for error in errors]
    doubted = [doubts(record) for record in records]
    partly = [r["direct"] - r["either"] > FLIP_MARGIN and not r["flipped"] for r in records]
    sided = not any(math.isnan(record["symmetric"]) for record in records)

    def over(what: Any, name: str) -> float:
        return float(what(record[name] for record in records))

    means = ("direct", "symmetric", "either", "coverage", "energy", "bijectivity", "oracle")
    return {
        "pairs": len(records),
        "mean": statistics.fmean(errors),
        "median": statistics.median(errors),
        "worst": max(errors),
        "bad": statistics.fmean(wrong),
        "auc": over(statistics.fmean, "auc_either" if protocol.symmetric else "auc"),
        **{name: over(statistics.fmean, name) for name in means},
        "flipped": sum(record["flipped"] for record in records) if sided else None,
        "partly": sum(partly) if sided else None,
        "doubted_wrong": sum(d and b for d, b in zip(doubted, wrong, strict=True)),
        "doubted_right": sum(d and not b for d, b in zip(doubted, wrong, strict=True)),
        "seconds": over(statistics.median, "seconds"),
        "cpu_seconds": over(statistics.median, "cpu_seconds"),
    }


def doubts(record: Record) -> bool:
    """Tell whether the method doubts its map."""
    confidence = record["confidence"]
    return bool(record["ambiguous"] if math.isnan(confidence) else confidence < DOUBT)


def write_report(folder: Path, matched: Sequence[Matched]) -> Path:
    """Write ``matching.md``, its JSON, ``pairs.csv`` and curves; return the first.

    All sets were matched with as many modes and have the same errors.
    """
    rows = [
        (one.set, way, summarize([r.record for r in results], one.set.protocol))
        for one in matched
        for way, results in one.by_way.items()
    ]
    tables.write_json(
        folder / "matching.json",
        {
            "version": VERSION,
            "sets": [
                {
                    "set": one.set.name,
                    "protocol": one.set.protocol.name,
                    "pairs": len(one.set.protocol.pairs),
                    "note": one.set.note,
                }
                for one in matched
            ],
            "k": matched[0].study.spectra.k,
            "geodesics": matched[0].study.geodesics,
            "summaries": [{"set": of.name, **_names(way), **row} for of, way, row in rows],
            "failures": [
                {"set": one.set.name, **_names(r.contender, r.problem), "reason": r.reason}
                for one, r in _failures(matched)
            ],
        },
    )
    lines = [{"set": one.set.name, **_line(r)} for one in matched for r in one.results if r.ok]
    tables.write_csv(folder / "pairs.csv", lines)
    drawn = [
        *(_draw_accuracy(one, folder) for one in matched if one.by_way),
        *_draw_calibrations(matched, folder),
    ]
    tables.write_markdown(folder / "matching.md", _paragraphs(matched, rows, drawn))
    return folder / "matching.md"


def _failures(matched: Sequence[Matched]) -> Iterator[tuple[Matched, Result[Way, Pair]]]:
    return ((one, result) for one in matched for result in one.results if not result.ok)


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
    matched: Sequence[Matched], rows: Sequence[Row], pictures: Sequence[Path]
) -> list[str]:
    study = matched[0].study
    peer = f"pyfm: {PARAMETERS}. `-k` does not change that, only how many modes it solves for."
    reasons: dict[str, list[str]] = {}
    for one, result in _failures(matched):
        way, pair = result.contender, result.problem
        who = f"{pair.source} to {pair.target} of {one.set.name}"
        reasons.setdefault(result.reason, []).append(f"{who} ({', '.join(_names(way).values())})")
    failures = [
        f"{who}{f' and {len(others)} more' if others else ''}: {why}"
        for why, (who, *others) in reasons.items()
    ]
    return [
        "# Matching",
        f"{study.spectra.k} modes; spectra_kit {VERSION}.",
        tables.listed(_told(one.set) for one in matched),
        f"Errors are {_DISTANCES[study.geodesics]} the source, in hundredths of the root of"
        " its area. *Mean*, *median* (of the means of pairs), *worst* pair, *over 8* (share of"
        " pairs: they are wrong) and *AUC* (up to 10) count direct errors, or what the protocol"
        " says. *Best finalist*: mean direct error if, of each map and of the"
        " other candidates that were refined last, finished by plain ZoomOut, the truth chose; no"
        " bound, as the whole method might finish those better."
        f" *Doubted*: wrong and right pairs with a confidence below {DOUBT:g}, or called ambiguous"
        " where none is told.",
        "Seconds are medians of one pair, spectra given and nothing else. A pair has one thread,"
        " also with `--jobs 1`; with more, as many pairs run side by side and share the machine,"
        " which lengthens *s*.",
        peer if any(METHODS[way.method].own for _, way, _ in rows) else "",
        _table(rows, _ERRORS) if rows else "Nothing was measured.",
        tables.listed(_relative(rows)),
        "What kind of errors. *Flipped*: pairs with left for right, whose mean symmetric error is"
        f" lower than the direct one by more than {FLIP_MARGIN:g}; *partly*: others where the"
        " smaller error at each correspondence (*either*) is lower by as much. All are blank"
        " without a symmetric truth, and front for back is in neither. *Coverage*: share of the"
        " source's area hit. *Energy*: Dirichlet, 1 for an isometry. *Back*: mean distance along"
        " edges to where the transposed functional map leads back."
        if rows
        else "",
        _table(rows, _KINDS) if rows else "",
        "\n".join(f"![{path.stem}]({path.name})" for path in pictures),
        "Not matched:" if failures else "",
        tables.listed(failures),
    ]


def _told(of: PairSet) -> str:
    """Say what a set is."""
    protocol = of.protocol
    note = f"; {of.note}" if of.note else ""
    count = f"{len(protocol.pairs)} pairs"
    return f"{of.name}: {count} ({protocol.name}: {PROTOCOLS[protocol.name]}){note}"


def _table(rows: Sequence[Row], shown: Mapping[str, Callable[[Record], str]]) -> str:
    cells = [[of.name, way.label, *(cell(row) for cell in shown.values())] for of, way, row in rows]
    return tables.table(["set", "method, spectra", *shown], cells)


def _digits(name: str, form: str = ".2f") -> Callable[[Record], str]:
    """Return what shows this number of a summary, and nothing where it is not known."""

    def cell(row: Record) -> str:
        value = row[name]
        return "" if value is None or math.isnan(value) else format(value, form)

    return cell


def _doubted(which: Literal["wrong", "right"]) -> Callable[[Record], str]:
    """Return what shows how many of the wrong or of the right pairs are doubted."""

    def cell(row: Record) -> str:
        if math.isnan(row["oracle"]):  # it chooses among nothing
            return ""
        wrong = round(row["bad"] * row["pairs"])
        return f"{row[f'doubted_{which}']}/{wrong if which == 'wrong' else row['pairs'] - wrong}"

    return cell


_ERRORS: dict[str, Callable[[Record], str]] = {
    "pairs": lambda row: str(row["pairs"]),
    "mean": lambda row: f"**{row['mean']:.2f}**",
    "median": _digits("median"),
    "worst": _digits("worst"),
    "over 8": _digits("bad", ".0%"),
    "best finalist": _digits("oracle"),
    "doubted wrong": _doubted("wrong"),
    "doubted right": _doubted("right"),
    "s": _digits("seconds"),
    "CPU s": _digits("cpu_seconds"),
}
_KINDS: dict[str, Callable[[Record], str]] = {
    "AUC": _digits("auc", ".3f"),
    "direct": _digits("direct"),
    "symmetric": _digits("symmetric"),
    "either": lambda row: "" if math.isnan(row["symmetric"]) else f"{row['either']:.2f}",
    **{name: _digits(name, "") for name in ("flipped", "partly")},
    **{name: _digits(name) for name in ("coverage", "energy")},
    "back": _digits("bijectivity"),
}


def _relative(rows: Sequence[Row]) -> Iterator[str]:
    """Say how other spectra compare with exact ones, and sets with those they are held against."""
    means = {(of.name, way): row["mean"] for of, way, row in rows}
    for of, way, row in rows:
        exact = way._replace(basis=way.basis._replace(backend="exact"))
        if way != exact and (mean := means.get((of.name, exact))):
            ratio = f"{row['mean'] / mean:.2f} times the mean error"
            yield f"{of.name}, {way.label}: {ratio} with exact spectra"
        if of.name != of.against and (mean := means.get((of.against, way))):
            yield f"{of.name}, {way.label}: {row['mean'] / mean:.2f} times that of {of.against}"


def _draw_accuracy(matched: Matched, folder: Path) -> Path:
    """Draw the share of points within each error, for every way, and over the pairs."""
    protocol = matched.set.protocol
    figure, (points, pairs) = figures.panels(matched.set.name, 2)
    for i, (way, results) in enumerate(matched.by_way.items()):
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
    return figures.save(figure, folder / f"accuracy-{matched.set.name}.png")


def _draw_calibrations(matched: Sequence[Matched], folder: Path) -> list[Path]:
    """Draw how far confidences can be believed, over all sets, for each way that tells them."""
    told: dict[Way, list[tuple[float, bool]]] = {}
    for one in matched:
        for way, results in one.by_way.items():
            for record in (result.record for result in results):
                if not math.isnan(record["confidence"]):
                    right = counted(record, one.set.protocol) <= BAD
                    told.setdefault(way, []).append((record["confidence"], right))
    return [
        draw_calibration(
            folder / f"calibration-{way}.png", *zip(*maps, strict=True), title=way.label
        )
        for way, maps in told.items()
    ]


def draw_extremes(matched: Matched) -> list[Path]:
    """Draw the best, the median and the worst maps of each way: ``extremes-SET-WAY.png``."""
    drawn = []
    protocol = matched.set.protocol
    for way, results in matched.by_way.items():
        ranked = sorted(results, key=lambda result: counted(result.record, protocol))
        last = len(ranked) - 1
        chosen = {last - i: f"{i + 1}. worst" if i else "worst" for i in range(min(_WORST, last))}
        chosen |= {last // 2: "median", 0: "best"}
        kind = "meshes" if way.basis.kind == "mesh" else "clouds"
        path = matched.study.folder / f"extremes-{matched.set.name}-{way}.png"
        plot_correspondences(
            [
                _drawn(matched.study, way, ranked[i].problem, f"{chosen[i]}: {error:.2f}")
                for i in sorted(chosen)
                for error in [counted(ranked[i].record, protocol)]
            ],
            path=path,
            view=View(matched.set.up),
            page=Page(
                f"{matched.set.name}, {way.method}: {way.basis.backend} spectra of {kind}",
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
    points = target.geometry.points
    _, nearest = cKDTree(points[truth.target]).query(points)
    as_cloud = way.basis.kind == "cloud"
    return MatchedPair(
        source=PointCloud(source.geometry.points) if as_cloud else source.geometry,
        target=PointCloud(points) if as_cloud else target.geometry,
        point_map=point_map,
        errors=MapErrors(errors[nearest], np.arange(len(points))),
        name=name,
        names=(pair.source, pair.target),
    )
