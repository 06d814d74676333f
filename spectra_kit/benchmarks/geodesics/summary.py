"""What matters, as the worst over the meshes."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from spectra_kit.benchmarks.geodesics.contenders import (
    AUTOMATIC,
    CONTENDERS,
    DIRECT,
    ICPCG,
    ROBUST,
    UNAIDED,
)
from spectra_kit.benchmarks.geodesics.markdown import NONE, table
from spectra_kit.benchmarks.geodesics.records import (
    Record,
    iterations,
    mean_error,
    ratio,
    seconds,
    seconds_in_all,
)

_LARGE = 100_000  # vertices

Measure = Callable[[Record], float | None]


def summary_table(records: Sequence[Record]) -> str:
    """Return the table; how many times faster is as slow as it gets, errors are the largest."""
    rows = [
        _worst(f"{ICPCG} iterations over those of *{name}*", records, min, ".2f", _fewer(name))
        for name in CONTENDERS
        if name.startswith(("additive", "projected"))
    ]
    clocks: dict[str, Measure] = {
        f"*{UNAIDED}*": lambda r: seconds(r, UNAIDED),
        f"*{AUTOMATIC}*, spectrum at hand": lambda r: seconds(r, AUTOMATIC),
        f"*{AUTOMATIC}*, its spectrum counted": lambda r: seconds_in_all(r, AUTOMATIC),
    }
    large = [record for record in records if record["n"] >= _LARGE]
    for note, chosen in (("", records), (f", {_LARGE:,} vertices or more", large)):
        for words, clock in clocks.items():
            label = f"seconds of potpourri3d over {words}: first field{note}"
            rows.append(_worst(label, chosen, min, ".2f", _faster(clock)))
    rows.append(
        _worst(
            f"seconds of *{UNAIDED}* over *{DIRECT}*: many sources",
            records,
            max,
            ".2f",
            lambda r: ratio(seconds(r, UNAIDED, "many"), seconds(r, DIRECT, "many")),
        )
    )
    rows.append(
        _worst(
            "mean error over that of potpourri3d",
            records,
            max,
            ".3f",
            lambda r: ratio(mean_error(r, DIRECT), mean_error(r, ROBUST)),
        )
    )
    rows.append(
        _worst(
            "difference between solvers",
            records,
            max,
            ".1e",
            lambda r: max(max(d) for d in r["differences"].values()),
        )
    )
    return table(["measured", "worst", "on"], rows)


def _fewer(name: str) -> Measure:
    return lambda record: ratio(iterations(record, ICPCG), iterations(record, name))


def _faster(clock: Measure) -> Measure:
    return lambda record: ratio(seconds(record, ROBUST), clock(record))


def _worst(
    label: str,
    records: Sequence[Record],
    pick: Callable[[list[tuple[float, str]]], tuple[float, str]],
    form: str,
    measure: Measure,
) -> list[str]:
    """Return a row: what was measured, the worst, and on which mesh."""
    values = [(measure(record), record["name"]) for record in records]
    there = [(value, name) for value, name in values if value is not None]
    if not there:
        return [label, NONE, NONE]
    value, name = pick(there)
    return [label, format(value, form), name]
