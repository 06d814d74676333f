r"""Match FAUST bodies of 200,000 vertices, and the same bodies as they are, of 5,000.

    python apps/match_dense.py OUT                          # 5 random pairs of the shapes 0-79
    python apps/match_dense.py OUT --pairs 1 --vertices 500000

Edges are split at their middles until they are short enough, so vertices of the coarse bodies stay
where they are, and every tenth of the landmarks is found on both. Spectra are at hand, 150 modes;
seconds are wall time of `prepare` for both bodies and of `match`, memory is what these need above
what was there before. Errors are along edges, in hundredths of the root of the area; those of the
fine bodies also with each point moved to the nearest vertex of the coarse source, since there a
point that is off by less than half an edge counts as right.

OUT/measurements.jsonl gets a line for each pair as soon as it is matched, and the same command
after an interruption, by the same code, goes on from there.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from measure.command import exit_code, parser_of
from measure.matching.pairs import Pair
from measure.matching.sets import pair_sets
from measure.matching.subjects import Subject, truth_between
from measure.matching.triangulations import finer
from measure.store import Record, Store, code_digest
from measure.worker import Clocked, clocked
from scipy.spatial import cKDTree

from spectra_kit import match, prepare, spectrum
from spectra_kit._core.types import Ints
from spectra_kit.errors import DoubtfulMatchWarning
from spectra_kit.maps import Truth, geodesic_errors

_MODES = 150
_THINNED = 10  # landmarks for each that is measured: a way along 200,000 vertices takes its time
_COLUMNS = {
    "vertices": "vertices",
    "error": "error",
    "rounded": "rounded",
    "coarse": "of 5,000",
    "seconds": "seconds",
    "gigabytes": "GB",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Match and print the table; return the exit code."""
    parser = parser_of("match_dense.py", __doc__)
    parser.add_argument("out", type=Path, help="folder for measurements")
    parser.add_argument("--data", default="faust_r", metavar="SET",
        help="a folder, or the name of a set in $SPECTRA_KIT_DATA (%(default)s)")  # fmt: skip
    parser.add_argument("--pairs", type=int, default=5, metavar="N")
    parser.add_argument("--vertices", type=int, default=200_000, metavar="N", help="at least")
    parser.add_argument("--seed", type=int, default=0, help="of the draw (%(default)s)")
    args = parser.parse_args(argv)
    return exit_code(lambda: _match_all(args))


def _match_all(args: argparse.Namespace) -> None:
    [chosen] = pair_sets([args.data], count=args.pairs, seed=args.seed)
    store = Store(args.out)
    rows = []
    for names in chosen.protocol.pairs:
        pair = Pair(*names)
        key = f"{pair}, {args.vertices}, {code_digest()}"
        rows.append(store.get(key) or store.add(key, measure(chosen.subjects, pair, args.vertices)))
        print(rows[-1], flush=True)
    print(table(rows))


def measure(subjects: Mapping[str, Subject], pair: Pair, n: int) -> Record:
    """Match a pair as it is and with `n` vertices: errors, seconds and gigabytes of the latter."""
    source, target = (subjects[name] for name in pair)
    fine = [Subject(s.name, finer(s.mesh, n), s.landmarks, s.mirrored) for s in (source, target)]
    found, took = _matched(*fine)
    truth = truth_between(source, target)
    some = Truth(truth.source[::_THINNED], truth.target[::_THINNED])
    _, nearest = cKDTree(source.mesh.points).query(fine[0].mesh.points)
    return {
        "status": "ok",
        "pair": str(pair),
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


def table(rows: Sequence[Record]) -> str:
    """Return a line for each pair, and median and worst."""
    out = [f"{'pair':<26}" + "".join(f"{name:>10}" for name in _COLUMNS.values())]
    values = np.array([[row[name] for name in _COLUMNS] for row in rows])
    named = [(row["pair"], line) for row, line in zip(rows, values, strict=True)]
    named += [("median", np.median(values, axis=0)), ("most", values.max(axis=0))]
    out += [f"{name:<26}" + "".join(f"{value:>10.5g}" for value in line) for name, line in named]
    return "\n".join(out)


if __name__ == "__main__":
    sys.exit(main())
