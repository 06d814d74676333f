"""Tables of what was measured, in Markdown."""

from __future__ import annotations

import os
import platform
import statistics
from collections.abc import Iterable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from spectra_kit._files import atomic_path
from spectra_kit.evaluation.geodesics.contenders import (
    AUTOMATIC,
    CONTENDERS,
    DIRECT,
    ICPCG,
    LIBIGL,
    PLAIN,
    ROBUST,
)

Record = dict[str, Any]

_NONE = "-"
_PACKAGES = ("spectra_kit", "potpourri3d", "libigl", "numpy", "scipy", "numba", "cholespy")


def write_geodesic_report(records: Sequence[Record], ball: Record, path: Path) -> str:
    """Write all tables into a file, and return them.

    Parameters
    ----------
    records : sequence of dict
        Of `measure_mesh`, at least one.
    ball : dict
        Of `measure_ball`.
    path : Path
        The file; its folder must exist.

    Returns
    -------
    str
        Markdown.
    """
    settings = records[0]["settings"]
    versions = ", ".join(f"{name} {version(name)}" for name in _PACKAGES)
    parts = [
        "# Geodesic distances",
        f"{_processor()}, {settings['threads']} threads; {versions}."
        + (" All in one process: the seconds are not comparable." if settings["quick"] else ""),
        "## In short",
        _summary(records),
        "## Iterations of the Poisson step",
        f"To a relative residual of 1e-8; the median of the sources, and how many times fewer"
        f" than {ICPCG}.",
        _iterations(records),
        "## Seconds to the first field",
        "From the arrays of vertices and faces to the distances from one source: checks,"
        " triangulation, factors or preconditioner, heat and Poisson step; of other packages,"
        f" building the solver and its first solve. Medians of {settings['repeats']} runs, each in"
        " a process of its own, all contenders by turns. Importing and compiling are not counted:"
        " compiled code is kept on disk, and each process solves on a small sphere first. The"
        " seconds of the spectrum, which serves other ends too, stand beside, and are added in the"
        " column after. *Faster* is the time of potpourri3d, robust (its default), over that of"
        " the row.",
        *(_first(record) for record in records),
        "## Seconds for many sources",
        f"{settings['sources']} single sources, asked for at once; the same clock.",
        _many(records),
        "## Errors against exact distances",
        "Relative errors |d - d*| / d* in per cent, the sources aside: mean over vertices / mean"
        " over the surface / largest; averaged over sources, half of them drawn at random, half"
        " far from those before. *Ratio* is the mean over vertices of the direct solver over that"
        " of potpourri3d, robust.",
        _errors(records),
        "## Agreement of the solvers",
        "Largest difference from the fields of the direct solver, over the largest distance.",
        _agreement(records),
        "## The unit sphere",
        "Mean (largest) relative errors against arcs in per cent, and the rate: the power of"
        " 1/sqrt(n) with which the mean error falls from the first to the last.",
        _ball(ball),
    ]
    text = "\n\n".join(parts) + "\n"
    with atomic_path(path) as part:
        part.write_text(text)
    return text


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table, its columns aligned; the first to the left.

    Examples
    --------
    >>> print(table(["mesh", "n"], [["bunny", "7"]]))
    | mesh  |  n |
    | :---- | -: |
    | bunny |  7 |
    """
    lines = [list(header), *map(list, rows)]
    width = [max(2, *(len(line[i]) for line in lines)) for i in range(len(header))]

    def text(cells: Sequence[str]) -> str:
        padded = [
            cell.rjust(w) if i else cell.ljust(w)
            for i, (cell, w) in enumerate(zip(cells, width, strict=True))
        ]
        return "| " + " | ".join(padded) + " |"

    rule = ["-" * (w - 1) + ":" if i else ":" + "-" * (w - 1) for i, w in enumerate(width)]
    return "\n".join([text(lines[0]), text(rule), *map(text, lines[1:])])


def iterations(record: Record, name: str) -> float | None:
    """Return the median iterations of a contender on a mesh; None where it does not iterate."""
    counts = [count for count in record["iterations"].get(name, []) if count is not None]
    return statistics.median(counts) if counts else None


def mean_error(record: Record, name: str, which: str = "mean") -> float | None:
    """Return an error of a contender on a mesh, averaged over sources; None where it failed."""
    errors = record["errors"][name]
    return None if "failure" in errors else statistics.fmean(error[which] for error in errors)


def seconds(record: Record, name: str, what: str = "first") -> float | None:
    """Return the seconds of a contender on a mesh; None where it failed."""
    found: float | None = record[what][name].get("seconds")
    return found


def ratio(a: float | None, b: float | None) -> float | None:
    """Return a / b, or None where one is missing."""
    return None if a is None or b is None or b == 0 else a / b


def _summary(records: Sequence[Record]) -> str:
    """Say what matters, as the worst over the meshes."""

    def of(values: Iterable[tuple[float | None, Record]], pick: Any, form: str) -> list[str]:
        there = [(value, record["name"]) for value, record in values if value is not None]
        if not there:
            return [_NONE, _NONE]
        value, name = pick(there)
        return [format(value, form), name]

    def fewer(name: str) -> list[str]:
        values = ((ratio(iterations(r, ICPCG), iterations(r, name)), r) for r in records)
        return of(values, min, ".2f")

    rows = [
        [f"{ICPCG} iterations over those of *{name}*", *fewer(name)]
        for name in CONTENDERS
        if name.startswith(("additive", "projected"))
    ]
    large = [record for record in records if record["n"] >= 100_000]
    for label, chosen in (("", records), (", 100,000 vertices or more", large)):
        values = ((ratio(seconds(r, ROBUST), seconds(r, AUTOMATIC)), r) for r in chosen)
        label = f"seconds of potpourri3d over *{AUTOMATIC}*, first field{label}"
        rows.append([label, *of(values, min, ".2f")])
    rows.append(
        [
            f"seconds of *{AUTOMATIC}* over *{DIRECT}*, many sources",
            *of(
                (
                    (ratio(seconds(r, AUTOMATIC, "many"), seconds(r, DIRECT, "many")), r)
                    for r in records
                ),
                max,
                ".2f",
            ),
        ]
    )
    rows.append(
        [
            "mean error over that of potpourri3d",
            *of(
                ((ratio(mean_error(r, DIRECT), mean_error(r, ROBUST)), r) for r in records),
                max,
                ".3f",
            ),
        ]
    )
    rows.append(
        [
            "difference between solvers",
            *of(
                ((max(max(d) for d in r["differences"].values()), r) for r in records),
                max,
                ".1e",
            ),
        ]
    )
    return table(["measured", "worst", "on"], rows)


def _iterations(records: Sequence[Record]) -> str:
    rows = []
    for name in CONTENDERS:
        counts = [iterations(record, name) for record in records]
        if not any(count is not None for count in counts):
            continue
        cells = []
        for record, count in zip(records, counts, strict=True):
            fewer = ratio(iterations(record, ICPCG), count)
            cells.append(_NONE if fewer is None else f"{count:.0f} ({fewer:.2f})")
        rows.append([name, *cells])
    return table(["solver", *_titles(records)], rows)


def _first(record: Record) -> str:
    rows = []
    robust = seconds(record, ROBUST)
    for name, contender in CONTENDERS.items():
        answer = record["first"][name]
        own = seconds(record, name)
        spectrum = record["spectra"].get(contender.spectrum, 0.0)
        # A solver that has chosen to do without the modes has not used their time.
        used = spectrum if not answer.get("choice", "").startswith("direct") else 0.0
        count = (answer.get("iterations") or [None])[0]
        rows.append(
            [
                name,
                _number(own, ".2f"),
                _number(ratio(robust, own), ".2f"),
                _number(used or None, ".2f"),
                _number(None if own is None else own + used, ".2f"),
                _number(count, "d"),
                *(
                    _number(answer.get("stages", {}).get(stage), ".2f")
                    for stage in ("triangulation", "setup", "heat", "poisson")
                ),
                answer.get("choice", "").split(":")[0] or "failed" * ("failure" in answer),
            ]
        )
    header = ["solver", "seconds", "faster", "spectrum", "with it", "iterations"]
    header += ["triangulation", "setup", "heat", "Poisson", "chosen"]
    return f"### {_titles([record])[0]}\n\n" + table(header, rows)


def _many(records: Sequence[Record]) -> str:
    names = list(records[0]["many"])
    rows = []
    for name in names:
        cells = []
        for record in records:
            own = seconds(record, name, "many")
            count = record["settings"]["sources"]
            against = ratio(own, seconds(record, DIRECT, "many"))
            cells.append(
                "failed"
                if own is None
                else f"{own:.2f}, {1e3 * own / count:.0f} ms each ({_number(against, '.2f')})"
            )
        rows.append([name, *cells])
    note = f"In brackets: over *{DIRECT}*."
    return f"{note}\n\n{table(['solver', *_titles(records)], rows)}"


def _errors(records: Sequence[Record]) -> str:
    names = [DIRECT, AUTOMATIC, ROBUST, PLAIN, LIBIGL]
    rows = []
    for record, title in zip(records, _titles(records), strict=True):
        cells = [
            " / ".join(
                _number(value if value is None else 100 * value, ".3g")
                for value in (mean_error(record, name, which) for which in _MEASURES)
            )
            for name in names
        ]
        against = ratio(mean_error(record, DIRECT), mean_error(record, ROBUST))
        rows.append([title, *cells, _number(against, ".3f")])
    return table(["mesh", *names, "ratio"], rows)


_MEASURES = ("mean", "weighted", "largest")


def _agreement(records: Sequence[Record]) -> str:
    rows = [
        [name, *(_number(max(r["differences"].get(name, [np.nan])), ".1e") for r in records)]
        for name in CONTENDERS
        if any(name in record["differences"] for record in records)
    ]
    return table(["solver", *_titles(records)], rows)


def _ball(ball: Record) -> str:
    rows = []
    for kind in ("mesh", "cloud"):
        for name, errors in ball[kind].items():
            cells = [
                f"{100 * mean:.3g} ({100 * largest:.3g})"
                for mean, largest in zip(errors["mean"], errors["largest"], strict=True)
            ]
            ends = np.log(errors["mean"])[[0, -1]], 0.5 * np.log(ball["points"])[[0, -1]]
            rate = float(-(ends[0][1] - ends[0][0]) / (ends[1][1] - ends[1][0]))
            rows.append([f"{kind}: {name}", *cells, f"{rate:.2f}"])
    return table(["geometry: solver", *(f"{n:,}" for n in ball["points"]), "rate"], rows)


def _titles(records: Sequence[Record]) -> list[str]:
    return [f"{record['name']} ({record['n']:,})" for record in records]


def _number(value: float | None, form: str) -> str:
    return _NONE if value is None else format(value, form)


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return f"{names[0] if names else platform.machine()}, {os.cpu_count()} cores"
