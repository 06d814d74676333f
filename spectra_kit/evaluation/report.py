"""Answers as Markdown for readers and JSON for programs."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from spectra_kit._files import atomic_path
from spectra_kit._types import Floats
from spectra_kit._version import VERSION
from spectra_kit.evaluation.curves import Curve, training_curve
from spectra_kit.evaluation.figures import draw, draw_curves
from spectra_kit.evaluation.findings import Finding, Row, undominated
from spectra_kit.evaluation.methods import Weights, check_names
from spectra_kit.evaluation.studies import Answer

_ERRORS = {"span": "span error", "vector": "eigenvector error", "value": "eigenvalue error"}
Cells = list[list[str]]


def write_report(
    answer: Answer, folder: str | os.PathLike[str], *, pictures: Sequence[Path] = ()
) -> Path:
    """Write ``NAME.json``, ``NAME.md`` and the figures of a study.

    Parameters
    ----------
    answer : Answer
        Of `run_study`.
    folder : path
        Made if missing; figures go into ``figures`` in it.
    pictures : sequence of Path, optional
        Drawn before, in that folder; see `draw_worst`.

    Returns
    -------
    Path
        The Markdown file.
    """
    root = Path(folder)
    figures = root / "figures"
    figures.mkdir(parents=True, exist_ok=True)
    drawn = [*draw(answer, figures), *pictures]
    links = [str(path.relative_to(root)) for path in drawn]
    record = {
        "study": answer.name,
        "title": answer.study.title,
        "note": answer.study.note,
        "environment": environment(),
        "rows": [row_record(row) for row in answer.rows],
        "findings": [finding_record(finding) for finding in answer.findings],
        "figures": links,
    }
    with atomic_path(root / f"{answer.name}.json") as part:
        part.write_text(json.dumps(record, indent=1))
    path = root / f"{answer.name}.md"
    with atomic_path(path) as part:
        part.write_text(markdown(answer, links))
    return path


def write_training(weights: Sequence[Weights], folder: str | os.PathLike[str]) -> Path:
    """Write ``training.json``, ``training.md`` and a figure: span error against samples seen.

    Nothing is solved: the validations are in the weights files.

    Parameters
    ----------
    weights : sequence of Weights
        One line each.
    folder : path
        As for `write_report`.

    Returns
    -------
    Path
        The Markdown file.

    Raises
    ------
    InvalidInputError
        If a file records no validation, or two are called the same.

    Examples
    --------
    >>> import tempfile
    >>> from spectra_kit.evaluation import Weights, write_training
    >>> print(write_training([Weights("small")], tempfile.mkdtemp()).name)
    training.md
    """
    check_names(weights)
    curves = [training_curve(w) for w in weights]
    root = Path(folder)
    (root / "figures").mkdir(parents=True, exist_ok=True)
    figure = str(draw_curves(curves, root / "figures").relative_to(root))
    title = "Validation error against samples seen"
    record = {
        "study": "training",
        "title": title,
        "curves": [curve_record(curve) for curve in curves],
        "figures": [figure],
    }
    with atomic_path(root / "training.json") as part:
        part.write_text(json.dumps(record, indent=1))
    note = (
        "Mean span error of the validation samples during training; `exponent` is the slope between"
        " the first and the last validation on logarithmic axes."
    )
    parts = [f"## {title}", note, _table(_curves_table(curves)), f"![training]({figure})"]
    path = root / "training.md"
    with atomic_path(path) as part:
        part.write_text("\n\n".join(parts) + "\n")
    return path


def curve_record(curve: Curve) -> dict[str, object]:
    """Return a curve as JSON."""
    slope = None if np.isnan(curve.exponent) else curve.exponent
    points = {"samples": curve.samples.tolist(), "span_error": curve.errors.tolist()}
    return {"weights": curve.name, "m": curve.m, **points, "exponent": slope}


def environment() -> dict[str, object]:
    """Return what the times depend on."""
    cuda = torch.cuda.is_available()
    return {
        "spectra_kit": VERSION,
        "torch": torch.__version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
        "cores": os.cpu_count(),
        "threads": torch.get_num_threads(),
        "accelerator": torch.cuda.get_device_name() if cuda else None,
    }


def row_record(row: Row) -> dict[str, object]:
    """Return a row as JSON: statistics over models, per mode, and each model's own mean."""
    record: dict[str, object] = {
        **row.labels,
        "method": row.method.key,
        "functions": row.method.columns,
        "failures": list(row.failures),
    }
    if not row.measured:
        return record
    record |= {"seconds": row.seconds(), "exact_seconds": row.exact_seconds()}
    record["models_measured"] = [case.model.name for case, _ in row.measured]
    for error in _ERRORS:
        modes = np.array([getattr(measurement, error) for measurement in row.measurements])
        known = ~np.isnan(modes).all(axis=0)
        quartiles = np.full((3, modes.shape[1]), np.nan)
        quartiles[:, known] = np.nanpercentile(modes[:, known], (25, 50, 75), axis=0)
        record[error] = {
            **statistics(row.means(error)),
            "of_each": row.means(error).tolist(),
            "per_mode_quartiles": [[None if np.isnan(x) else x for x in q] for q in quartiles],
        }
    return record


def statistics(values: Floats) -> dict[str, float]:
    """Return mean, standard deviation (of the population), median, quartiles and their range."""
    low, median, high = np.percentile(values, (25, 50, 75))
    return {
        "mean": float(values.mean()),
        "std": float(values.std()),
        "median": float(median),
        "q25": float(low),
        "q75": float(high),
        "iqr": float(high - low),
    }


def finding_record(finding: Finding) -> dict[str, object]:
    """Return a finding as JSON."""
    goals = [
        {"limit": goal.limit, "at_most": goal.at_most, "met": goal.met(finding.value)}
        for goal in finding.goals
    ]
    return {"text": finding.text, "value": finding.value, "goals": goals}


def markdown(answer: Answer, figures: Sequence[str] = ()) -> str:
    """Return a study as a chapter: note, table, findings, figures, what failed."""
    tables = {"rotation": _rotation_table, "worst": _worst_table}
    rows = [row for row in answer.rows if row.measured]
    parts = [f"## {answer.study.title}", answer.study.note]
    if rows:
        parts.append(_table(tables.get(answer.name, _error_table)(rows)))
    if answer.findings:
        parts.append("\n".join(f"- {_finding_line(finding)}" for finding in answer.findings))
    parts += [f"![{Path(figure).stem}]({figure})" for figure in figures]
    failures = [failure for row in answer.rows for failure in row.failures]
    if failures:
        unique = dict.fromkeys(failures)
        parts.append("Could not be measured:\n\n" + "\n".join(f"- {line}" for line in unique))
    return "\n\n".join(parts) + "\n"


def _error_table(rows: Sequence[Row]) -> Cells:
    names = list(rows[0].labels)
    timed = "solver" in names
    head = [*names, "functions", "clouds"]
    for title in _ERRORS.values():
        head += [f"{title}, mean ± std", "median", "IQR"]
    head += ["seconds", "ARPACK s"]
    table = [head + ["fast"] * timed]
    quick = undominated(rows) if timed else []
    for row in rows:
        cells = [_cell(row.labels[name]) for name in names]
        cells += [str(row.method.columns), str(len(row.measured))]
        for error in _ERRORS:
            values = statistics(row.means(error))
            cells += [f"{number(values['mean'])} ± {number(values['std'])}"]
            cells += [number(values["median"]), number(values["iqr"])]
        cells += [f"{row.seconds():.2f}", f"{row.exact_seconds():.2f}"]
        table.append(cells + ["yes" if row in quick else ""] * timed)
    return table


def _rotation_table(rows: Sequence[Row]) -> Cells:
    table = [["models", "model", "rotations", "mean span error", "std / mean", "max / min"]]
    for row in rows:
        means = row.means("span")
        table.append([str(row.labels["models"]), str(row.labels["model"]), str(len(means))])
        table[-1] += [number(means.mean()), f"{means.std() / means.mean():.3f}"]
        table[-1] += [f"{means.max() / means.min():.3f}"]
    return table


def _worst_table(rows: Sequence[Row]) -> Cells:
    table = [["models", "model", "span error", "eigenvector error", "eigenvalue error"]]
    table[0] += ["worst mode", "its span error"]
    for row in rows:
        for case, m in sorted(row.measured, key=lambda pair: -pair[1].mean("span")):
            table.append([str(row.labels["models"]), case.model.name])
            table[-1] += [number(m.mean(error)) for error in _ERRORS]
            table[-1] += [str(m.worst_mode), number(float(m.span[m.worst_mode]))]
    return table


def _curves_table(curves: Sequence[Curve]) -> Cells:
    table = [["weights", "m", "validations", "samples, first", "span error", "samples, last"]]
    table[0] += ["span error", "least", "exponent"]
    for curve in curves:
        table.append([curve.name, str(curve.m), str(len(curve.samples))])
        for i in (0, -1):
            table[-1] += [f"{curve.samples[i]:,.0f}", number(float(curve.errors[i]))]
        slope = "" if np.isnan(curve.exponent) else f"{curve.exponent:.2f}"
        table[-1] += [number(float(curve.errors.min())), slope]
    return table


def _table(cells: Cells) -> str:
    head, *body = cells
    lines = [head, ["---"] * len(head), *body]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _finding_line(finding: Finding) -> str:
    verdicts = [
        f"{'≤' if goal.at_most else '≥'} {number(goal.limit)}"
        f" {'met' if goal.met(finding.value) else 'missed'}"
        for goal in finding.goals
    ]
    goals = f" ({', '.join(verdicts)})" if verdicts else ""
    return f"{finding.text}: **{number(finding.value)}**{goals}"


def _cell(value: Any) -> str:
    return f"{value:,}" if isinstance(value, int) else str(value)


def number(value: float) -> str:
    """Three digits, like 8.81e-3, 0.105 or 12.3."""
    if value == 0 or 0.1 <= abs(value) < 1000:
        return f"{value:.3g}"
    digits, exponent = f"{value:.2e}".split("e")
    return f"{digits}e{int(exponent)}"


def write_summary(folder: str | os.PathLike[str], names: Sequence[str]) -> Path:
    """Join the chapters that `write_report` wrote into ``report.md``.

    Parameters
    ----------
    folder : path
        Where they lie.
    names : sequence of str
        Studies, in the order of the chapters; those that were never written are left out.

    Returns
    -------
    Path
        The joined file.
    """
    root = Path(folder)
    chapters = [root / f"{name}.md" for name in names]
    texts = [chapter.read_text() for chapter in chapters if chapter.exists()]
    machine = ", ".join(f"{name} {value}" for name, value in environment().items())
    path = root / "report.md"
    with atomic_path(path) as part:
        part.write_text(f"# Evaluation\n\n{machine}\n\n" + "\n".join(texts))
    return path
