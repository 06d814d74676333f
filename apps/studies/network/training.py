"""How networks' errors fell while they were trained, from the records in their weights files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from spectra_kit._core.types import Floats
from spectra_kit.errors import InvalidInputError
from spectra_kit.neo.pretrained import load_pretrained
from spectra_kit.show.layout import Page, line_style, log_ticks, new_diagram, tidy
from spectra_kit.show.picture import PathLike, plotted
from studies.machine import describe_machine
from studies.network.methods import check_labels, label
from studies.report import Table, write_report

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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


_COLUMNS = {
    **{"weights": "", "m": "d", "device": "", "errors": "", "validations": "d", "first": ",.0f"},
    **{"first error": ".3g", "last": ",.0f", "hours": ".3g", "last error": ".3g", "least": ".3g"},
    **{"p": ".3g", "s0": ",.0f", "promise": ".2f"},
}


def write_training(weights: Sequence[str], folder: Path) -> Path:
    """Write ``training.md``, its JSON and a figure; return the first."""
    check_labels(weights)
    curves = [curve for one in weights for curve in training_curves(one)]
    rows = []
    for curve in curves:
        law = curve.law._asdict() if curve.law else {}
        row = {"weights": curve.name, "m": curve.m, "device": curve.device, "errors": curve.what}
        row |= {"validations": len(curve.samples), "first": curve.samples[0]}
        row |= {"first error": curve.errors[0], "last": curve.samples[-1]}
        row |= {"hours": curve.hours[-1], "last error": curve.errors[-1]}
        row |= {"least": curve.errors.min(), **law, "promise": curve.promise}
        curve_of = {"samples": curve.samples, "hours": curve.hours, "errors": curve.errors}
        rows.append({**row, "curve": curve_of})
    drawn = folder / "figures" / "training-hours.png"
    drawn.parent.mkdir(parents=True, exist_ok=True)
    title = "Span error of validation samples against core-hours of training"
    plot_training(curves, path=drawn, page=Page(title, dpi=150))
    return write_report(
        folder,
        "training",
        [],
        [Table("Validations of the training", rows, _COLUMNS)],
        describe_machine(),
        figures=[drawn],
    )


@plotted
def plot_training(
    curves: Sequence[Curve], *, path: PathLike | None = None, page: Page = Page()
) -> Figure:
    """Draw validations as dots, and their law on to ten times the hours."""
    kinds = list(dict.fromkeys(curve.what for curve in curves))
    figure = new_diagram(page, 12 if len(kinds) > 1 else 8, 4)
    axes = figure.subplots(1, len(kinds), squeeze=False)[0]
    for i, curve in enumerate(curves):
        panel, colour = axes[kinds.index(curve.what)], line_style(i)[0]
        name = f"{curve.name}, {curve.device or 'cores untold'}, {curve.what}"
        panel.plot(curve.hours, curve.errors, color=colour, marker="o", ls="", label=name)
        if law := curve.law:
            hours = np.geomspace(curve.hours[0], _FURTHER * curve.hours[-1], 200)
            errors = law.at(hours * (curve.samples[-1] / curve.hours[-1]))
            told = f"{law.c:.2g} (samples + {law.s0:,.0f})$^{{-{law.p:.3f}}}$"
            panel.plot(hours, errors, color=colour, ls="--", lw=1.2, label=told)
        panel.set(title=curve.what, xlabel="hours", xscale="log", yscale="log")
    axes[0].set(ylabel="span error")
    for panel in axes:
        tidy(panel)
        log_ticks(panel.yaxis)
        panel.legend(fontsize=8, frameon=False)
    return figure
