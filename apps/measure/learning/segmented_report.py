"""Segmentation as Markdown and JSON, with curves over the epochs and coloured shapes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from measure import figures, tables
from measure.learning.labelled import LabelledSet
from measure.learning.segmentation import COPIES, EMBEDDINGS, NETWORKS, POINTS, K, Parts, PartsRow
from measure.study import Result
from spectra_kit._core.types import Floats
from spectra_kit._core.version import VERSION
from spectra_kit.show import Page, Thumbnail, plot_thumbnails

Results = Sequence[Result[PartsRow, int]]

GOAL = 0.8  #: Intersection over union: the epoch that reaches it is told.
_MARKS = ("iou", "area", "faces", "vertices", "edges")


def summarize(results: Results) -> dict[PartsRow, dict[str, Any]]:
    """Return, by row, means and worst of all seeds."""
    groups: dict[PartsRow, list[dict[str, Any]]] = {}
    for result in results:
        if result.ok:
            groups.setdefault(result.contender, []).append(result.record)
    return {
        row: {
            **{mark: float(np.mean([r[mark] for r in records])) for mark in _MARKS},
            "worst": min(r["iou"] for r in records),
            "deviation": float(np.std([r["iou"] for r in records])),
            "turned": float(np.mean([r["turned"]["iou"] for r in records])),
            "seen": max(r["seen"] for r in records),
            "new": {
                mark: float(np.mean([r["unseen"][mark] for r in records if r["unseen"]] or np.nan))
                for mark in _MARKS
            },
            "epochs": int(records[0]["curve"][-1][0]),
            "reached": _reached(np.median([r["curve"] for r in records], axis=0)),
            "curves": [r["curve"] for r in records],
            "weights": records[0]["weights"],
            "examples": records[0]["examples"],
            "seeds": len(records),
        }
        for row, records in groups.items()
    }


def _reached(curve: Floats) -> int | None:
    return next((int(epoch) for epoch, value in curve if value >= GOAL), None)


def write_report(results: Results, parts: Parts) -> Path:
    """Write ``segmentation.md``, its JSON and curves; return the first."""
    folder, found = parts.folder, summarize(results)
    held = [
        {"set": name, "seed": seed, "source": source}
        for name in sorted({row.set for row in parts.contenders} if parts.validated else ())
        for seed in parts.problems
        if (source := parts.sets[name].held_source(seed))
    ]
    tables.write_json(
        folder / "segmentation.json",
        {
            "version": VERSION,
            "validated": parts.validated,
            "held out": held,
            "rows": [
                {**row._asdict(), "view": str(row.view), **cells} for row, cells in found.items()
            ],
            "failures": [
                {"row": str(r.contender), "seed": r.problem, "reason": r.reason}
                for r in results
                if not r.ok
            ],
        },
    )
    header = ["row", "IoU", "worst", "turned", "area", "faces", "vertices", "edges", "seen",
              "new: IoU", "edges", "to 0.80", "epochs", "weights", "seeds"]  # fmt: skip
    body = [
        [
            str(row),
            f"{cells['iou']:.3f} ± {cells['deviation']:.3f}",
            f"{cells['worst']:.3f}",
            f"{cells['turned']:.3f}",
            *(f"{100 * cells[mark]:.1f}" for mark in _MARKS[1:]),
            str(cells["seen"]),
            f"{cells['new']['iou']:.3f}",
            f"{100 * cells['new']['edges']:.1f}",
            tables.number(cells["reached"], "d"),
            str(cells["epochs"]),
            f"{cells['weights']:,}",
            str(cells["seeds"]),
        ]
        for row, cells in found.items()
    ]
    tested = "a held-out part of the training split" if parts.validated else "the test split"
    tables.write_markdown(
        folder / "segmentation.md",
        [
            "# Parts of shapes",
            f"On {tested}: mean intersection over union of the classes by area, mean ± deviation"
            " and worst over seeds, and where the tested shapes are turned at random; per cent of"
            " the area, of faces and of vertices told right, and of edges by area whose class is"
            " that of a face beside them, as MeshCNN counts; how many of the tested shapes are"
            " learned from as well, since some sets hold shapes twice, and the marks of the others;"
            " the epoch whose median IoU first"
            f" reaches {GOAL:g}; the last epoch counts, none is picked. Clouds are {POINTS:,}"
            f" random points, whose labels the vertices get; spectra have {K} modes. A few shapes"
            f" are shown beside {COPIES} stretched copies of each, so an epoch is as many times"
            " longer.",
            tables.table(header, body),
            tables.listed(
                f"held out of {one['set']} by seed {one['seed']}: all of `{one['source']}`"
                for one in held
            ),
            tables.listed(f"`{n}`: `{what!r}`" for n, what in {**EMBEDDINGS, **NETWORKS}.items()),
            tables.listed(
                f"failed: {r.contender}, seed {r.problem}: {r.reason}" for r in results if not r.ok
            ),
        ],
    )
    if found:
        _draw_curves(found, folder / "epochs.png")
    return folder / "segmentation.md"


def _draw_curves(found: dict[PartsRow, dict[str, Any]], path: Path) -> Path:
    whole = {row: cells for row, cells in found.items() if not row.shots}
    few = {row: cells for row, cells in found.items() if row.shots}
    groups = [group for group in (whole, few) if group]
    figure, axes = figures.panels("Parts told right after each epoch", len(groups), width=13)
    for panel, group in zip(axes, groups, strict=True):
        for i, (row, cells) in enumerate(group.items()):
            curves = np.array(cells["curves"])
            figures.band(panel, curves[0, :, 0], curves[:, :, 1], str(row), **figures.line(i))
        panel.axhline(GOAL, color="0.6", lw=0.8)
        panel.set_xscale("log")
        panel.set_ylim(0.4, 1)
        panel.set_xlabel("epoch")
        panel.set_ylabel("mean IoU")
        panel.legend(fontsize=6, frameon=False, loc="lower right")
    return figures.save(figure, path)


def draw_extremes(results: Results, parts: Parts) -> list[Path]:
    """Draw the median and the worst shape of each set's first row beside their truth."""
    made, done = list[Path](), set[str]()
    for result in results:
        row = result.contender
        if not result.ok or row.set in done:
            continue
        done.add(row.set)
        made.append(_draw_shapes(result, parts.sets[row.set], parts.folder))
    return made


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
