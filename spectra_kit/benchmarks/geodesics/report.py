"""Tables of what was measured, in Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np

from spectra_kit._files import atomic_path
from spectra_kit._version import VERSION
from spectra_kit.benchmarks.geodesics.contenders import (
    AUTOMATIC,
    CONTENDERS,
    DIRECT,
    ICPCG,
    LIBIGL,
    MODES,
    PLAIN,
    ROBUST,
)
from spectra_kit.benchmarks.geodesics.markdown import NONE, number, table
from spectra_kit.benchmarks.geodesics.records import (
    Record,
    iterations,
    mean_error,
    modes_seconds,
    ratio,
    seconds,
    seconds_in_all,
)
from spectra_kit.benchmarks.geodesics.summary import summary_table
from spectra_kit.benchmarks.machine import describe_machine

_PACKAGES = ("potpourri3d", "libigl", "numpy", "scipy", "numba", "cholespy")


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
    machine = describe_machine()
    others = (f"{name} {version(name)}" for name in _PACKAGES)
    versions = ", ".join([f"spectra_kit {VERSION}", *others])
    parts = [
        "# Geodesic distances",
        f"{machine['processor']}, {machine['cores']} cores, {settings['threads']} threads;"
        f" {versions}; code {records[0]['code']}."
        + (" All in one process: the seconds are not comparable." if settings["quick"] else ""),
        "## In short",
        summary_table(records),
        "## Iterations of the Poisson step",
        f"To a relative residual of 1e-8; the median of the sources, and how many times fewer"
        f" than {ICPCG}. What the modes took is not in these counts.",
        _iterations(records),
        "## Seconds to the first field",
        "From the arrays of vertices and faces to the distances from one source: checks,"
        " triangulation, factors or preconditioner, heat and Poisson step; of other packages,"
        f" building the solver and its first solve. Medians of {settings['repeats']} runs, each in"
        " a process of its own, all contenders by turns. Importing and compiling are not counted:"
        " compiled code is kept on disk, and each process solves on a small sphere first."
        " A solver with modes is handed them: *seconds* does not hold what they took. That is"
        f" in *spectrum*, for all {MODES} of them, though automatic takes fewer; the operator is"
        " not counted twice. *In all* is the sum, what someone pays who wants the distance and"
        " nothing else of the spectrum. *Faster* is the time of potpourri3d, robust (its default),"
        " over either.",
        *(_first(record) for record in records),
        "## Seconds for many sources",
        f"{settings['sources']} single sources, asked for at once; the same clock. No solver here"
        " is handed modes.",
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


def _iterations(records: Sequence[Record]) -> str:
    rows = []
    for name in CONTENDERS:
        counts = [iterations(record, name) for record in records]
        if not any(count is not None for count in counts):
            continue
        cells = []
        for record, count in zip(records, counts, strict=True):
            fewer = ratio(iterations(record, ICPCG), count)
            cells.append(NONE if fewer is None else f"{count:.0f} ({fewer:.2f})")
        rows.append([name, *cells])
    return table(["solver", *_titles(records)], rows)


def _first(record: Record) -> str:
    rows = []
    robust = seconds(record, ROBUST)
    for name in CONTENDERS:
        answer = record["first"][name]
        own, whole = seconds(record, name), seconds_in_all(record, name)
        modes = modes_seconds(record, name)
        count = (answer.get("iterations") or [None])[0]
        rows.append(
            [
                name,
                number(own, ".2f"),
                number(ratio(robust, own), ".2f"),
                number(modes or None, ".2f"),
                number(whole, ".2f"),
                number(ratio(robust, whole), ".2f"),
                number(count, "d"),
                *(
                    number(answer.get("stages", {}).get(stage), ".2f")
                    for stage in ("triangulation", "setup", "heat", "poisson")
                ),
                answer.get("choice", "").split(":")[0] or "failed" * ("failure" in answer),
            ]
        )
    header = ["solver", "seconds", "faster", "spectrum", "in all", "faster", "iterations"]
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
                else f"{own:.2f}, {1e3 * own / count:.0f} ms each ({number(against, '.2f')})"
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
                number(value if value is None else 100 * value, ".3g")
                for value in (mean_error(record, name, which) for which in _MEASURES)
            )
            for name in names
        ]
        against = ratio(mean_error(record, DIRECT), mean_error(record, ROBUST))
        rows.append([title, *cells, number(against, ".3f")])
    return table(["mesh", *names, "ratio"], rows)


_MEASURES = ("mean", "weighted", "largest")


def _agreement(records: Sequence[Record]) -> str:
    rows = [
        [name, *(number(max(r["differences"].get(name, [np.nan])), ".1e") for r in records)]
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
