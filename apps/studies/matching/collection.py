r"""Match all shapes of a set as one collection, and measure maps between pairs of them.

    python apps/studies/run.py collection OUT                          # the 32 animals of smal_r
    python apps/studies/run.py collection OUT --data tosca_r --only cat

OUT/matched holds what pairs by themselves found, so that the same command after an interruption, by
the same code, goes on from there. Errors are those of all landmarks, along edges of the source, in
hundredths of the root of its area; right is a mean below 8.
"""

from __future__ import annotations

import argparse
import time
import warnings
from functools import partial

import numpy as np
from tqdm import tqdm

from spectra_kit import prepare, spectrum
from spectra_kit.errors import DoubtfulMatchWarning
from spectra_kit.maps import Collection, geodesic_errors, match_collection
from studies.machine import describe_machine
from studies.matching.sets import PairSet, pair_sets
from studies.matching.subjects import truth_between
from studies.report import Table, write_report
from studies.store import code_digest

_MODES = 150
_RIGHT = 8.0
_COLUMNS = {
    **{"set": "", "shapes": "d", "groups": "", "fits no other": "", "matched by themselves": "d"},
    **{"CPU s of this run": ".0f", "pairs": "d", "mean": ".2f", "median": ".2f", "worst": ".2f"},
    "above 8": ".0%",
}


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--data", default="smal_r", metavar="SET",
        help="folder, or name of a set in $SPECTRA_KIT_DATA (%(default)s)")  # fmt: skip
    parser.add_argument("--only", nargs="+", default=(), metavar="PREFIX",
        help="subjects whose names begin so, such as those of one class")  # fmt: skip
    parser.add_argument("--pairs", type=int, default=100, metavar="N",
        help="that are measured (%(default)s)")  # fmt: skip
    parser.add_argument("--seed", type=int, default=0, help="of their draw (%(default)s)")


def measure(args: argparse.Namespace) -> None:
    """Match and report."""
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
    cycles = sorted(found.cycle_errors.items(), key=lambda item: -item[1])[:5]
    row = {
        **{"set": drawn.name, "shapes": len(found.shapes), "groups": [*map(len, found.groups)]},
        **{"fits no other": ", ".join(found.foreign), "matched by themselves": len(found.pairs)},
        **{"CPU s of this run": seconds, "pairs": len(errors), "mean": errors.mean()},
        **{"median": np.median(errors), "worst": errors.max(), "above 8": (errors > _RIGHT).mean()},
    }
    write_report(
        args.out,
        "collection",
        [],
        [
            Table("Maps between pairs", [row], _COLUMNS),
            Table(
                "Largest cycle errors",
                [{"shape": name, "error": error} for name, error in cycles],
                {"shape": "", "error": ".2f"},
            ),
        ],
        describe_machine(),
        errors={"--".join(p): e for p, e in zip(drawn.protocol.pairs, errors, strict=True)},
    )


def _error(pairs: PairSet, found: Collection, source: str, target: str) -> float:
    """Return the mean error of a map that the collection implies."""
    one, other = pairs.subjects[source], pairs.subjects[target]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DoubtfulMatchWarning)
        point_map = found.pair(source, target).point_map
    return float(geodesic_errors(one.mesh, point_map, truth_between(one, other)).mean())
