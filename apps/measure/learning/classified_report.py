"""Classification as Markdown and JSON; who is taken for whom, and a map of all shapes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from measure import figures, tables
from measure.learning.classification import (
    HEADS,
    NETWORKS,
    OF_POINTS,
    POINTS,
    SHOWN,
    WHOLE,
    Draws,
    K,
    Row,
    training_of,
)
from measure.study import Result
from spectra_kit._core.optional import optional
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.version import VERSION

Results = Sequence[Result[Row, int]]


def summarize(results: Results) -> dict[tuple[str, str, str], dict[int, dict[str, Any]]]:
    """Return, by table row and number of examples, what all draws of all seeds gave."""
    found: dict[tuple[str, str, str], dict[int, dict[str, Any]]] = {}
    for result in results:
        if not result.ok:
            continue
        row = result.contender
        examples = row.shots * len(result.record["confused"])
        cell = found.setdefault((row.embedding, row.method, str(row.view)), {}).setdefault(
            row.shots,
            {
                "right": [],
                "turned": [],
                "seeds": 0,
                "epochs": training_of(row, examples, 0).epochs if row.trained else None,
            },
        )
        cell["right"] += result.record["right"]
        cell["turned"] += result.record["turned"]
        cell["seeds"] += 1
    for cells in found.values():
        for cell in cells.values():
            right, turned = (100 * np.array(cell.pop(name)) for name in ("right", "turned"))
            cell |= {
                "draws": len(right),
                "mean": float(right.mean()),
                "deviation": float(right.std()),
                "worst": float(right.min()),
                "turned": float(turned.mean()) if len(turned) else None,
            }
    return found


def write_report(results: Results, draws: Draws) -> Path:
    """Write ``classification.md`` and its JSON; return the first."""
    folder, found = draws.folder, summarize(results)
    shots = sorted({row.shots for row in draws.contenders})
    failures = [
        {"row": str(r.contender), "seed": r.problem, "reason": r.reason}
        for r in results
        if not r.ok
    ]
    tables.write_json(
        folder / "classification.json",
        {
            "version": VERSION,
            "set": draws.shapes.name,
            "validated": draws.validated,
            "rows": [
                {"embedding": e, "method": m, "view": v, "shots": cells}
                for (e, m, v), cells in found.items()
            ],
            "failures": failures,
        },
    )
    header = ["row", *(f"{q} a class" for q in shots), "turned", "draws"]
    body = [
        [
            f"{embedding}, {method}; {view}",
            *(_cell(cells.get(q)) for q in shots),
            _turning(list(cells.values())),
            str(max(cell["draws"] for cell in cells.values())),
        ]
        for (embedding, method, view), cells in found.items()
    ]
    tested = "what each draw leaves of the training split" if draws.validated else "the test split"
    tables.write_markdown(
        folder / "classification.md",
        [
            f"# {draws.shapes.name}: {len(draws.shapes.meshes)} shapes,"
            f" {len(draws.shapes.classes)} classes",
            f"Per cent of {tested} told right, mean ± deviation (worst) over draws of so many"
            f" examples a class; clouds are {POINTS:,} random points, spectra have {K} modes."
            " *turned*: what random rotations of the tested shapes change, in points, on average"
            " over the columns.",
            tables.table(header, body),
            f"Networks see shapes and stretched copies of them, {SHOWN:,} in all: as many as about"
            " an hour of a core allows to the slowest.",
            tables.listed(f"`{name}` for heads: `{what!r}`" for name, what in WHOLE.items()),
            tables.listed(f"`{name}` for networks: `{what!r}`" for name, what in OF_POINTS.items()),
            tables.listed(f"`{name}`: `{what!r}`" for name, what in {**HEADS, **NETWORKS}.items()),
            tables.listed(f"failed: {f['row']}, seed {f['seed']}: {f['reason']}" for f in failures),
        ],
    )
    return folder / "classification.md"


def _turning(cells: list[dict[str, Any]]) -> str:
    """Return what turning changes."""
    changes = [cell["turned"] - cell["mean"] for cell in cells if cell["turned"] is not None]
    return tables.number(float(np.mean(changes)), "+.1f") if changes else tables.NONE


def _cell(cell: dict[str, Any] | None) -> str:
    if cell is None:
        return tables.NONE
    return f"{cell['mean']:.1f} ± {cell['deviation']:.1f} ({cell['worst']:.1f})"


def draw_pictures(results: Results, draws: Draws) -> list[Path]:
    """Draw who is taken for whom and where all shapes lie, for the last row of heads."""
    heads = [r for r in results if r.ok and not r.contender.trained]
    if not heads:
        return []
    best = [r.contender for r in heads if r.contender[1:3] == ("waves+dna", "nearest")]
    last = (best or [r.contender for r in heads])[-1]
    same = [r.contender for r in heads if r.contender[:3] == last[:3]]
    row = min(same, key=lambda one: one.shots)
    every = draws.shapes.train if draws.validated else np.arange(len(draws.shapes.meshes))
    vectors = draws.vectors.of(every, row.view, next(iter(draws.problems)), row.embedding)
    return [
        _draw_confusion([r for r in heads if r.contender == row], draws),
        _draw_map(vectors, every, row, draws),
    ]


def _draw_confusion(results: Results, draws: Draws) -> Path:
    counts = np.sum([r.record["confused"] for r in results], axis=0)
    shares = 100 * counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    row, names = results[0].contender, draws.shapes.classes
    figure, (axes,) = figures.panels(f"What is taken for what: {row}", width=9)
    figure.set_size_inches(9, 8)
    axes.grid(visible=False)
    image = axes.imshow(shares, cmap="Blues", vmin=0, vmax=100)
    axes.set_xticks(range(len(names)), names, rotation=90, fontsize=7)
    axes.set_yticks(range(len(names)), names, fontsize=7)
    axes.set_xlabel("taken for")
    axes.set_ylabel("is")
    for i, j in zip(*np.nonzero((shares >= 1) & ~np.eye(len(names), dtype=bool)), strict=True):
        axes.text(j, i, f"{shares[i, j]:.0f}", ha="center", va="center", fontsize=6)
    figure.colorbar(image, ax=axes, label="% of the class", shrink=0.7)
    return figures.save(figure, draws.folder / "confusion.png")


def _draw_map(vectors: Floats, every: Ints, row: Row, draws: Draws) -> Path:
    """Draw all shapes in the plane: near are those that t-SNE keeps near."""
    manifold = optional("sklearn.manifold", extra="learn", needed_by="the map")
    scaled = vectors / np.maximum(vectors.std(axis=0), 1e-12)
    perplexity = min(15, (len(scaled) - 1) / 3)
    places = manifold.TSNE(
        metric="manhattan", init="random", perplexity=perplexity, random_state=0
    ).fit_transform(scaled)
    assert draws.shapes.labels is not None
    labels, names = draws.shapes.labels[every], draws.shapes.classes
    figure, (axes,) = figures.panels(f"All shapes by {row.embedding}; {row.view}", width=9)
    figure.set_size_inches(9, 8)
    axes.grid(visible=False)
    axes.set_axis_off()
    for label, name in enumerate(names):
        own = places[labels == label]
        colour = f"C{label % 10}"
        axes.scatter(
            own[:, 0], own[:, 1], s=14, color=colour, marker="os^"[label // 10 % 3], linewidths=0
        )
        axes.annotate(name, np.median(own, axis=0), fontsize=8, ha="center", weight="bold")
    return figures.save(figure, draws.folder / "map.png")
