r"""Match sets of shapes whose correspondence is known, and measure the maps.

    python apps/studies/run.py matching OUT                      # 100 random pairs of FAUST
    python apps/studies/run.py matching OUT --data faust_r smal_r scape_a tosca_r
    python apps/studies/run.py matching OUT --data smal_r --protocol random --pairs 60
    python apps/studies/run.py matching OUT --data tosca_r --only cat
    python apps/studies/run.py matching OUT --data faust_r --triangulations --pairs 5
    python apps/studies/run.py matching OUT --data faust_r --spoilings --pairs 10
    python apps/studies/run.py matching OUT --backends exact neo
    python apps/studies/run.py matching OUT --methods match pyfm --pyfm-python other/python
    python apps/studies/run.py matching OUT --protocol ren-300
    python apps/studies/run.py matching OUT --demo               # an animal, no data

A set is a folder of NAME.npz files, or the name of one in $SPECTRA_KIT_DATA: vertices V, faces F,
corres (vertices in corresponding places, the same number in each file) and corres_sym (their mirror
images, where they are known), all counted from 0. Or scans with the truth of each pair, as in
shrec19: pairs.npz beside them. Of faust_r, and of folders with other names, 100
random pairs are matched, of smal_r and scape_a all, of tosca_r all within a class, of shrec19 those
with a truth; --protocol and --pairs say otherwise.

With --triangulations the targets are made anew in six ways: as they are, with anisotropic
triangles, simplified by quadrics, dense, by marching cubes, and as a cloud. With --spoilings they
are spoiled: parts that touch grown together, holes, cuts, noise, faces turned over, scans.

Errors are geodesic distances along the edges of the source, or exact ones, in hundredths of the
root of its area. *Mean*, *median*, *worst* pair, *over 8* (share of pairs: they are wrong) and
*AUC* (up to 10) count direct errors, or what the protocol says. *Best finalist*: mean direct error
if, of each map and of the other candidates that were refined last, finished by plain ZoomOut, the
truth chose; no bound, as the whole method might finish those better. *Doubted*: wrong and right
pairs with a confidence below 0.5, or called ambiguous where none is told. Seconds are medians of
one pair, spectra given; a pair has one thread, and pairs side by side share the machine. *Of
exact*: times the mean error with exact spectra; *of the plain set*: times that of the set that it
is made of.

*Confidence* is the median; its table counts the maps, and points, of each confidence that were
right, within 8: as shipped, and of pairs of one half of the shapes as fitted to those of the other.

*Flipped*: pairs with left for right, whose mean symmetric error is lower than the direct one by
more than a margin; *partly*: others where the smaller error at each correspondence (*either*) is
lower by as much; front for back is in neither, and both are blank without a symmetric truth.
*Coverage*: share of the source's area hit. *Energy*: Dirichlet, 1 for an isometry. *Back*: mean
distance along edges to where the transposed functional map leads back.

OUT also gets the spectra, the maps (source vertex of each target point; the name of the .npy ends
with the key in matching.csv), and pictures of the best, the median and the worst pairs. Other
weights, or another version, are measured anew.
"""

from __future__ import annotations

import argparse
import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from spectra_kit._core.threads import usable_cores
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import PointCloud
from spectra_kit.maps import FLIP_MARGIN, MapErrors, geodesic_errors
from spectra_kit.show import MatchedPair, Page, View, plot_correspondences
from studies.machine import describe_machine
from studies.matching.methods import METHODS
from studies.matching.pairs import BACKENDS, KINDS, Pair, Pairs, Spectra, Way, match_all, ways
from studies.matching.sets import (
    PROTOCOLS,
    PairSet,
    Protocol,
    demo_set,
    pair_sets,
    remade_sets,
)
from studies.matching.spoilings import SPOILINGS
from studies.matching.subjects import truth_between
from studies.matching.triangulations import TRIANGULATIONS
from studies.matching.trust import COLUMNS, trust
from studies.report import Table, ratio, unless_missing, write_report
from studies.store import Record
from studies.study import Result, measured_by

Results = Sequence[Result[Way, Pair]]

DEFAULT = next(iter(METHODS))
#: A pair with a mean error above this is wrong.
BAD = 8.0
#: Maps with less confidence are doubted.
DOUBT = 0.5
_FEW = 5  # pairs of what is made anew, where no other number is asked for
_ALL = 10**9  # pairs to draw these from
_WORST = 3  # pairs of a set that are drawn, beside the best and the median


def options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--data", nargs="+", default=["faust_r"], metavar="SET",
        help="folders, or names of sets in $SPECTRA_KIT_DATA (default: faust_r)")  # fmt: skip
    add("--demo", action="store_true", help="a demo animal in four poses instead, 12 pairs")
    add("--only", nargs="+", default=(), metavar="PREFIX", help="subjects whose names begin so")
    made = parser.add_mutually_exclusive_group()
    made.add_argument(
        "--triangulations",
        action="store_const",
        dest="makers",
        default={},
        const=TRIANGULATIONS,
        help="the targets in six triangulations",
    )
    made.add_argument("--spoilings", action="store_const", dest="makers",
        const=SPOILINGS, help="the targets spoiled as scans are")  # fmt: skip
    add(
        "--protocol",
        choices=list(PROTOCOLS),
        help="which pairs, and which errors count (default: what is usual for each set)",
    )
    add("--pairs", type=int, nargs="+", metavar="N",
        help="draw N of each set, or its N of each (random: 100; anew: 5; else all)")  # fmt: skip
    add("--seed", type=int, default=0, help="of the draw (%(default)s)")
    add("--pair-list", type=Path, help="of ren-300 (default: ren_pairs.txt in each set)")
    add("--backends", nargs="+", choices=list(BACKENDS), default=["exact"], metavar="NAME",
        help=f"spectra: {', '.join(BACKENDS)} (default: exact)")  # fmt: skip
    add("--methods", nargs="+", choices=list(METHODS), default=[DEFAULT], metavar="NAME",
        help=f"{', '.join(METHODS)} (default: {DEFAULT})")  # fmt: skip
    add("--geometry", nargs="+", choices=KINDS, default=["mesh"], help="clouds have no faces")
    add("-k", type=int, default=150, help="modes; pyFM ends with 110 all the same (%(default)s)")
    add("--weights", default="small", metavar="NAME|FILE", help="of the network (%(default)s)")
    add("--pyfm-python", metavar="PATH", help="the Python that has pyFM, if it is another one")
    add("--geodesics", choices=("edges", "exact"), default="edges",
        help="distances along edges, or exact ones: minutes a pair (%(default)s)")  # fmt: skip
    add("--jobs", type=int, default=usable_cores(),
        help="pairs side by side, on one thread each (%(default)s)")  # fmt: skip
    add("--no-pictures", action="store_true", help="do not draw pairs")


def measure(args: argparse.Namespace) -> bool:
    """Match and report; return whether there is a result."""
    matched = [_matched(one, args) for one in _sets(args)]
    drawn = list[Path]()
    if not args.no_pictures:
        with unless_missing("best, median and worst pairs are"):
            drawn += [path for one in matched for path in draw_extremes(one)]
    report(args.out, matched, drawn)
    return any(result.ok for one in matched for result in one.results)


@dataclass(frozen=True, eq=False)
class Matched:
    """A set, the study that matched it, and what came out."""

    set: PairSet
    study: Pairs
    results: Results

    @property
    def by_way(self) -> dict[Way, list[Result[Way, Pair]]]:
        """What was measured, in the order in which the ways first appear."""
        return measured_by(self.results)


def _matched(pair_set: PairSet, args: argparse.Namespace) -> Matched:
    """Match the pairs of one set in all ways that are asked for."""
    chosen = ways(args.geometry, args.backends, args.methods)
    spectra = Spectra(
        folder=args.out,
        contenders=list(dict.fromkeys(way.basis for way in chosen)),
        problems=list(pair_set.subjects),
        subjects=pair_set.subjects,
        k=args.k,
        weights=args.weights,
    )
    study = Pairs(
        folder=args.out,
        contenders=chosen,
        problems=[Pair(*names) for names in pair_set.protocol.pairs],
        spectra=spectra,
        geodesics=args.geodesics,
        pyfm_python=args.pyfm_python,
    )
    return Matched(pair_set, study, match_all(study, jobs=args.jobs, progress=True))


def _sets(args: argparse.Namespace) -> list[PairSet]:
    """Return the sets that are asked for."""
    counts = args.pairs or [None]
    if len(counts) not in (1, len(args.data)):
        raise InvalidInputError("pairs", f"be one number, or {len(args.data)}, one a set", counts)
    if args.demo:
        sets = [demo_set(None if args.makers else counts[0])]
    else:
        each = counts * len(args.data) if len(counts) == 1 else counts
        sets = [
            one
            for name, count in zip(args.data, each, strict=True)
            for one in pair_sets(
                [name],
                protocol=args.protocol,
                count=_ALL if args.makers else count,
                seed=args.seed,
                only=args.only,
                listed=args.pair_list,
            )
        ]
    if not args.makers:
        return sets
    few = counts[0] or _FEW
    return [
        made for one in sets for made in remade_sets(one, args.makers, count=few, seed=args.seed)
    ]


# --- tables ---


_WHO = {"set": "", "method": ""}
_ERRORS = {
    **_WHO,
    **{"pairs": "d", "mean": ".2f", "median": ".2f", "worst": ".2f", "over 8": ".0%"},
    **{
        "best finalist": ".2f",
        "doubted wrong": "",
        "doubted right": "",
        "confidence": ".2f",
        "s": ".2f",
    },
    **{"CPU s": ".2f", "of exact": ".2f", "of the plain set": ".2f"},
}
_KINDS = {
    **_WHO,
    **{"AUC": ".3f", "direct": ".2f", "symmetric": ".2f", "either": ".2f", "flipped": "d"},
    **{"partly": "d", "coverage": ".2f", "energy": ".2f", "back": ".2f"},
}


def report(folder: Path, matched: Sequence[Matched], drawn: Sequence[Path] = ()) -> Path:
    """Write ``matching.csv``, with a line for each pair, and its tables.

    All sets were matched with as many modes and have the same errors.
    """
    rows = [
        {"set": one.set.name, "method": way.label, "way": way, "against": one.set.against,
         **summarize([result.record for result in results], one.set.protocol)}
        for one in matched
        for way, results in one.by_way.items()
    ]  # fmt: skip
    means = {(row["set"], row["way"]): row["mean"] for row in rows}
    for row in rows:
        exact = row["way"]._replace(basis=row["way"].basis._replace(backend="exact"))
        if exact != row["way"]:
            row["of exact"] = ratio(row["mean"], means.get((row["set"], exact)))
        if row["against"] != row["set"]:
            row["of the plain set"] = ratio(row["mean"], means.get((row["against"], row["way"])))
    sets = [
        {"set": one.set.name, "pairs": len(one.set.protocol.pairs), "note": one.set.note,
         "protocol": one.set.protocol.name, "which": PROTOCOLS[one.set.protocol.name]}
        for one in matched
    ]  # fmt: skip
    study = matched[0].study
    results = [_named(one.set, result) for one in matched for result in one.results]
    told = [r.record for r in results if r.ok and "score" in r.record]
    return write_report(
        folder,
        "matching",
        results,
        [
            Table("Sets", sets, {"set": "", "pairs": "d", "protocol": "", "which": "", "note": ""}),
            Table("Errors", rows, _ERRORS),
            Table("What kind of errors", rows, _KINDS),
            *([Table("Confidence: right of all", trust(folder, told), COLUMNS)] if told else []),
        ],
        describe_machine(),
        figures=drawn,
        settings={"k": study.spectra.k, "geodesics": study.geodesics},
    )


def _named(of: PairSet, result: Result[Way, Pair]) -> Result[Way, Pair]:
    """Tell the set, the names and the way of a pair in columns of their own."""
    names = {**result.problem._asdict(), **result.contender.basis._asdict()}
    names["method"] = result.contender.method
    return replace(result, record={"set": of.name, **names, **result.record})


def counted(record: Record, protocol: Protocol) -> float:
    """Return the error that the protocol counts."""
    return float(record["either" if protocol.symmetric else "direct"])


def summarize(records: Sequence[Record], protocol: Protocol) -> Record:
    """Summarise the pairs of a set that were matched in one way.

    ``over 8`` is the share above `BAD`; ``flipped`` are pairs with left for right, ``partly``
    others where the smaller error at each correspondence is on average smaller than the direct one
    by more than the margin: an arm or a leg went to the other side; both None if a pair has no
    symmetric truth. ``doubted wrong`` and ``doubted right`` are how many pairs above `BAD`, and of
    the others, the method doubts: it has less confidence than `DOUBT`, or where it tells none calls
    them ambiguous.
    """
    errors = [counted(record, protocol) for record in records]
    wrong = [error > BAD for error in errors]
    doubted = [doubts(record) for record in records]
    partly = [r["direct"] - r["either"] > FLIP_MARGIN and not r["flipped"] for r in records]
    sided = not any(math.isnan(record["symmetric"]) for record in records)

    def over(what: Any, name: str) -> float:
        return float(what(record[name] for record in records))

    means = ("direct", "symmetric", "either", "coverage", "energy")
    chooses = not any(math.isnan(record["oracle"]) for record in records)

    def of(which: bool) -> str | None:
        there = [d for d, w in zip(doubted, wrong, strict=True) if w == which]
        return f"{sum(there)}/{len(there)}" if chooses else None

    return {
        "pairs": len(records),
        "mean": statistics.fmean(errors),
        "median": statistics.median(errors),
        "worst": max(errors),
        "over 8": statistics.fmean(wrong),
        "AUC": over(statistics.fmean, "auc_either" if protocol.symmetric else "auc"),
        **{name: over(statistics.fmean, name) for name in means},
        "back": over(statistics.fmean, "bijectivity"),
        "best finalist": over(statistics.fmean, "oracle"),
        "flipped": sum(record["flipped"] for record in records) if sided else None,
        "partly": sum(partly) if sided else None,
        "doubted wrong": of(True),
        "doubted right": of(False),
        "confidence": over(statistics.median, "confidence") if chooses else None,
        "s": over(statistics.median, "seconds"),
        "CPU s": over(statistics.median, "cpu_seconds"),
    }


def doubts(record: Record) -> bool:
    """Tell whether the method doubts its map."""
    confidence = record["confidence"]
    return bool(record["ambiguous"] if math.isnan(confidence) else confidence < DOUBT)


# --- figures ---


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
