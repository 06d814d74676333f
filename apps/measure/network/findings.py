"""From rows of measurements to ratios, and which goals they meet."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from measure.network.cases import Case
from measure.network.methods import Method
from measure.store import Record
from spectra_kit._core.types import Floats

Labels = Mapping[str, str | int]

#: Labels that others are compared with.
CLOUD, AWARE = "cloud, Delaunay", "mass-aware"
_REAL, _REFERENCE_POINTS = "real", 8192


class Goal(NamedTuple):
    """A limit, and whether it is one from above or from below."""

    limit: float
    at_most: bool = True

    def met(self, value: float) -> bool:
        """Whether `value` keeps to the limit."""
        return value <= self.limit if self.at_most else value >= self.limit


# Mean span error in one pose, and how many times less than plane waves: with CPU training
# alone, one and several stretches on an accelerator.
_SPAN = (Goal(2.5e-2), Goal(6e-3), Goal(2.6e-3))
_LEAD = (Goal(3.0, at_most=False), Goal(10.0, at_most=False))
_GROWTH, _DENSITY, _ROTATION = (Goal(1.5),), (Goal(1.3),), (Goal(0.1),)


@dataclass(frozen=True)
class Finding:
    """What was compared, the ratio or error, and what that ought to be, the easiest first."""

    text: str
    value: float
    goals: tuple[Goal, ...] = ()


class Place(NamedTuple):
    """On which shapes it was measured, and at how many points, where that is told."""

    models: str
    points: int | None

    def __str__(self) -> str:
        return self.models + (f", {self.points:,} points" if self.points else "")


@dataclass(frozen=True, eq=False)
class Row:
    """One line of a table: a method on cases, with a record of `Accuracy.measure` for each."""

    labels: Labels  #: columns that tell the rows apart
    method: Method
    cases: tuple[Case, ...]
    records: tuple[Record, ...]
    failures: tuple[str, ...] = ()  #: what could not be measured, and why

    @property
    def place(self) -> Place:
        """What rows that are compared have in common."""
        points = self.labels.get("points")
        return Place(str(self.labels["models"]), None if points is None else int(points))

    def modes(self, error: str) -> Floats:
        """Return the "span", "vector" or "value" error of each mode of each case."""
        return np.array([record[error] for record in self.records], dtype=np.float64)

    def means(self, error: str = "span") -> Floats:
        """Mean over the modes of an error of each case; of "value" without the kernel."""
        return np.array([np.nanmean(modes) for modes in self.modes(error)])

    def mean(self, error: str = "span") -> float:
        """Mean of `means`."""
        return float(self.means(error).mean())

    @property
    def seconds(self) -> float:
        """Median time of a solve."""
        return float(np.median([record["seconds"] for record in self.records]))

    @property
    def exact_seconds(self) -> float:
        """Median time of ARPACK."""
        return float(np.median([record["exact_seconds"] for record in self.records]))


def of_accuracy(rows: Sequence[Row]) -> list[Finding]:
    """Error of one pose, its lead over plane waves, its growth with N."""
    found = []
    for row in rows:
        if row.method.poses == 1:
            found += _of_one_pose(row, rows)
    return found


def _of_one_pose(row: Row, rows: Sequence[Row]) -> list[Finding]:
    what, real = f"{row.place}, {row.method}", row.place.models == _REAL
    aimed_at = real and row.place.points in (2048, _REFERENCE_POINTS)
    found = [Finding(f"{what}: mean span error", row.mean(), _SPAN if aimed_at else ())]
    rivals = [
        other
        for other in _beside(row, rows)
        if other.method.group == "plane waves" and other.method.columns == row.method.columns
    ]
    if rivals:
        rival = min(rivals, key=Row.mean)
        lead = rival.mean() / row.mean()
        text = f"{what}: times less than {rival.method}"
        found.append(Finding(text, lead, _LEAD if real else ()))
    if (row.place.points or 0) > _REFERENCE_POINTS:
        text = f"{what}: times the error at {_REFERENCE_POINTS:,}"
        for other in rows:
            if other.labels == {**row.labels, "points": _REFERENCE_POINTS}:
                growth = _growth(other, row)
                if growth is not None:
                    found.append(Finding(text, growth, _GROWTH if real else ()))
    return found


def of_precision(rows: Sequence[Row]) -> list[Finding]:
    """Errors in half precision against those in float32."""
    return [
        Finding(
            f"{row.place}, {row.labels['precision']}: times the {name} error of float32",
            row.mean(error) / other.mean(error),
        )
        for row, other in _against(rows, "precision", "float32")
        for error, name in (("span", "span"), ("value", "eigenvalue"))
    ]


def of_sampling(rows: Sequence[Row]) -> list[Finding]:
    """Non-uniform against uniform samples, and each variant against the mass-aware network."""
    found = []
    for row in rows:
        what = ", ".join(map(str, row.labels.values()))
        for other in rows:
            ratio = row.mean() / other.mean()
            if other is not row and other.labels == {**row.labels, "sampling": "uniform"}:
                aimed_at = (row.place.models, row.labels["attention"]) == (_REAL, AWARE)
                text = f"{what}: times the error on uniform samples"
                found.append(Finding(text, ratio, _DENSITY if aimed_at else ()))
            if other is not row and other.labels == {**row.labels, "attention": AWARE}:
                found.append(Finding(f"{what}: times the error of the mass-aware network", ratio))
    return found


def of_operators(rows: Sequence[Row]) -> list[Finding]:
    """Every operator against the Delaunay Laplacian of a cloud."""
    return [
        Finding(
            f"{row.place}, {row.labels['operator']}: times the error on clouds",
            row.mean() / other.mean(),
        )
        for row, other in _against(rows, "operator", CLOUD)
    ]


def of_redundancy(rows: Sequence[Row]) -> list[Finding]:
    """Every m against the next smaller one."""
    return [
        Finding(
            f"{row.place}, m = {row.labels['m']}: times the error of m = {smaller.labels['m']}",
            row.mean() / smaller.mean(),
        )
        for smaller, row in itertools.pairwise(rows)
        if smaller.place == row.place and smaller.labels["m"] != row.labels["m"]
    ]


def of_rotation(rows: Sequence[Row]) -> list[Finding]:
    """Spread of the span error over rotations: typical and worst cloud."""
    found = []
    for models in dict.fromkeys(row.place.models for row in rows):
        means = [row.means() for row in rows if row.place.models == models]
        relative = [mean.std() / mean.mean() for mean in means]
        text = f"{models}: std / mean of the span error over rotations"
        found.append(Finding(f"{text}, mean over clouds", float(np.mean(relative)), _ROTATION))
        found.append(Finding(f"{text}, worst cloud", float(np.max(relative))))
        largest = max(mean.max() / mean.min() for mean in means)
        text = f"{models}: largest / smallest span error over rotations, worst cloud"
        found.append(Finding(text, float(largest)))
    return found


def _beside(row: Row, rows: Sequence[Row]) -> list[Row]:
    """Rows of the same place, itself among them."""
    return [other for other in rows if other.place == row.place]


def _against(rows: Sequence[Row], name: str, value: str) -> list[tuple[Row, Row]]:
    """Pair each row with the one of its place that has this label, but not with itself."""
    return [
        (row, other)
        for row in rows
        for other in _beside(row, rows)
        if other.labels[name] == value and other is not row
    ]


def _growth(small: Row, large: Row) -> float | None:
    """Error of `large` over that of `small`, on the shapes that both have."""
    errors = [
        {case.shape.digest: mean for case, mean in zip(row.cases, row.means(), strict=True)}
        for row in (small, large)
    ]
    both = errors[0].keys() & errors[1].keys()
    below, above = (sum(float(error[shape]) for shape in both) for error in errors)
    return above / below if both else None
