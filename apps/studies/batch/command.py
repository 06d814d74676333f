"""Try `spectra-kit batch` on real shapes: speed by workers, deaths, damage, a cluster, memory.

    python apps/studies/run.py batch OUT                   # all trials; needs SPECTRA_KIT_DATA
    python apps/studies/run.py batch OUT --trials speed killed
    python apps/studies/run.py batch OUT --trials memory --shapes 100

Every trial calls the command as a user does, and compares stores byte by byte, most of them with
the one that `speed` leaves: it has to be the first. The pool's shapes of 300 vertices and more are
written to OUT/pool; for `memory`, sizes of 3,000 to 135,000 vertices in even steps of their
logarithm, made of ood_public by subdivision and decimation, to OUT/sizes. Trials
that are in OUT/batch.json already are not repeated. Nothing else should run meanwhile.
"""

from __future__ import annotations

import argparse
import json
from typing import Any

from studies.batch.shapes import write_pool, write_sizes
from studies.batch.trials import TRIALS, Setting
from studies.machine import describe_machine
from studies.report import Table, write_report
from studies.shapes import given_folder

_SHAPES = {"memory": 500, "broken": 300}  # others have --shapes, too


def options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--trials", nargs="+", choices=[*TRIALS], default=[*TRIALS], metavar="TRIAL",
        help=f"of {', '.join(TRIALS)} (all)")  # fmt: skip
    add("--shapes", type=int, help="how many (2000; of memory 500, of broken 300)")
    add("--workers", type=int, default=2, help="(%(default)s)")
    add(
        "--memory-limit", default="3GB", help="of each worker, in the trial of memory (%(default)s)"
    )


def measure(args: argparse.Namespace) -> None:
    """Try and report."""
    report = args.out / "batch.json"
    known: dict[str, Any] = json.loads(report.read_text())["trials"] if report.exists() else {}
    for name in args.trials:
        count = args.shapes or _SHAPES.get(name, 2000)
        asked = {"shapes": count, "workers": args.workers, "memory_limit": args.memory_limit}
        if known.get(name, {}).get("asked") == asked:
            continue
        if name == "memory":
            folder = given_folder(None, "ood_public")
            shapes = write_sizes(folder, args.out / f"sizes-{count}", count)
        else:
            folder = given_folder(None, "train_pool")
            shapes = write_pool(folder, args.out / f"pool-{count}", count)
        setting = Setting(args.out / "work", shapes, args.workers, args.memory_limit)
        known[name] = {"asked": asked, "machine": describe_machine(), **TRIALS[name](setting)}
        rows = [
            {"trial": trial, "what": key, "value": str(value)}
            for trial, found in known.items()
            for key, value in found.items()
            if key != "machine"
        ]
        table = Table("Trials", rows, dict.fromkeys(("trial", "what", "value"), ""))
        write_report(args.out, "batch", [], [table], describe_machine(), trials=known)
