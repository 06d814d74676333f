r"""Match all shapes of a set as one collection, and measure maps between pairs of them.

    python apps/match_collection.py OUT                          # the 32 animals of smal_r
    python apps/match_collection.py OUT --data tosca_r --only cat

OUT/matched holds what pairs by themselves found, so that the same command after an interruption, by
the same code, goes on from there. Errors are those of all landmarks, along edges of the source, in
hundredths of the root of its area; right is a mean below 8.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from measure import tables
from measure.command import exit_code, parser_of
from measure.matching.sets import PairSet, pair_sets
from measure.matching.subjects import truth_between
from measure.store import code_digest
from tqdm import tqdm

from spectra_kit import prepare, spectrum
from spectra_kit._core.types import Floats
from spectra_kit.errors import DoubtfulMatchWarning
from spectra_kit.maps import Collection, geodesic_errors, match_collection

_MODES = 150
_RIGHT = 8.0


def main(argv: Sequence[str] | None = None) -> int:
    """Match and print the report; return the exit code."""
    parser = parser_of("match_collection.py", __doc__)
    parser.add_argument("out", type=Path, help="folder for the report")
    parser.add_argument("--data", default="smal_r", metavar="SET",
        help="folder, or name of a set in $SPECTRA_KIT_DATA (%(default)s)")  # fmt: skip
    parser.add_argument("--only", nargs="+", default=(), metavar="PREFIX",
        help="subjects whose names begin so, such as those of one class")  # fmt: skip
    parser.add_argument("--pairs", type=int, default=100, metavar="N",
        help="that are measured (%(default)s)")  # fmt: skip
    parser.add_argument("--seed", type=int, default=0, help="of their draw (%(default)s)")
    args = parser.parse_args(argv)
    return exit_code(lambda: _match(args))


def _match(args: argparse.Namespace) -> None:
    read = partial(pair_sets, [args.data], protocol="all-pairs", only=args.only)
    (whole,), (drawn,) = read(), read(count=args.pairs, seed=args.seed)
    args.out.mkdir(parents=True, exist_ok=True)
    shapes = {
        name: prepare(spectrum(one.geometry, _MODES), one.geometry)
        for name, one in tqdm(whole.subjects.items(), "solving", disable=None)
    }
    start = time.process_time()
    with tqdm(total=len(shapes), desc="joining", disable=None) as joining:
        found = match_collection(
            shapes,
            folder=args.out / "matched" / code_digest(),
            progress=lambda done, _: joining.update(done - joining.n),
        )
    seconds = time.process_time() - start
    bar = tqdm(drawn.protocol.pairs, "measuring", disable=None)
    errors = np.array([_error(drawn, found, *pair) for pair in bar])
    report = args.out / "collection.md"
    report.write_text(_report(drawn.name, found, errors, seconds))
    print(report.read_text())
    print(f"report: {report}")


def _error(pairs: PairSet, found: Collection, source: str, target: str) -> float:
    """Return the mean error of a map that the collection implies."""
    one, other = pairs.subjects[source], pairs.subjects[target]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DoubtfulMatchWarning)
        point_map = found.pair(source, target).point_map
    return float(geodesic_errors(one.mesh, point_map, truth_between(one, other)).mean())


def _report(name: str, found: Collection, errors: Floats, seconds: float) -> str:
    """Return the report: errors, who belongs together, and how far pairs disagree."""
    row = [
        str(len(errors)),
        *(f"{value:.2f}" for value in (errors.mean(), np.median(errors), errors.max())),
        f"{np.mean(errors > _RIGHT):.0%}",
    ]
    cycles = sorted(found.cycle_errors.items(), key=lambda item: -item[1])[:5]
    return "\n\n".join(
        [
            f"# {name}: {len(found.shapes)} shapes as one collection",
            tables.table(["pairs", "mean", "median", "worst", f"above {_RIGHT:g}"], [row]),
            f"{len(found.pairs)} pairs were matched by themselves, {seconds:.0f} CPU seconds in"
            " this run; groups of "
            + ", ".join(str(len(group)) for group in found.groups)
            + f"; fits no other: {', '.join(found.foreign) or 'none'}.",
            "Largest cycle errors: " + ", ".join(f"{n} {value:.2f}" for n, value in cycles) + ".\n",
        ]
    )


if __name__ == "__main__":
    sys.exit(main())
