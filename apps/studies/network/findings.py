"""Rows of measurements, and their ratios; and `Neo` model by model, beside plane waves.

The waves are smoothed alike. Each model is measured before and after smoothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from spectra_kit._core.types import Floats, Ints
from spectra_kit.eigen import Neo
from studies.network.cases import Case
from studies.network.methods import Method
from studies.store import Record

Labels = Mapping[str, str | int]

#: Labels that others are compared with.
CLOUD, AWARE = "cloud, Delaunay", "mass-aware"


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


def over(row: Row, rows: Sequence[Row], **labels: str | int) -> float | None:
    """Return the span error over that of the row whose labels are these but alike, if any.

    On the shapes that both have.
    """
    for other in rows:
        if other is not row and other.labels == {**row.labels, **labels}:
            errors = [
                {case.shape.digest: mean for case, mean in zip(one.cases, one.means(), strict=True)}
                for one in (row, other)
            ]
            both = errors[0].keys() & errors[1].keys()
            mine, theirs = (sum(float(error[shape]) for shape in both) for error in errors)
            return mine / theirs if both else None
    return None


def lead(row: Row, rows: Sequence[Row]) -> float | None:
    """Return how many times less a network's error is than that of as many plane waves, the best.

    None of more poses than one, and of what is no network.
    """
    rivals = [
        other.mean()
        for other in rows
        if other.place == row.place and other.method.group == "plane waves"
        and other.method.columns == row.method.columns
    ]  # fmt: skip
    return min(rivals) / row.mean() if row.method.poses == 1 and rivals else None


# --- model by model ---

#: Of smoothing, at most: none, one, and what `Neo` is allowed by default.
STEPS = (0, 1, Neo.max_steps)
#: The column by which models are ranked.
WORST = "eigenvalue error"
_BEFORE, _ONCE = f"{WORST} before", "after one step"
_RATIOS = _RATIO, _RATIO_ONCE = "ratio", "ratio after one step"


@dataclass(frozen=True, eq=False)
class Beside:
    """What was measured on the models of one place."""

    place: Place
    method: Method  #: `Neo` by default.
    cases: tuple[Case, ...]  #: That all methods were measured on.
    columns: dict[str, Floats]  #: Name -> a figure for each of these.

    @property
    def worst_first(self) -> Ints:
        """Order of the cases."""
        return np.argsort(-self.columns[WORST], kind="stable")


def beside(rows: Sequence[Row]) -> Iterator[Beside]:
    """Gather the rows of each place; of plane waves those of the best bandwidth, by their means."""
    for place in dict.fromkeys(row.place for row in rows if row.cases):
        best: dict[tuple[bool, int], Row] = {}
        for row in (row for row in rows if row.place == place and row.cases):
            key = bool(row.method.poses), int(row.labels["steps"])
            error = "value" if key[1] else "span"
            if key not in best or row.mean(error) < best[key].mean(error):
                best[key] = row
        if len(best) < 2 * len(STEPS):  # what failed everywhere is told elsewhere
            continue
        mine, waves = ({n: best[network, n] for n in STEPS} for network in (True, False))
        measured = [row.cases for row in best.values()]
        cases = tuple(case for case in measured[0] if all(case in some for some in measured))

        def of_each(row: Row, error: str, wanted: tuple[Case, ...] = cases) -> Floats:
            return row.means(error)[[row.cases.index(case) for case in wanted]]

        before, once, done = STEPS
        columns = {
            "span error before": of_each(mine[before], "span"),
            "span error before, waves": of_each(waves[before], "span"),
            "span error after": of_each(mine[done], "span"),
            _BEFORE: of_each(mine[before], "value"),
            f"{_BEFORE}, waves": of_each(waves[before], "value"),
            WORST: of_each(mine[done], "value"),
            f"{WORST}, waves": of_each(waves[done], "value"),
            _ONCE: of_each(mine[once], "value"),
            f"{_ONCE}, waves": of_each(waves[once], "value"),
        }
        columns[_RATIO] = columns[f"{WORST}, waves"] / columns[WORST]
        columns[_RATIO_ONCE] = columns[f"{_ONCE}, waves"] / columns[_ONCE]
        yield Beside(place, mine[done].method, cases, columns)


def mean(name: str, values: Floats) -> float:
    """Return the mean of a column."""
    return float(np.exp(np.log(values).mean()) if name in _RATIOS else values.mean())


def worst(name: str, values: Floats) -> float:
    """Return the worst of a column."""
    return float(values.min() if name in _RATIOS else values.max())
