"""What follows for each method over a set: means, the worst, promises; where the network pays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from studies.eigensolvers.methods import BASELINE, Contender
from studies.plots import ROUNDING
from studies.recipes import Recipe
from studies.report import ratio
from studies.store import Record
from studies.study import Repeats

Row = Repeats[Contender, Recipe]

# Figures whose mean is geometric.
_GEOMETRIC = ("slowdown", "seconds", "typical_error")


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
    above: tuple[str, ...]  #: Members whose error is above what was asked for.


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
        above = tuple(at for at, value in columns.get("over_asked", {}).items() if (value or 0) > 1)
        found.append(Summary(who, len(members), lost, over, above))
    return found


def _figures(row: Row, rows: Sequence[Row]) -> dict[str, float | None]:
    """Return what one contender did on one member."""
    others = [other for other in rows if other.problem == row.problem and other.ok]
    seconds, asked = row.median("seconds"), row.contender.method.accuracy
    base = [other.median("seconds") for other in others if str(other.contender) == BASELINE]
    found = {
        "seconds": seconds,
        "slowdown": ratio(seconds, base[0] if base else None),
        "bytes": memory(row),
        **{name: row.largest(name) for name in ("eigenvalue_error", "residual_max")},
        "typical_error": row.largest("eigenvalue_error"),
        **{name: row.largest(name) for name in ("apart", "low")},
    }
    if asked:
        found["over_asked"] = ratio(row.largest("eigenvalue_error"), asked)
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


# --- where the network pays ---

_SAME = 1.05  # times closer than this are equal
_COMPARED = ("seconds", "typical_error")


def leads(rows: Sequence[Row]) -> list[Record]:
    """Compare what begins with the network, at one size, with the rest on its device or the host.

    The best without it in its time, if any, how many times its error that has in the mean, and on
    which models nothing without it is as quick and as near.
    """
    found = {str(one.contender): one for one in summaries(rows) if _compared(one)}
    answers: list[Record] = []
    for one in found.values():
        who = one.contender
        if not who.method.network:
            continue
        others = [
            row
            for row in rows
            if not row.contender.method.network and row.contender.device in ("cpu", who.device)
        ]
        names = dict.fromkeys(str(row.contender) for row in others)
        time, error = (one.over[figure].mean for figure in _COMPARED)
        rivals = [found[name] for name in names if name in found]
        in_time = [o for o in rivals if o.over["seconds"].mean <= _SAME * time]
        best = min(in_time, key=lambda o: o.over["typical_error"].mean, default=None)
        least = max(best.over["typical_error"].mean, ROUNDING) if best else np.inf
        mine = [row for row in rows if row.contender == who and row.values("eigenvalue_error")]
        wins = [row for row in mine if not any(_beats(other, row) for other in others)]
        answers.append(
            {
                "method": str(who),
                "the best in its time": str(best.contender) if best else "none",
                "times its error": least / max(error, ROUNDING),
                **{"pays on": len(wins), "of": len(mine)},
                "models": [str(row.problem) for row in wins],
            }
        )
    return answers


def _compared(one: Summary) -> bool:
    """Whether it solved every model, and its errors are known."""
    return not one.lost and {*_COMPARED} <= one.over.keys()


def _beats(other: Row, row: Row) -> bool:
    """Whether another is as quick on the same model, and as near."""
    times = other.median("seconds"), row.median("seconds")
    errors = other.largest("eigenvalue_error"), row.largest("eigenvalue_error")
    if other.problem != row.problem or None in (*times, *errors):
        return False
    own = max(errors[1], ROUNDING)
    return bool(times[0] <= _SAME * times[1] and errors[0] <= own)  # type: ignore[operator]
