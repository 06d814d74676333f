"""Results of an evaluation as Markdown for readers and JSON for programs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from spectra_kit._files import atomic_path
from spectra_kit._version import VERSION
from spectra_kit.correspondence import FLIP_MARGIN
from spectra_kit.evaluation.matching.figures import draw_accuracy
from spectra_kit.evaluation.matching.protocols import PROTOCOLS, Protocol
from spectra_kit.evaluation.matching.pyfm_peer import PARAMETERS
from spectra_kit.evaluation.matching.runner import Run, Settings
from spectra_kit.evaluation.matching.summaries import Summary, summarize_runs
from spectra_kit.evaluation.matching.table import Task

_DISTANCES = {
    "edges": "geodesic distances along the edges of",
    "exact": "exact geodesic distances on",
}


def write_matching_report(run: Run, settings: Settings, protocol: Protocol) -> Path:
    """Write ``matching.md``, ``matching.json`` and the accuracy curves into the folder.

    Parameters
    ----------
    run : Run
        Of `run_tasks`.
    settings : Settings
        Its settings.
    protocol : Protocol
        Which errors count.

    Returns
    -------
    Path
        The Markdown file.
    """
    folder = settings.folder
    rows = summarize_runs(run.results, protocol)
    record = {
        "version": VERSION,
        "protocol": {"name": protocol.name, "pairs": len(protocol.pairs)},
        "k": settings.k,
        "geodesics": settings.geodesics,
        "summaries": [_plain(row) for row in rows],
        "failures": [{**asdict(task), "reason": why} for task, why in run.failures.items()],
    }
    with atomic_path(folder / "matching.json") as part:
        part.write_text(json.dumps(record, indent=1, allow_nan=False) + "\n")
    with atomic_path(folder / "matching.md") as part:
        part.write_text(_markdown(run, rows, settings, protocol))
    if rows:
        draw_accuracy(run, rows, protocol, folder / "accuracy.png")
    return folder / "matching.md"


_HEADS = (
    "method, spectra",
    "pairs",
    "mean",
    "median",
    "over 8",
    "AUC",
    "direct",
    "symmetric",
    "either",
    "flipped",
    "partly",
    "best finalist",
    "warned",
    "coverage",
    "energy",
    "back",
    "s",
    "CPU s",
)


def _markdown(run: Run, rows: Sequence[Summary], settings: Settings, protocol: Protocol) -> str:
    what = "the smaller of direct and symmetric" if protocol.symmetric else "direct"
    lines = [
        "# Matching",
        "",
        f"{len(protocol.pairs)} pairs ({protocol.name}: {PROTOCOLS[protocol.name]});"
        f" {settings.k} modes; spectra_kit {VERSION}.",
        "",
        f"Errors are {_DISTANCES[settings.geodesics]} the source, in hundredths of the root of"
        f" its area; *mean*, *median*, *over 8* (share of pairs) and *AUC* (up to 10): {what}"
        " errors. *Flipped*: pairs with left for right, whose mean symmetric error is lower than"
        f" the direct one by more than {FLIP_MARGIN:g}; *partly*: others where the smaller error at"
        " each correspondence is lower by as much. Both are blank without a symmetric truth, and"
        " front for back is in neither. *Best finalist*: direct error if, of the map and of the"
        " other candidates that were refined last, finished by plain ZoomOut, the truth chose; no"
        " bound, as the whole method might finish those better."
        " *Warned*: pairs called ambiguous, of those over 8 and of the others. *Coverage*: share of"
        " the source's area hit. *Energy*: Dirichlet, 1 for an isometry."
        " *Back*: mean distance along edges to where the transposed functional map leads back.",
        "",
        "Seconds are medians of one pair, spectra given and nothing else. A pair has one thread,"
        " also with `--jobs 1`; with more, as many pairs run side by side and share the machine,"
        " which lengthens *s*.",
        "",
    ]
    if any(row.method == "pyfm" for row in rows):
        lines += [
            f"pyfm: {PARAMETERS}. `-k` does not change that, only how many modes it solves for.",
            "",
        ]
    lines += [
        "`pairs.csv` remembers a pair by its inputs (meshes, landmarks, modes, weights) and the"
        " release, not by the code: where that has changed since, the lines of before stay until"
        " the file is moved away.",
        "",
    ]
    if rows:
        lines += ["| " + " | ".join(_HEADS) + " |", "|---" * len(_HEADS) + "|"]
        lines += ["| " + " | ".join(_cells(row)) + " |" for row in rows]
        lines += ["", *_relative(rows), "![accuracy](accuracy.png)", ""]
    else:
        lines += ["Nothing was measured.", ""]
    reasons: dict[str, list[Task]] = {}
    for task, why in run.failures.items():
        reasons.setdefault(why, []).append(task)
    if reasons:
        lines += ["Not matched:", ""]
        for why, tasks in reasons.items():
            first = tasks[0]
            who = (
                f"{first.source} to {first.target} ({first.kind}, {first.backend}, {first.method})"
            )
            more = f" and {len(tasks) - 1} more" if len(tasks) > 1 else ""
            lines.append(f"- {who}{more}: {why}")
        lines.append("")
    return "\n".join(lines)


def _plain(row: Summary) -> dict[str, object]:
    """Return the fields as JSON has them: it knows no NaN."""
    return {
        name: None if isinstance(value, float) and not np.isfinite(value) else value
        for name, value in asdict(row).items()
    }


def _cells(row: Summary) -> list[str]:
    def number(value: float, digits: int) -> str:
        return "" if np.isnan(value) else f"{value:.{digits}f}"

    return [
        row.label,
        str(row.pairs),
        f"**{row.mean:.2f}**",
        number(row.median, 2),
        f"{row.bad:.0%}",
        number(row.auc, 3),
        number(row.direct, 2),
        number(row.symmetric, 2),
        number(row.either, 2),
        "" if row.flipped is None else str(row.flipped),
        "" if row.partly is None else str(row.partly),
        number(row.oracle, 2),
        _warned(row),
        number(row.coverage, 2),
        number(row.energy, 2),
        number(row.bijectivity, 2),
        number(row.seconds, 2),
        number(row.cpu_seconds, 2),
    ]


def _warned(row: Summary) -> str:
    """Share of bad pairs with a warning, and of the others."""
    if np.isnan(row.oracle):  # it chooses among nothing
        return ""
    bad = round(row.bad * row.pairs)
    return f"{row.warned}/{bad}, {row.false_alarms}/{row.pairs - bad}"


def _relative(rows: Sequence[Summary]) -> list[str]:
    """How other spectra compare with exact ones, method by method."""
    exact = {(row.kind, row.method): row.mean for row in rows if row.backend == "exact"}
    lines = [
        f"- {row.label}: {row.mean / exact[row.kind, row.method]:.2f} times the mean error with"
        " exact spectra"
        for row in rows
        if row.backend != "exact" and exact.get((row.kind, row.method))
    ]
    return [*lines, ""] if lines else []
