r"""Match a set of meshes whose correspondence is known, and measure the maps.

    python apps/match_faust.py OUT --data faust_r                       # 100 random pairs
    python apps/match_faust.py OUT --data faust_r --backends exact neo
    python apps/match_faust.py OUT --data faust_r --methods match pyfm --pyfm-python other/python
    python apps/match_faust.py OUT --data faust_r --protocol ren-300
    python apps/match_faust.py OUT --data tosca_r --protocol same-class --only cat
    python apps/match_faust.py OUT --demo                               # an animal, no data

The data are NAME.npz files: vertices V, faces F, corres (vertices in corresponding places, the same
number in each file) and corres_sym (their mirror images), all counted from 0.

OUT gets the spectra, the maps (source vertex of each target vertex; the name of the .npy ends with
the digest in pairs.csv), measurements.jsonl with a line for each pair as soon as it is matched,
matching.md, matching.json, pairs.csv, accuracy curves, and pictures of the best, median and worst
pair. The same command after an interruption computes only what is missing. Results are remembered
by their inputs, the options and the code: other weights, or another version, are measured anew.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from measure.command import exit_code, parser_of
from measure.matching.methods import METHODS
from measure.matching.pairs import BACKENDS, KINDS, Pair, Pairs, Spectra, match_all, ways
from measure.matching.protocols import PROTOCOLS, Protocol, make_protocol
from measure.matching.report import draw_extremes, write_report
from measure.matching.subjects import Subject, demo_subjects, subjects_in
from measure.shapes import data_folder

from spectra_kit.errors import InvalidInputError, MissingDependencyError

DEFAULT = next(iter(METHODS))


def _parser() -> argparse.ArgumentParser:
    parser = parser_of("match_faust.py", __doc__)
    add = parser.add_argument
    add("out", type=Path, help="folder for everything")
    add("--data", type=Path, help="folder of subjects (default: $SPECTRA_KIT_DATA/faust_r)")
    add("--demo", action="store_true", help="a demo animal in four poses instead, 12 pairs")
    add("--only", nargs="+", metavar="PREFIX", help="only subjects whose names begin so")
    add(
        "--protocol",
        choices=list(PROTOCOLS),
        default="random",
        help="which pairs, and which errors count (default: %(default)s)",
    )
    add("--pairs", type=int, metavar="N", help="draw N of them (random: 100; others: all)")
    add("--seed", type=int, default=0, help="of the draw (%(default)s)")
    add("--pair-list", type=Path, help="of ren-300 (default: ren_pairs.txt beside the data)")
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
    add("--jobs", type=int, default=os.cpu_count() or 1,
        help="pairs side by side, on one thread each (%(default)s)")  # fmt: skip
    add("--no-pictures", action="store_true", help="do not draw best, median and worst pairs")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Match, print the report; return the exit code: 1 if nothing could be measured."""
    args = _parser().parse_args(argv)
    return exit_code(lambda: _match(args))


def _match(args: argparse.Namespace) -> bool:
    """Match and report; return whether there is a result."""
    subjects, protocol = _problem(args)
    chosen = ways(args.geometry, args.backends, args.methods)
    spectra = Spectra(
        folder=args.out,
        contenders=list(dict.fromkeys(way.basis for way in chosen)),
        problems=list(subjects),
        subjects=subjects,
        k=args.k,
        weights=args.weights,
    )
    pairs = Pairs(
        folder=args.out,
        contenders=chosen,
        problems=[Pair(*names) for names in protocol.pairs],
        spectra=spectra,
        geodesics=args.geodesics,
        pyfm_python=args.pyfm_python,
    )
    results = match_all(pairs, jobs=args.jobs, progress=True)
    report = write_report(results, pairs, protocol)
    print(report.read_text(), flush=True)
    print(f"report: {report}")
    if not args.no_pictures:
        try:
            for path in draw_extremes(results, pairs, protocol, up="z" if args.demo else None):
                print(f"picture: {path}")
        except MissingDependencyError as error:
            print(f"best, median and worst pairs are not drawn: {error}", file=sys.stderr)
    return any(result.ok for result in results)


def _problem(args: argparse.Namespace) -> tuple[dict[str, Subject], Protocol]:
    """Subjects, and the pairs of them."""
    if args.demo:
        subjects = demo_subjects()
        return subjects, make_protocol("all-pairs", subjects.values(), count=args.pairs)
    folder = args.data or data_folder("faust_r")
    if folder is None:
        raise InvalidInputError("name a folder with --data, set SPECTRA_KIT_DATA, or try --demo")
    subjects = subjects_in(folder)
    if args.only:
        subjects = {n: s for n, s in subjects.items() if n.startswith(tuple(args.only))}
    protocol = make_protocol(
        args.protocol,
        subjects.values(),
        count=args.pairs,
        seed=args.seed,
        listed=args.pair_list or folder / "ren_pairs.txt",
    )
    used = {name for pair in protocol.pairs for name in pair}
    return {name: subject for name, subject in subjects.items() if name in used}, protocol


if __name__ == "__main__":
    sys.exit(main())
