"""From rows of measurements to ratios; and `Neo` model by model, beside plane waves.

The waves are smoothed alike. Each model is measured before and after smoothing.
"""

from __future__ import annotations

import itertools
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
_REFERENCE_POINTS = 8192


class Finding(NamedTuple):
    """What was compared, and the ratio or error."""

    text: str
    value: float


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


def of_accuracy(rows: Sequence[Row]) -> list[Finding]:
    """Error of one pose, its lead over plane waves, its growth with N."""
    found = []
    for row in rows:
        if row.method.poses == 1:
            found += _of_one_pose(row, rows)
    return found


def _of_one_pose(row: Row, rows: Sequence[Row]) -> list[Finding]:
    what = f"{row.place}, {row.method}"
    found = [Finding(f"{what}: mean span error", row.mean())]
    rivals = [
        other
        for other in _beside(row, rows)
        if other.method.group == "plane waves" and other.method.columns == row.method.columns
    ]
    if rivals:
        rival = min(rivals, key=Row.mean)
        found.append(Finding(f"{what}: times less than {rival.method}", rival.mean() / row.mean()))
    if (row.place.points or 0) > _REFERENCE_POINTS:
        text = f"{what}: times the error at {_REFERENCE_POINTS:,}"
        for other in rows:
            if other.labels == {**row.labels, "points": _REFERENCE_POINTS}:
                growth = _growth(other, row)
                if growth is not None:
                    found.append(Finding(text, growth))
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
                found.append(Finding(f"{what}: times the error on uniform samples", ratio))
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
        found.append(Finding(f"{text}, mean over clouds", float(np.mean(relative))))
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


# --- model by model ---

#: Of smoothing, at most: none, one, and what `Neo` is allowed by default.
STEPS = (0, 1, Neo.smoothing)
#: The column by which models are ranked.
WORST = "eigenvalue error"
_BEFORE, _ONCE = f"{WORST} before", "after one step"
_RATIOS = _RATIO, _RATIO_ONCE = "ratio", "ratio after one step"
#: The columns that a figure shows.
DRAWN = (WORST, f"{WORST}, waves", _ONCE, f"{_ONCE}, waves")


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


def of_models(rows: Sequence[Row]) -> list[Finding]:
    """Mean and worst of the errors, and of their ratios to those of plane waves."""
    found = []
    for one in beside(rows):
        for name, text in (
            (WORST, f"{WORST} of {one.method}"),
            ("span error before", "span error before smoothing"),
            (_BEFORE, f"{WORST} before smoothing"),
            (_RATIO_ONCE, "times less than plane waves smoothed alike, by one step each"),
            (_RATIO, "times less than plane waves that go on to the same target"),
        ):
            values, least = one.columns[name], name in _RATIOS
            at = one.cases[int(values.argmin() if least else values.argmax())].shape
            told = ("mean", mean(name, values)), (f"worst ({at})", worst(name, values))
            found += [Finding(f"{one.place}: {text}, {which}", value) for which, value in told]
    return found
