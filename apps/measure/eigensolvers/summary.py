"""What follows for each method over a set of problems: means, the worst, and promises kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from measure import tables
from measure.eigensolvers.methods import BASELINE, Contender
from measure.recipes import Recipe
from measure.study import Repeats

Row = Repeats[Contender, Recipe]

#: Name -> largest value of a figure that keeps a promise: errors over what was asked for, seconds
#: over those of the best of all others.
LIMITS = {"over_asked": 1.0, "behind": 1.25}

# Figures whose mean is geometric.
_GEOMETRIC = ("slowdown", "behind", "seconds", "typical_error")


class Over(NamedTuple):
    """A figure over a set: its mean, its worst, and on which member."""

    mean: float
    worst: float
    where: str


class Summary(NamedTuple):
    """One contender over a set."""

    contender: Contender
    members: int  #: That anyone has solved.
    lost: tuple[str, ...]  #: Of these, what this one did not.
    #: Name -> figure: without means where some are lost, as those would be of easier members.
    over: dict[str, Over]
    #: Name -> members where a figure is above its limit in `LIMITS`.
    above: dict[str, tuple[str, ...]]


def summaries(rows: Sequence[Row]) -> list[Summary]:
    """Summarise each contender that has solved something: what it took, and what came of it.

    Seconds, their ratios and typical errors have a geometric mean, all others an arithmetic one,
    which their largest decide.
    """
    members = list(dict.fromkeys(str(row.problem) for row in rows if row.ok))
    found = []
    for who in dict.fromkeys(row.contender for row in rows if row.ok):
        mine = {
            str(row.problem): _figures(row, rows) for row in rows if row.contender == who and row.ok
        }
        lost = tuple(name for name in members if name not in mine)
        names = dict.fromkeys(name for figures in mine.values() for name in figures)
        columns = {name: {at: own.get(name) for at, own in mine.items()} for name in names}
        over = {
            name: told for name, values in columns.items() if (told := _over(name, values, lost))
        }
        above = {
            name: tuple(at for at, value in columns.get(name, {}).items() if (value or 0) > most)
            for name, most in LIMITS.items()
        }
        found.append(Summary(who, len(members), lost, over, above))
    return found


def _figures(row: Row, rows: Sequence[Row]) -> dict[str, float | None]:
    """Return what one contender did on one member."""
    others = [other for other in rows if other.problem == row.problem and other.ok]
    seconds, asked = row.median("seconds"), row.contender.method.accuracy
    base = [other.median("seconds") for other in others if str(other.contender) == BASELINE]
    found = {
        "seconds": seconds,
        "slowdown": tables.ratio(seconds, base[0] if base else None),
        "bytes": memory(row),
        **{name: row.largest(name) for name in ("eigenvalue_error", "residual_max")},
        "typical_error": row.largest("eigenvalue_error"),
        **{name: row.largest(name) for name in ("apart", "low")},
    }
    if asked:
        best = [
            other.median("seconds")
            for other in others
            if not other.contender.method.accuracy
            and other.contender.device in ("cpu", row.contender.device)
            and other.values("eigenvalue_error")
            and other.largest("eigenvalue_error") <= asked
        ]
        found["over_asked"] = tables.ratio(row.largest("eigenvalue_error"), asked)
        found["behind"] = tables.ratio(seconds, min(filter(None, best), default=None))
    return found


def memory(row: Row) -> float:
    """Return the peak on processor and accelerator, in bytes."""
    return (row.largest("peak_bytes") or 0) + (row.largest("device_peak_bytes") or 0)


def _over(figure: str, values: Mapping[str, float | None], lost: Sequence[str]) -> Over | None:
    known = {name: value for name, value in values.items() if value is not None}
    if not known:
        return None
    where = max(known, key=lambda name: known[name])
    numbers = np.array([*known.values()])
    with np.errstate(divide="ignore"):  # an error of zero makes the mean zero
        mean = np.exp(np.log(numbers).mean()) if figure in _GEOMETRIC else numbers.mean()
    mean = min(mean, numbers.max())  # which that of equal numbers may exceed, by rounding
    return Over(float("nan") if lost else float(mean), known[where], where)
