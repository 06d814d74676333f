"""Try `spectra-kit batch` on real shapes: speed by workers, deaths, damage, a cluster, memory.

    python apps/benchmark_batch.py OUT                   # all trials; needs SPECTRA_KIT_DATA
    python apps/benchmark_batch.py OUT --trials speed killed
    python apps/benchmark_batch.py OUT --trials memory --shapes 100

Every trial calls the command as a user does, and compares stores byte by byte, most of them with
the one that `speed` leaves: it has to be the first. The pool's shapes of 300 vertices and more are
written to OUT/pool; for `memory`, sizes of 3,000 to 135,000 vertices in even steps of their
logarithm, made of ood_public by subdivision and decimation, to OUT/sizes. OUT gets report.json;
trials that are in it already are not repeated. Nothing else should run meanwhile.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from measure.batch.shapes import write_pool, write_sizes
from measure.batch.trials import TRIALS, Setting
from measure.command import exit_code, parser_of
from measure.machine import describe_machine
from measure.shapes import data_folder

from spectra_kit._core.files import atomic_path

_SHAPES = {"memory": 500, "broken": 300}  # others have --shapes, too


def _parser() -> argparse.ArgumentParser:
    parser = parser_of("benchmark_batch.py", __doc__)
    add = parser.add_argument
    add("out", type=Path, help="folder for everything")
    add("--trials", nargs="+", choices=[*TRIALS], default=[*TRIALS], metavar="TRIAL",
        help=f"of {', '.join(TRIALS)} (all)")  # fmt: skip
    add("--shapes", type=int, help="how many (2000; of memory 500, of broken 300)")
    add("--workers", type=int, default=2, help="(%(default)s)")
    add(
        "--memory-limit", default="3GB", help="of each worker, in the trial of memory (%(default)s)"
    )
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Try, print what was found; return the exit code."""
    args = _parser().parse_args(argv)
    return exit_code(lambda: _try(args))


def _try(args: argparse.Namespace) -> None:
    report = args.out / "report.json"
    known = json.loads(report.read_text()) if report.exists() else {}
    for name in args.trials:
        count = args.shapes or _SHAPES.get(name, 2000)
        asked = {"shapes": count, "workers": args.workers, "memory_limit": args.memory_limit}
        if known.get(name, {}).get("asked") != asked:
            if name == "memory":
                shapes = write_sizes(data_folder("ood_public"), args.out / f"sizes-{count}", count)
            else:
                shapes = write_pool(data_folder("train_pool"), args.out / f"pool-{count}", count)
            setting = Setting(args.out / "work", shapes, args.workers, args.memory_limit)
            known[name] = {"asked": asked, "machine": describe_machine(), **TRIALS[name](setting)}
            with atomic_path(report) as part:
                part.write_text(json.dumps(known, indent=1) + "\n")
        print(f"{name}:", flush=True)
        for key, value in known[name].items():
            if key != "machine":
                print(f"  {key}: {value}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
