"""How networks' errors fell while they were trained, from the records in their weights files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from measure import figures, tables
from measure.network.methods import check_labels, label
from spectra_kit._core.types import Floats
from spectra_kit.errors import InvalidInputError
from spectra_kit.neo.pretrained import load_pretrained
from spectra_kit.show.layout import log_ticks

_TITLE = "Validation error against hours of training"
_NOTE = (
    "Span errors of the validation samples during the last run of each network, as predicted and,"
    " where that was measured, after the smoothing of the loss. The law is fitted to logarithms of"
    " all of them: error = c (samples + s0)^-p. Ten times the hours of the run promise so many"
    " times less error than at its end."
)
_FEWEST = 4  # validations for the three numbers of a law
_FURTHER = 10  # times the hours, up to where the law is drawn
_SHIFTS = np.concatenate([[0.0], np.geomspace(1e-3, 1e2, 501)])  # s0 over the samples of the run
# In the history of a record -> what it is.
_ERRORS = {"validation": "as predicted", "smoothed": "after smoothing"}


class Law(NamedTuple):
    """A power law, error = c (samples + s0)^-p."""

    c: float
    s0: float
    p: float

    def at(self, samples: Floats | float) -> Floats:
        """Return the error after so many samples."""
        return np.asarray(self.c * (samples + self.s0) ** -self.p)


def fitted(samples: Floats, errors: Floats) -> Law | None:
    """Fit a law by least squares of logarithms; None for too few errors, or rising ones."""
    if len(samples) < _FEWEST:
        return None

    def line(s0: float) -> tuple[float, Floats]:
        fit, left, *_ = np.polyfit(np.log(samples + s0), np.log(errors), 1, full=True)
        return float(left.sum()), fit

    s0 = min(_SHIFTS * samples[-1], key=lambda s0: line(s0)[0])
    slope, height = line(s0)[1]
    return Law(float(np.exp(height)), float(s0), float(-slope)) if slope < 0 else None


@dataclass(frozen=True, eq=False)
class Curve:
    """Validations of one network in its last run: mean errors after so many samples."""

    name: str
    what: str  #: Which errors.
    m: int
    device: str  #: Where it was trained, if the record tells.
    samples: Floats
    hours: Floats  #: Of the run, by the clock.
    errors: Floats

    @cached_property
    def law(self) -> Law | None:
        """What the errors follow."""
        return fitted(self.samples, self.errors)

    @property
    def promise(self) -> float:
        """How many times less error the law promises for ten times the hours."""
        if self.law is None:
            return float("nan")
        return float(self.law.at(self.samples[-1]) / self.law.at(_FURTHER * self.samples[-1]))


def training_curves(weights: str) -> list[Curve]:
    """Read the validations in a weights file, as predicted and, if they are there, smoothed."""
    found = load_pretrained(weights)
    curves, device = [], str(found.record.get("device", ""))
    for name, what in _ERRORS.items():
        rows = [row for row in found.record.get("history", []) if row.get(name)]
        if rows:
            columns = [[row["samples"], row["seconds"] / 3600, row[name]] for row in rows]
            numbers = np.array(columns, float).T
            curves.append(Curve(label(weights), what, found.config.m, device, *numbers))
    if not curves:
        raise InvalidInputError(
            "weights",
            "hold the validations of their training",
            f"none in {weights}",
            advice="train with validation samples",
        )
    return curves


def untold(weights: str) -> str:
    """Say what the record in a weights file lacks that the law would need."""
    record = load_pretrained(weights).record
    lacks = "an error before the first sample, ends of shorter schedules (the law goes through"
    lacks += " validations on the way, at rates that had not fallen yet), the time to make samples"
    lacks += "" if "device" in record else ", the number of cores"
    if begun := record.get("begun_with"):
        lacks += (
            f", these errors of the weights that it began with, after {begun['samples']:,} samples"
        )
    return f"The record of {label(weights)} lacks: {lacks}."


def write_training(weights: Sequence[str], folder: Path) -> str:
    """Write ``training.json``, ``training.md`` and a figure; return the text of the second."""
    check_labels(weights)
    curves = [curve for one in weights for curve in training_curves(one)]
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    link = "figures/training-hours.png"
    _draw(curves, folder / link)
    records = [
        {
            "weights": curve.name,
            "errors": curve.what,
            "m": curve.m,
            "device": curve.device,
            "samples": curve.samples,
            "hours": curve.hours,
            "span_error": curve.errors,
            "law": curve.law and curve.law._asdict(),
            "promise": curve.promise,
        }
        for curve in curves
    ]
    record = {"study": "training", "title": _TITLE, "curves": records, "figures": [link]}
    tables.write_json(folder / "training.json", record)
    parts = [f"## {_TITLE}", _NOTE, *map(untold, weights), _table(curves), f"![training]({link})"]
    return tables.write_markdown(folder / "training.md", parts)


def _table(curves: Sequence[Curve]) -> str:
    head = ["weights", "m", "on", "errors", "validations", "samples, first", "error"]
    head += ["samples, last", "hours", "error", "least", "p", "s0", "ten times the hours"]
    lines = []
    for curve in curves:
        law = curve.law or Law(*[float("nan")] * 3)
        cells = [curve.name, str(curve.m), curve.device, curve.what, str(len(curve.samples))]
        cells += [tables.number(curve.samples[0], ",.0f"), tables.number(curve.errors[0])]
        cells += [tables.number(curve.samples[-1], ",.0f"), tables.number(curve.hours[-1])]
        cells += [tables.number(curve.errors[-1]), tables.number(curve.errors.min())]
        cells += [tables.number(law.p), tables.number(law.s0, ",.0f")]
        lines.append([*cells, tables.number(curve.promise, ".2f")])
    return tables.table(head, lines)


def _draw(curves: Sequence[Curve], path: Path) -> Path:
    """Draw validations as dots, and their law on to ten times the hours."""
    kinds = list(dict.fromkeys(curve.what for curve in curves))
    title = "Span error of validation samples against core-hours of training"
    figure, axes = figures.panels(title, len(kinds))
    for i, curve in enumerate(curves):
        panel = axes[kinds.index(curve.what)]
        name = f"{curve.name}, {curve.device or 'cores untold'}, {curve.what}"
        panel.plot(curve.hours, curve.errors, **figures.dots(i) | {"ls": ""}, label=name)
        if law := curve.law:
            hours = np.geomspace(curve.hours[0], _FURTHER * curve.hours[-1], 200)
            errors = law.at(hours * (curve.samples[-1] / curve.hours[-1]))
            told = f"{law.c:.2g} (samples + {law.s0:,.0f})$^{{-{law.p:.3f}}}$"
            panel.plot(hours, errors, color=figures.colour(i), ls="--", lw=1.2, label=told)
        panel.set(title=curve.what, xlabel="hours", xscale="log", yscale="log")
    axes[0].set(ylabel="span error")
    for panel in axes:
        log_ticks(panel.yaxis)
        panel.legend(fontsize=8, frameon=False)
    return figures.save(figure, path)
