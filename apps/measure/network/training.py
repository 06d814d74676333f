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
from spectra_kit._types import Floats
from spectra_kit.errors import InvalidInputError
from spectra_kit.neo.pretrained import load_pretrained

_TITLE = "Validation error against hours of training"
_NOTE = (
    "Span errors of the validation samples during the last run of each network, as predicted and,"
    " where that was measured, after the smoothing of the loss. The law is fitted to logarithms of"
    " all of them: error = c (samples + s0)^-p. Ten times the hours of the run promise so many"
    " times less error than at its end."
)
_FEWEST = 4  # validations for the three numbers of a law
_FURTHER = 10  # times the hours, up to where the law is drawn
_SHIFTS = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 601)])  # s0 over the samples of the run
# History of a record -> what is told of it beside the name.
_QUANTITIES = {"validation": "", "smoothed": ", smoothed"}


class Law(NamedTuple):
    """A power law, error = c (samples + s0)^-p."""

    c: float
    s0: float
    p: float

    def at(self, samples: Floats | float) -> Floats:
        """Return the error after so many samples."""
        return np.asarray(self.c * (samples + self.s0) ** -self.p)


def fitted(samples: Floats, errors: Floats) -> Law | None:
    """Fit a law to logarithms of errors, by least squares; None where there are too few, or rise."""
    if len(samples) < _FEWEST:
        return None
    logs, best = np.log(errors), (np.inf, Law(0.0, 0.0, 0.0))
    for shift in _SHIFTS * samples[-1]:
        slope, height = np.polyfit(x := np.log(samples + shift), logs, 1)
        left = float(((logs - height - slope * x) ** 2).sum())
        best = min(best, (left, Law(float(np.exp(height)), float(shift), -float(slope))))
    return best[1] if best[1].p > 0 else None


@dataclass(frozen=True, eq=False)
class Curve:
    """Validations of one network in its last run: mean errors after so many samples."""

    name: str
    m: int
    samples: Floats
    hours: Floats  #: Of the run, by the clock.
    errors: Floats
    device: str = ""  #: Where it was trained, if the record tells.

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
    curves = []
    for quantity, told in _QUANTITIES.items():
        rows = [row for row in found.record.get("history", []) if row.get(quantity)]
        if rows:
            names = ("samples", "seconds", quantity)
            samples, seconds, errors = np.array([[row[n] for n in names] for row in rows], float).T
            device = str(found.record.get("device", ""))
            name = label(weights) + told
            curves.append(Curve(name, found.config.m, samples, seconds / 3600, errors, device))
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
    lacks = ["an error before the first sample, and ends of shorter schedules: the law goes through"
             " validations on the way, at rates that had not fallen yet"]  # fmt: skip
    if "device" not in record:
        lacks.append("how many cores the hours are of")
    lacks.append("the hours that the samples took to make")
    begun = record.get("begun_with", {})
    if begun:
        lacks.append(
            f"the validations of the weights that it began with ({begun.get('samples', 0):,} samples,"
            f" {begun.get('minutes', 0) / 60:.1f} hours, which are not in the curve)"
        )
    return f"The record of {label(weights)} lacks {'; '.join(lacks)}."


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
            "m": curve.m,
            "device": curve.device,
            "samples": curve.samples,
            "hours": curve.hours,
            "error": curve.errors,
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
    head = [
        "weights",
        "m",
        "on",
        "validations",
        "samples, first",
        "error",
        "samples, last",
        "hours",
    ]
    head += ["error", "least", "p", "s0", "ten times the hours"]
    lines = []
    for curve in curves:
        law = curve.law or Law(*[float("nan")] * 3)
        cells = [curve.name, str(curve.m), curve.device or tables.NONE, str(len(curve.samples))]
        cells += [tables.number(curve.samples[0], ",.0f"), tables.number(curve.errors[0])]
        cells += [tables.number(curve.samples[-1], ",.0f"), tables.number(curve.hours[-1])]
        cells += [tables.number(curve.errors[-1]), tables.number(curve.errors.min())]
        cells += [tables.number(law.p), tables.number(law.s0, ",.0f")]
        lines.append([*cells, tables.number(curve.promise, ".2f")])
    return tables.table(head, lines)


def _draw(curves: Sequence[Curve], path: Path) -> Path:
    """Draw validations as dots, and their law on to ten times the hours."""
    figure, (panel,) = figures.panels("Span error of validation samples against hours of training")
    for i, curve in enumerate(curves):
        panel.plot(curve.hours, curve.errors, **figures.dots(i) | {"ls": ""}, label=curve.name)
        if curve.law is not None:
            hours = np.geomspace(curve.hours[0], _FURTHER * curve.hours[-1], 200)
            errors = curve.law.at(hours * (curve.samples[-1] / curve.hours[-1]))
            told = f"{curve.law.c:.2g} (samples + {curve.law.s0:,.0f})$^{{-{curve.law.p:.3f}}}$"
            panel.plot(hours, errors, color=figures.colour(i), ls="--", lw=1.2, label=told)
    devices = {curve.device or "cores untold" for curve in curves}
    what = f"hours of training ({'; '.join(sorted(devices))})"
    panel.set(xlabel=what, ylabel="span error", xscale="log", yscale="log")
    figures.legend(figure, panel)
    return figures.save(figure, path)
