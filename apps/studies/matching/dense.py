r"""Match FAUST bodies of 200,000 vertices, and the same bodies as they are, of 5,000.

    python apps/studies/run.py dense OUT                   # 5 random pairs of the shapes 0-79
    python apps/studies/run.py dense OUT --pairs 1 --vertices 500000

Edges are split at their middles until they are short enough, so vertices of the coarse bodies stay
where they are, and every tenth of the landmarks is found on both. Spectra are at hand, 150 modes;
seconds are wall time of `prepare` for both bodies and of `match`, memory is what these need above
what was there before. Errors are along edges, in hundredths of the root of the area; those of the
fine bodies also with each point moved to the nearest vertex of the coarse source (*rounded*), since
there a point that is off by less than half an edge counts as right; *coarse*: of the bodies as they
are.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from spectra_kit import match, prepare, spectrum
from spectra_kit._core.types import Ints
from spectra_kit.errors import DoubtfulMatchWarning
from spectra_kit.maps import Truth, geodesic_errors
from studies.machine import describe_machine
from studies.matching.pairs import Pair
from studies.matching.sets import pair_sets
from studies.matching.subjects import Subject, truth_between
from studies.matching.triangulations import finer
from studies.report import Table, write_report
from studies.store import Record, Store
from studies.study import Study, run
from studies.worker import Clocked, clocked

_MODES = 150
_THINNED = 10  # landmarks for each that is measured: a way along 200,000 vertices takes its time
_COLUMNS = {
    **{"pair": "", "vertices": ",.0f", "error": ".2f", "rounded": ".2f", "coarse": ".2f"},
    **{"seconds": ".1f", "gigabytes": ".2f"},
}


@dataclass(frozen=True, eq=False, kw_only=True)
class Dense(Study[int, Pair]):
    """Pairs as they are and with so many vertices: errors, seconds and gigabytes of the latter."""

    name = "dense"
    fresh = False
    subjects: Mapping[str, Subject]

    def facts(self, contender: int, problem: Pair) -> dict[str, object]:
        bodies = [self.subjects[name].digest for name in problem]
        return {"subjects": bodies, "vertices": contender, "modes": _MODES, "thinned": _THINNED}

    def measure(self, contender: int, problem: Pair) -> Record:
        source, target = (self.subjects[name] for name in problem)
        fine = [
            Subject(s.name, finer(s.mesh, contender), s.landmarks, s.mirrored)
            for s in (source, target)
        ]
        found, took = _matched(*fine)
        truth = truth_between(source, target)
        some = Truth(truth.source[::_THINNED], truth.target[::_THINNED])
        _, nearest = cKDTree(source.mesh.points).query(fine[0].mesh.points)
        return {
            "vertices": min(s.geometry.n for s in fine),
            "error": float(geodesic_errors(fine[0].mesh, found, some).mean()),
            "rounded": float(geodesic_errors(source.mesh, nearest[found], some).mean()),
            "coarse": float(geodesic_errors(source.mesh, _matched(source, target)[0], some).mean()),
            "seconds": took.seconds,
            "gigabytes": took.peak_bytes / 2**30,
        }


def _matched(source: Subject, target: Subject) -> tuple[Ints, Clocked]:
    """Return the point map, and what it took."""
    spectra = [spectrum(subject.mesh, _MODES) for subject in (source, target)]
    with warnings.catch_warnings(), clocked() as took:
        warnings.simplefilter("ignore", DoubtfulMatchWarning)
        sides = [prepare(s, x.mesh) for s, x in zip(spectra, (source, target), strict=True)]
        return match(*sides).point_map, took


def options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--data", default="faust_r", metavar="SET",
        help="a folder, or the name of a set in $SPECTRA_KIT_DATA (%(default)s)")  # fmt: skip
    add("--pairs", type=int, default=5, metavar="N")
    add("--vertices", type=int, default=200_000, metavar="N", help="at least")
    add("--seed", type=int, default=0, help="of the draw (%(default)s)")


def measure(args: argparse.Namespace) -> bool:
    """Match and report; return whether there is a result."""
    [chosen] = pair_sets([args.data], count=args.pairs, seed=args.seed)
    study = Dense(
        folder=args.out,
        contenders=[args.vertices],
        problems=[Pair(*names) for names in chosen.protocol.pairs],
        subjects=chosen.subjects,
    )
    results = run(study, Store(args.out), jobs=0, retry=True, progress=True)
    rows = [{"pair": str(result.problem), **result.record} for result in results if result.ok]
    table = Table("Pairs, and all of them", rows + _summary(rows), _COLUMNS)
    write_report(args.out, "dense", results, [table], describe_machine())
    return bool(rows)


def _summary(rows: Sequence[Record]) -> list[Record]:
    """Return the median and the most of every column."""
    names = [name for name in _COLUMNS if name != "pair"]
    values = np.array([[row[name] for name in names] for row in rows])
    if not rows:
        return []
    told = {"median": np.median(values, axis=0), "most": values.max(axis=0)}
    return [
        {"pair": name, **dict(zip(names, line.tolist(), strict=True))}
        for name, line in told.items()
    ]
