"""From rows of measurements to ratios, and which goals they meet."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from spectra_kit._types import Floats
from spectra_kit.evaluation.bench import Measurement
from spectra_kit.evaluation.cases import Case
from spectra_kit.evaluation.methods import Method
from spectra_kit.evaluation.models import Model

_REFERENCE_POINTS = 8192
# Mean span error in one pose, and how many times less than plane waves: with CPU training
# alone, one and several stretches on an accelerator.
_SPAN_GOALS = (2.5e-2, 6e-3, 2.6e-3)
_LEAD_GOALS = (3.0, 10.0)
_GROWTH_GOAL, _DENSITY_GOAL, _ROTATION_GOAL = 1.5, 1.3, 0.1
_SAME_TIME = 1.05  # times closer than this are equal


class Goal(NamedTuple):
    """A limit, and whether it is one from above or from below."""

    limit: float
    at_most: bool = True

    def met(self, value: float) -> bool:
        """Whether `value` keeps to the limit."""
        return value <= self.limit if self.at_most else value >= self.limit


@dataclass(frozen=True)
class Finding:
    """A number that answers a question, or the name of what does.

    Attributes
    ----------
    text : str
        What was compared.
    value : float
        The ratio or error.
    goals : tuple of Goal
        What it ought to be, the easiest first.
    """

    text: str
    value: float
    goals: tuple[Goal, ...] = ()


@dataclass(frozen=True, eq=False)
class Row:
    """One line of a table: a method and its measurements.

    Attributes
    ----------
    labels : mapping of str to str or int
        Columns that tell the rows apart.
    method : Method
        What was measured.
    measured : tuple of (Case, Measurement)
        On what, and the errors.
    failures : tuple of str
        What could not be measured, and why.
    """

    labels: Mapping[str, str | int]
    method: Method
    measured: tuple[tuple[Case, Measurement], ...]
    failures: tuple[str, ...] = ()

    @property
    def measurements(self) -> tuple[Measurement, ...]:
        """The measurements alone."""
        return tuple(measurement for _, measurement in self.measured)

    @property
    def models(self) -> tuple[Model, ...]:
        """What was measured on."""
        return tuple(case.model for case, _ in self.measured)

    def means(self, error: str) -> Floats:
        """Mean over the modes of an error of each measurement."""
        return np.array([measurement.mean(error) for measurement in self.measurements])

    def mean(self, error: str = "span") -> float:
        """Mean of `means`."""
        return float(self.means(error).mean())

    def seconds(self) -> float:
        """Median time of a solve."""
        return float(np.median([measurement.seconds for measurement in self.measurements]))

    def exact_seconds(self) -> float:
        """Median time of ARPACK."""
        return float(np.median([measurement.exact_seconds for measurement in self.measurements]))

    def place(self) -> str:
        """Which models and points, in words."""
        points = self.labels.get("points")
        return f"{self.labels['models']}" + (f", {points:,} points" if points else "")


def accuracy_findings(rows: Sequence[Row]) -> list[Finding]:
    """Error of one pose, its lead over plane waves, its growth with N, the best at equal time.

    Where ARPACK, which is exact, takes less time, it is the best.
    """
    found = []
    for row in rows:
        if row.method.poses != 1 or "union" in row.method.key:
            continue
        real = row.labels["models"] == "real"
        goals = tuple(map(Goal, _SPAN_GOALS))
        aimed_at = real and row.labels["points"] in (2048, _REFERENCE_POINTS)
        text = f"{row.place()}, {row.method.name}: mean span error"
        found.append(Finding(text, row.mean(), goals if aimed_at else ()))
        rivals = [
            other
            for other in _beside(rows, row)
            if not other.method.poses and other.method.columns == row.method.columns
        ]
        if rivals:
            rival = min(rivals, key=Row.mean)
            text = f"{row.place()}, {row.method.name}: times less than {rival.method.name}"
            lead = tuple(Goal(limit, at_most=False) for limit in _LEAD_GOALS)
            found.append(Finding(text, rival.mean() / row.mean(), lead if real else ()))
        for other in rows:
            same = {**other.labels, "points": row.labels["points"]} == row.labels
            shared = same and {m.digest for m in other.models} & {m.digest for m in row.models}
            if shared and other.labels["points"] == _REFERENCE_POINTS < int(row.labels["points"]):
                text = f"{row.place()}, {row.method.name}: times the error at {_REFERENCE_POINTS:,}"
                goals = (Goal(_GROWTH_GOAL),) if real else ()
                found.append(Finding(text, _growth(other, row), goals))
    for row in rows:
        if not row.method.poses or "union" in row.method.key:
            continue
        text = f"{row.place()}, best in the time of {row.method.name}"
        if _arpack_beats(row):
            text += f" ({row.seconds():.2f} s): ARPACK is faster ({row.exact_seconds():.2f} s)"
            found.append(Finding(f"{text} and exact, span error", 0.0))
            continue
        in_time = [o for o in _beside(rows, row) if o.seconds() <= _SAME_TIME * row.seconds()]
        best = min(in_time, key=Row.mean)
        found.append(Finding(f"{text}: {best.method.name}", best.mean()))
    return found


def undominated(rows: Sequence[Row]) -> list[Row]:
    """Return the rows that neither ARPACK nor a row of the same place beats.

    To beat is to have less span error or time and not more of the other.
    """
    return [
        row
        for row in rows
        if row.measured
        and not _arpack_beats(row)
        and not any(_beats(other, row) for other in _beside(rows, row))
    ]


def precision_findings(rows: Sequence[Row]) -> list[Finding]:
    """Errors in half precision against those in float32."""
    found = []
    for row in rows:
        for other in _beside(rows, row):
            if other.labels["precision"] == "float32" != row.labels["precision"]:
                for error, name in (("span", "span"), ("value", "eigenvalue")):
                    text = f"{row.place()}, {row.labels['precision']}: times the {name} error"
                    ratio = row.mean(error) / other.mean(error)
                    found.append(Finding(text + " of float32", ratio))
    return found


def sampling_findings(rows: Sequence[Row]) -> list[Finding]:
    """Non-uniform against uniform samples, and each variant against the mass-aware network."""
    found = []
    table = {tuple(row.labels.values()): row for row in rows}
    for (models, density, attention), row in table.items():
        uniform = table.get((models, "uniform", attention))
        aware = table.get((models, density, "mass-aware"))
        place = f"{models}, {density}, {attention}"
        if uniform and uniform is not row:
            goals = (Goal(_DENSITY_GOAL),) if (models, aware) == ("real", row) else ()
            text = f"{place}: times the error on uniform samples"
            found.append(Finding(text, row.mean() / uniform.mean(), goals))
        if aware and aware is not row:
            text = f"{place}: times the error of the mass-aware network"
            found.append(Finding(text, row.mean() / aware.mean()))
    return found


def operator_findings(rows: Sequence[Row]) -> list[Finding]:
    """Every operator against the Delaunay Laplacian of a cloud."""
    found = []
    for row in rows:
        for other in _beside(rows, row):
            if other.labels["operator"] == "cloud, Delaunay" and other is not row:
                text = f"{row.place()}, {row.labels['operator']}: times the error on clouds"
                found.append(Finding(text, row.mean() / other.mean()))
    return found


def redundancy_findings(rows: Sequence[Row]) -> list[Finding]:
    """Every m against the next smaller one."""
    found = []
    for smaller, row in itertools.pairwise(rows):
        if smaller.place() == row.place() and smaller.labels["m"] != row.labels["m"]:
            text = f"{row.place()}, m = {row.labels['m']}: times the error of m ="
            found.append(Finding(f"{text} {smaller.labels['m']}", row.mean() / smaller.mean()))
    return found


def rotation_findings(rows: Sequence[Row]) -> list[Finding]:
    """Spread of the span error over rotations: typical and worst cloud."""
    found = []
    for models in dict.fromkeys(row.labels["models"] for row in rows):
        means = [row.means("span") for row in rows if row.labels["models"] == models]
        goals = (Goal(_ROTATION_GOAL),)
        relative = [mean.std() / mean.mean() for mean in means]
        text = f"{models}: std / mean of the span error over rotations"
        found.append(Finding(f"{text}, mean over clouds", float(np.mean(relative)), goals))
        found.append(Finding(f"{text}, worst cloud", float(np.max(relative))))
        largest = max(mean.max() / mean.min() for mean in means)
        text = f"{models}: largest / smallest span error over rotations, worst cloud"
        found.append(Finding(text, float(largest)))
    return found


def worst_findings(rows: Sequence[Row]) -> list[Finding]:
    """The worst model of each set against the median one."""
    found = []
    for row in rows:
        means = row.means("span")
        name = row.measured[int(means.argmax())][0].model.name
        text = f"{row.place()}: worst model, {name}, times the median one"
        found.append(Finding(text, float(means.max() / np.median(means))))
    return found


def _beside(rows: Sequence[Row], row: Row) -> list[Row]:
    """Rows of the same models and points, itself among them."""
    return [other for other in rows if other.measured and other.place() == row.place()]


def _growth(small: Row, large: Row) -> float:
    """Error of `large` over that of `small`, on the models that both have."""
    errors = [
        {case.model.digest: measurement.mean("span") for case, measurement in row.measured}
        for row in (small, large)
    ]
    both = errors[0].keys() & errors[1].keys()
    below, above = (sum(error[model] for model in both) for error in errors)
    return above / below


def _arpack_beats(row: Row) -> bool:
    """Whether the exact modes take less time."""
    return row.exact_seconds() < row.seconds()


def _beats(other: Row, row: Row) -> bool:
    """Whether `other` is better in span error or time and not worse in either."""
    figures = (other.mean(), other.seconds()), (row.mean(), row.seconds())
    return figures[0] != figures[1] and all(a <= b for a, b in zip(*figures, strict=True))
