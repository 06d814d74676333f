"""How networks' errors fell while they were trained, from the records in their weights files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from measure import figures, tables
from measure.network.methods import check_labels, label
from spectra_kit._types import Floats
from spectra_kit.errors import InvalidInputError
from spectra_kit.neo.pretrained import load_pretrained

_TITLE = "Validation error against samples seen"
_NOTE = (
    "Mean span error of the validation samples during training; `exponent` is the slope between"
    " the first and the last validation on logarithmic axes."
)


@dataclass(frozen=True, eq=False)
class Curve:
    """Validations of one network in its last run: mean span errors after so many samples."""

    name: str
    m: int
    samples: Floats
    errors: Floats

    @property
    def exponent(self) -> float:
        """Slope between first and last validation, logarithm over logarithm; NaN for one alone."""
        if len(self.samples) < 2:
            return float("nan")
        fall = np.log(self.errors[-1] / self.errors[0])
        return float(fall / np.log(self.samples[-1] / self.samples[0]))


def training_curve(weights: str) -> Curve:
    """Read the validations in a weights file; a leg counts the samples of the runs before it."""
    found = load_pretrained(weights)
    rows = [row for row in found.record.get("history", []) if row.get("validation")]
    if not rows:
        raise InvalidInputError(
            "weights",
            "hold the validations of their training",
            f"none in {weights}",
            advice="train with validation samples",
        )
    samples, errors = np.array([[row["samples"], row["validation"]] for row in rows], float).T
    return Curve(label(weights), found.config.m, samples, errors)


def write_training(weights: Sequence[str], folder: Path) -> str:
    """Write ``training.json``, ``training.md`` and a figure; return the text of the second."""
    check_labels(weights)
    curves = [training_curve(one) for one in weights]
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    link = "figures/training-samples.png"
    _draw(curves, folder / link)
    records = [
        {
            "weights": curve.name,
            "m": curve.m,
            "samples": curve.samples,
            "span_error": curve.errors,
            "exponent": curve.exponent,
        }
        for curve in curves
    ]
    record = {"study": "training", "title": _TITLE, "curves": records, "figures": [link]}
    tables.write_json(folder / "training.json", record)
    parts = [f"## {_TITLE}", _NOTE, _table(curves), f"![training]({link})"]
    return tables.write_markdown(folder / "training.md", parts)


def _table(curves: Sequence[Curve]) -> str:
    head = ["weights", "m", "validations", "samples, first", "span error", "samples, last"]
    head += ["span error", "least", "exponent"]
    lines = []
    for curve in curves:
        cells = [curve.name, str(curve.m), str(len(curve.samples))]
        for i in (0, -1):
            cells += [tables.number(curve.samples[i], ",.0f"), tables.number(curve.errors[i])]
        least = tables.number(curve.errors.min())
        lines.append([*cells, least, tables.number(curve.exponent, ".2f")])
    return tables.table(head, lines)


def _draw(curves: Sequence[Curve], path: Path) -> Path:
    figure, (panel,) = figures.panels("Validation against samples seen")
    for i, curve in enumerate(curves):
        panel.plot(curve.samples, curve.errors, **figures.dots(i), label=curve.name)
    panel.set(xlabel="samples seen", ylabel="mean span error", xscale="log", yscale="log")
    figures.legend(figure, panel)
    return figures.save(figure, path)
