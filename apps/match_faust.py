r"""Match sets of shapes whose correspondence is known, and measure the maps.

    python apps/match_faust.py OUT                                      # 100 random pairs of FAUST
    python apps/match_faust.py OUT --data faust_r smal_r scape_a tosca_r
    python apps/match_faust.py OUT --data smal_r --protocol random --pairs 60
    python apps/match_faust.py OUT --data tosca_r --only cat
    python apps/match_faust.py OUT --data faust_r --triangulations --pairs 5
    python apps/match_faust.py OUT --backends exact neo
    python apps/match_faust.py OUT --methods match pyfm --pyfm-python other/python
    python apps/match_faust.py OUT --protocol ren-300
    python apps/match_faust.py OUT --demo                               # an animal, no data

A set is a folder of NAME.npz files, or the name of one in $SPECTRA_KIT_DATA: vertices V, faces F,
corres (vertices in corresponding places, the same number in each file) and corres_sym (their mirror
images, where they are known), all counted from 0. Of faust_r, and of folders with other names, 100
random pairs are matched, of smal_r and scape_a all, of tosca_r all within a class;
--protocol and --pairs say otherwise.

With --triangulations the targets are made anew in six ways: as they are, with anisotropic
triangles, simplified by quadrics, dense, by marching cubes, and as a cloud.

OUT gets the spectra, the maps (source vertex of each target point; the name of the .npy ends with
the digest in pairs.csv), measurements.jsonl with a line for each pair as soon as it is matched,
matching.md, matching.json, pairs.csv, accuracy curves, how far confidences can be believed, and
pictures of the best, the median and the worst pairs. The same command after an interruption
computes only what is missing. Results are remembered by their inputs, the options and the code:
other weights, or another version, are measured anew.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from measure.command import exit_code, parser_of
from measure.matching.methods import METHODS
from measure.matching.pairs import BACKENDS, KINDS, Pair, Pairs, Spectra, match_all, ways
from measure.matching.protocols import PROTOCOLS
from measure.matching.report import Matched, draw_extremes, write_report
from measure.matching.sets import PairSet, demo_set, pair_sets, triangulated_sets

from spectra_kit._core.threads import usable_cores
from spectra_kit.errors import MissingDependencyError

DEFAULT = next(iter(METHODS))
_FEW = 5  # pairs in six triangulations, where no other number is asked for
_ALL = 10**9  # pairs to draw these from


def _parser() -> argparse.ArgumentParser:
    parser = parser_of("match_faust.py", __doc__)
    add = parser.add_argument
    add("out", type=Path, help="folder for everything")
    add("--data", nargs="+", default=["faust_r"], metavar="SET",
        help="folders, or names of sets in $SPECTRA_KIT_DATA (default: faust_r)")  # fmt: skip
    add("--demo", action="store_true", help="a demo animal in four poses instead, 12 pairs")
    add("--only", nargs="+", default=(), metavar="PREFIX", help="subjects whose names begin so")
    add("--triangulations", action="store_true", help="the targets in six triangulations")
    add(
        "--protocol",
        choices=list(PROTOCOLS),
        help="which pairs, and which errors count (default: what is usual for each set)",
    )
    add("--pairs", type=int, metavar="N",
        help="draw N of each set (random: 100; triangulations: 5; others: all)")  # fmt: skip
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
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Match, print the report; return the exit code: 1 if nothing could be measured."""
    args = _parser().parse_args(argv)
    return exit_code(lambda: _match(args))


def _match(args: argparse.Namespace) -> bool:
    """Match and report; return whether there is a result."""
    matched = [_matched(one, args) for one in _sets(args)]
    report = write_report(args.out, matched)
    print(report.read_text(), flush=True)
    print(f"report: {report}")
    if not args.no_pictures:
        try:
            for one in matched:
                for path in draw_extremes(one):
                    print(f"picture: {path}")
        except MissingDependencyError as error:
            print(f"best, median and worst pairs are not drawn: {error}", file=sys.stderr)
    return any(result.ok for one in matched for result in one.results)


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
    if args.demo:
        sets = [demo_set(None if args.triangulations else args.pairs)]
    else:
        sets = pair_sets(
            args.data,
            protocol=args.protocol,
            count=_ALL if args.triangulations else args.pairs,
            seed=args.seed,
            only=args.only,
            listed=args.pair_list,
        )
    if not args.triangulations:
        return sets
    count = _FEW if args.pairs is None else args.pairs
    return [made for one in sets for made in triangulated_sets(one, count=count, seed=args.seed)]


if __name__ == "__main__":
    sys.exit(main())
