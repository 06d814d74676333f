r"""Learn to tell shapes apart from a few examples of each class, by many embeddings, and compare.

    python apps/classify_shapes.py OUT                       # the training-free rows, SHREC'11
    python apps/classify_shapes.py OUT --trained             # networks, too
    python apps/classify_shapes.py OUT --rows "waves+dna, nearest; cloud, predicted"
    python apps/classify_shapes.py OUT --validate            # to choose by: on the training split
    python apps/classify_shapes.py OUT --set demo            # animals, rings and eggs, no data

The official split holds 16 shapes of each of 30 classes to learn from and 4 to test on. From every
seed come the points of the clouds, so many draws of examples, and the rotations; of networks, one
draw. OUT gets measurements.jsonl, classification.md, classification.json, confusion.png and
map.png. The same command after an interruption computes only what is missing.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from measure.command import exit_code, parser_of
from measure.learning.classification import Draws, Vectors, classify_all, most_shots
from measure.learning.classified_report import draw_pictures, write_report
from measure.learning.labelled import CLASSIFIED, labelled_set
from measure.learning.rows import FREE, TRAINED, rows_named
from measure.shapes import data_folder

from spectra_kit.errors import MissingDependencyError


def _parser() -> argparse.ArgumentParser:
    parser = parser_of("classify_shapes.py", __doc__)
    add = parser.add_argument
    add("out", type=Path, help="folder for everything")
    add("--set", choices=[*CLASSIFIED, "demo"], default="shrec11", help="(%(default)s)")
    add("--data", type=Path, help="folder of the sets (default: $SPECTRA_KIT_DATA/tasks)")
    add("--rows", nargs="+", metavar="ROW", help="only these, as the table names them")
    add("--trained", action="store_true", help="rows of networks, too: half an hour each and more")
    add("--shots", nargs="+", type=int,
        help="examples a class (1 3 5 10, as far as the set goes)")  # fmt: skip
    add("--seeds", type=int, default=10, help="(%(default)s)")
    add("--draws", type=int, default=10, help="for each seed (%(default)s)")
    add("--validate", action="store_true",
        help="test on what the draw leaves of the training split")  # fmt: skip
    add("--jobs", type=int, default=os.cpu_count() or 1, help="side by side (%(default)s)")
    add("--no-pictures", action="store_true", help="draw nothing")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, print the table; return the exit code: 1 if nothing could be measured."""
    args = _parser().parse_args(argv)
    return exit_code(lambda: _classify(args))


def _classify(args: argparse.Namespace) -> bool:
    shapes = labelled_set(args.set, args.data or data_folder("tasks"), CLASSIFIED)
    table = rows_named(args.rows) if args.rows else FREE + TRAINED * args.trained
    most = most_shots(shapes) - args.validate
    numbers = args.shots or [q for q in (1, 3, 5, 10) if q <= most]
    vectors = Vectors(
        folder=args.out, contenders=[], problems=[], shapes=shapes, validated=args.validate
    )
    draws = Draws(
        folder=args.out,
        contenders=[row._replace(shots=shots) for row in table for shots in numbers],
        problems=list(range(args.seeds)),
        shapes=shapes,
        vectors=vectors,
        draws=args.draws,
    )
    results = classify_all(draws, jobs=args.jobs, progress=True)
    report = write_report(results, draws)
    print(report.read_text(), flush=True)
    print(f"report: {report}")
    if not args.no_pictures:
        try:
            for path in draw_pictures(results, draws):
                print(f"picture: {path}")
        except MissingDependencyError as error:
            print(f"no pictures: {error}", file=sys.stderr)
    return any(result.ok for result in results)


if __name__ == "__main__":
    sys.exit(main())
