"""`Neo` model by model, before and after smoothing, beside plane waves that are smoothed alike."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from measure.network.cases import Case
from measure.network.findings import Finding, Goal, Place, Row
from measure.network.methods import Method
from spectra_kit._core.types import Floats, Ints
from spectra_kit.eigen import Neo

#: Of smoothing, at most: none, one, and what `Neo` is allowed by default.
STEPS = (0, 1, Neo.max_steps)
#: The column by which models are ranked.
WORST = "eigenvalue error"
_BEFORE, _ONCE = f"{WORST} before", "after one step"
_RATIOS = _RATIO, _RATIO_ONCE = "ratio", "ratio after one step"
#: The columns that a figure shows.
DRAWN = (WORST, f"{WORST}, waves", _ONCE, f"{_ONCE}, waves")

_LEAD, _NOWHERE_WORSE = (Goal(3.0, at_most=False),), (Goal(1.0, at_most=False),)


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


def findings(rows: Sequence[Row]) -> list[Finding]:
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
            goals = (_LEAD, _NOWHERE_WORSE) if name == _RATIO_ONCE else ((), ())
            told = ("mean", mean(name, values)), (f"worst ({at})", worst(name, values))
            found += [
                Finding(f"{one.place}: {text}, {which}", value, goal)
                for (which, value), goal in zip(told, goals, strict=True)
            ]
    return found
