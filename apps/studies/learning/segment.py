r"""Learn to tell the parts of shapes, by many embeddings and networks, and compare.

    python apps/studies/run.py segmentation OUT                 # human bodies, all rows
    python apps/studies/run.py segmentation OUT --set human aliens chairs vases
    python apps/studies/run.py segmentation OUT --rows "human: encoding, mlp; mesh, exact; all"
    python apps/studies/run.py segmentation OUT --validate      # to choose by: sees no test shape
    python apps/studies/run.py segmentation OUT --set demo --epochs 3  # no data

The official splits; with --validate a held-out part of the training split. From the seed come
weights, order, rotations, the choice of a few shapes and the points of clouds. A few shapes are
shown beside 15 stretched copies of each, so an epoch is as many times longer; the last epoch
counts, none is picked. Clouds are 2,048 random points, whose labels the vertices get; spectra have
96 modes.

IoU is the mean intersection over union of the classes by area; also of the worst seed, and where
the tested shapes are turned at random. *Area*, *faces*, *vertices*: shares of these told right;
*edges*: by area, of those whose class is that of a face beside them, as MeshCNN counts. *Seen*: how
many of the tested shapes are learned from as well, since some sets hold shapes twice; *new*: the
marks of the others. *To 0.80*: the epoch whose median IoU first reaches that. OUT also gets
coloured shapes beside their truth, and in files/ each network, for `load_labeller`. The same
command after an interruption goes on from the last epoch.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from spectra_kit._core.threads import usable_cores
from spectra_kit._core.types import Floats
from spectra_kit.show import Page, Thumbnail, plot_thumbnails
from studies.learning.classification import rows_named
from studies.learning.labelled import SEGMENTED, LabelledSet, labelled_set
from studies.learning.segmentation import (
    EMBEDDINGS,
    NETWORKS,
    Parts,
    PartsRow,
    parts_rows,
)
from studies.machine import describe_machine
from studies.report import Table, unless_missing, write_report
from studies.store import Record, Store
from studies.study import Result, measured_by, run

Results = Sequence[Result[PartsRow, int]]

GOAL = 0.8  #: Intersection over union: the epoch that reaches it is told.
_MARKS = ("iou", "area", "faces", "vertices", "edges")
_COLUMNS = {
    **{"row": "", "iou": ".3f", "deviation": ".3f", "worst": ".3f", "turned": ".3f"},
    **dict.fromkeys(_MARKS[1:], ".1%"),
    **{"seen": "d", "new: iou": ".3f", "new: edges": ".1%", "to 0.80": "d"},
    **{"epochs": "d", "weights": ",d", "seeds": "d"},
}


def options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
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


def measure(args: argparse.Namespace) -> bool:
    """Measure and report; return whether there is a result."""
    table = [row for name in args.set for row in parts_rows(name)]
    parts = Parts(
        folder=args.out,
        contenders=rows_named(args.rows, table) if args.rows else table,
        problems=list(range(args.seeds)),
        sets={name: labelled_set(name, args.data, SEGMENTED) for name in args.set},
        epochs=args.epochs,
        validated=args.validate,
    )
    results = run(parts, Store(args.out), jobs=args.jobs, retry=True, progress=True)
    drawn = list[Path]()
    if not args.no_pictures:
        with unless_missing("shapes are"):
            drawn += draw_extremes(results, parts)
    write_report(
        args.out,
        "segmentation",
        results,
        [
            Table("Parts told right", summarize(results), _COLUMNS),
            Table("Held out", held_out(parts), {"set": "", "seed": "d", "source": ""}),
        ],
        describe_machine(),
        figures=drawn,
        validated=args.validate,
        names={name: repr(what) for name, what in {**EMBEDDINGS, **NETWORKS}.items()},
    )
    return any(result.ok for result in results)


def held_out(parts: Parts) -> list[Record]:
    """Tell which source of each set, all of it, each seed holds out to choose by."""
    return [
        {"set": name, "seed": seed, "source": source}
        for name in sorted({row.set for row in parts.contenders} if parts.validated else ())
        for seed in parts.problems
        if (source := parts.sets[name].held_source(seed))
    ]


def summarize(results: Results) -> list[Record]:
    """Return means and worst of all seeds of each row."""
    groups = {row: [result.record for result in some] for row, some in measured_by(results).items()}
    return [
        {
            "row": str(row),
            **{mark: float(np.mean([r[mark] for r in records])) for mark in _MARKS},
            "worst": min(r["iou"] for r in records),
            "deviation": float(np.std([r["iou"] for r in records])),
            "turned": float(np.mean([r["turned"]["iou"] for r in records])),
            "seen": max(r["seen"] for r in records),
            **{
                f"new: {mark}": float(np.mean([r["unseen"][mark] for r in records if r["unseen"]]))
                for mark in _MARKS
                if any(r["unseen"] for r in records)
            },
            "to 0.80": _reached(np.median([r["curve"] for r in records], axis=0)),
            "epochs": int(records[0]["curve"][-1][0]),
            "weights": records[0]["weights"],
            "seeds": len(records),
        }
        for row, records in groups.items()
    ]


def _reached(curve: Floats) -> int | None:
    return next((int(epoch) for epoch, value in curve if value >= GOAL), None)


def draw_extremes(results: Results, parts: Parts) -> list[Path]:
    """Draw the median and the worst shape of each set's first row beside their truth."""
    first: dict[str, Result[PartsRow, int]] = {}
    for result in results:
        if result.ok:
            first.setdefault(result.contender.set, result)
    return [_draw_shapes(one, parts.sets[name], parts.folder) for name, one in first.items()]


def _draw_shapes(result: Result[PartsRow, int], shapes: LabelledSet, folder: Path) -> Path:
    file = next(name for name in result.record["files"] if name.endswith(".npz"))
    with np.load(folder / file) as labels:
        told = {int(number): labels[number] for number in labels}
    right = {i: float((found == shapes.vertex_labels[i]).mean()) for i, found in told.items()}
    order = sorted(right, key=lambda i: right[i])
    chosen = [order[len(order) // 2], order[0]]
    path = folder / f"parts_{result.contender.set}.png"
    thumbnails = [
        Thumbnail(geometry=shapes.meshes[i], labels=labels, lines=(f"shape {i}", line))
        for i in chosen
        for labels, line in (
            (shapes.vertex_labels[i], "truth"),
            (told[i], f"{100 * right[i]:.1f} % of the vertices right"),
        )
    ]
    plot_thumbnails(thumbnails, path=path, page=Page(str(result.contender)))
    return path
