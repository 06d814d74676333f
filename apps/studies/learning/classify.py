r"""Learn to tell shapes apart from a few examples of each class, by many embeddings, and compare.

    python apps/studies/run.py classification OUT             # the training-free rows, SHREC'11
    python apps/studies/run.py classification OUT --trained   # networks, too
    python apps/studies/run.py classification OUT --rows "waves+dna, nearest; cloud, predicted"
    python apps/studies/run.py classification OUT --validate  # to choose by: on the training split
    python apps/studies/run.py classification OUT --set demo  # animals, rings and eggs, no data

The official split holds 16 shapes of each of 30 classes to learn from and 4 to test on. From every
seed come the points of the clouds, so many draws of examples, and the rotations; of networks, one
draw. Per cent of the test split told right, over draws of so many examples a class; with --validate
of what each draw leaves of the training split. Clouds are 2,048 random points, spectra have 96
modes. *Turned*: the same shapes turned at random. Networks see shapes and stretched copies of them,
30,000 in all: as many as about an hour of a core allows to the slowest.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from studies.learning.classification import (
    FREE,
    HEADS,
    NETWORKS,
    OF_POINTS,
    TRAINED,
    WHOLE,
    Draws,
    Row,
    Vectors,
    classify_all,
    most_shots,
    rows_named,
    training_of,
)
from studies.learning.labelled import CLASSIFIED, labelled_set
from studies.machine import describe_machine
from studies.report import Table, write_report
from studies.store import Record
from studies.study import Result, measured_by

Results = Sequence[Result[Row, int]]


def options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
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


def measure(args: argparse.Namespace) -> bool:
    """Measure and report; return whether there is a result."""
    shapes = labelled_set(args.set, args.data, CLASSIFIED)
    table = rows_named(args.rows, FREE + TRAINED) if args.rows else FREE + TRAINED * args.trained
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
    columns = {"row": "", "examples": "d", "mean": ".1f", "deviation": ".1f", "worst": ".1f"}
    columns |= {"turned": ".1f", "draws": "d", "epochs": "d"}
    write_report(
        args.out,
        "classification",
        results,
        [Table("Per cent told right", summarize(results), columns)],
        describe_machine(),
        set=shapes.name,
        validated=args.validate,
        names={name: repr(what) for name, what in {**WHOLE, **HEADS, **NETWORKS}.items()},
        of_points={name: repr(what) for name, what in OF_POINTS.items()},
    )
    return any(result.ok for result in results)


def summarize(results: Results) -> list[Record]:
    """Return, by row and number of examples, what all draws of all seeds gave, in per cent."""
    rows = []
    for row, measured in measured_by(results).items():
        records = [result.record for result in measured]
        right, turned = (
            100 * np.concatenate([record[name] for record in records])
            for name in ("right", "turned")
        )
        examples = row.shots * len(records[0]["confused"])
        rows.append(
            {
                **{"row": str(row._replace(shots=0)), "examples": row.shots, "draws": len(right)},
                **{"mean": float(right.mean()), "deviation": float(right.std())},
                "worst": float(right.min()),
                "turned": float(turned.mean()) if len(turned) else None,
                "epochs": training_of(row, examples, 0).epochs if row.trained else None,
            }
        )
    return rows
