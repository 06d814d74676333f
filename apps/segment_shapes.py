r"""Learn to tell the parts of shapes, by many embeddings and networks, and compare.

    python apps/segment_shapes.py OUT                        # human bodies, all rows
    python apps/segment_shapes.py OUT --set human aliens chairs vases
    python apps/segment_shapes.py OUT --rows "human: coordinates, diffusion; mesh, exact; all"
    python apps/segment_shapes.py OUT --validate             # to choose by: no test shape is seen
    python apps/segment_shapes.py OUT --set demo --epochs 3  # animals, rings and eggs, no data

The official splits. From the seed come weights, order, rotations, the choice of a few shapes and
the points of clouds. OUT gets measurements.jsonl, segmentation.md, segmentation.json, epochs.png,
coloured shapes beside their truth, and in files/ each network, for `load_labeller`. The same
command after an interruption goes on from the last epoch.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from measure.command import exit_code, parser_of
from measure.learning.labelled import SEGMENTED, labelled_set
from measure.learning.rows import parts_rows
from measure.learning.segmentation import Parts, segment_all
from measure.learning.segmented_report import draw_extremes, write_report
from measure.shapes import data_folder

from spectra_kit._core.threads import usable_cores
from spectra_kit.errors import InvalidInputError, MissingDependencyError


def _parser() -> argparse.ArgumentParser:
    parser = parser_of("segment_shapes.py", __doc__)
    add = parser.add_argument
    add("out", type=Path, help="folder for everything")
    add("--set", nargs="+", choices=[*SEGMENTED, "demo"], default=["human"], metavar="NAME",
        help=f"{', '.join(SEGMENTED)} or demo (human)")  # fmt: skip
    add("--data", type=Path, help="folder of the sets (default: $SPECTRA_KIT_DATA/tasks)")
    add("--rows", nargs="+", metavar="ROW", help="only these, as the table names them")
    add("--epochs", type=int, default=40, help="(%(default)s)")
    add("--seeds", type=int, default=1, help="(%(default)s)")
    add("--validate", action="store_true",
        help="test on a source of the training split (or a tenth), held out")  # fmt: skip
    add("--jobs", type=int, default=usable_cores(), help="side by side (%(default)s)")
    add("--no-pictures", action="store_true", help="do not draw shapes")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, print the table; return the exit code: 1 if nothing could be measured."""
    args = _parser().parse_args(argv)
    return exit_code(lambda: _segment(args))


def _segment(args: argparse.Namespace) -> bool:
    table = {str(row): row for name in args.set for row in parts_rows(name)}
    for name in args.rows or ():
        if name not in table:
            raise InvalidInputError("rows", f"be of these: {' | '.join(table)}", repr(name))
    folder = args.data or data_folder("tasks")
    parts = Parts(
        folder=args.out,
        contenders=[table[name] for name in args.rows or table],
        problems=list(range(args.seeds)),
        sets={name: labelled_set(name, folder, SEGMENTED) for name in args.set},
        epochs=args.epochs,
        validated=args.validate,
    )
    results = segment_all(parts, jobs=args.jobs, progress=True)
    report = write_report(results, parts)
    print(report.read_text(), flush=True)
    print(f"report: {report}")
    if not args.no_pictures:
        try:
            for path in draw_extremes(results, parts):
                print(f"picture: {path}")
        except MissingDependencyError as error:
            print(f"shapes are not drawn: {error}", file=sys.stderr)
    return any(result.ok for result in results)


if __name__ == "__main__":
    sys.exit(main())
