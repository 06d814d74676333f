"""Answers as Markdown for readers, JSON for programs, and figures."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
import torch
from matplotlib.axes import Axes

from measure import figures, paper, tables
from measure.machine import describe_machine, machine_line
from measure.network import per_model
from measure.network.findings import Finding, Row
from measure.network.questions import Answer
from measure.store import Record
from spectra_kit._core.types import Floats
from spectra_kit.show import Page, plot_comparison

ERRORS = {"span": "span error", "vector": "eigenvector error", "value": "eigenvalue error"}
_LINES = 6  # in one panel
_DRAWN = 3  # modes of a shape
_ROUNDING = 1e-10


def write_answer(answer: Answer, folder: Path, *, pictures: Sequence[Path] = ()) -> str:
    """Write ``NAME.json``, ``NAME.md`` and the figures; return the text of the second.

    The `pictures` were drawn before, in ``figures`` in the folder; see `draw_worst`.
    """
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    drawn = [*_draw(answer, folder / "figures"), *pictures]
    links = [str(path.relative_to(folder)) for path in drawn]
    question, rows = answer.question, [row for row in answer.rows if row.cases]
    tables.write_json(
        folder / f"{answer.name}.json",
        {
            "study": answer.name,
            "title": question.title,
            "note": question.note,
            "environment": _machine(),
            "rows": [_row_record(row, answer.name) for row in answer.rows],
            "findings": [_finding_record(finding) for finding in answer.findings],
            "figures": links,
        },
    )
    failures = dict.fromkeys(failure for row in answer.rows for failure in row.failures)
    tell = partial(_error_table, question=answer.name)
    table = {"rotation": _rotation_table, "models": _model_table}.get(answer.name, tell)
    return tables.write_markdown(
        folder / f"{answer.name}.md",
        [
            f"## {question.title}",
            question.note,
            table(rows) if rows else "",
            tables.listed(map(_finding_line, answer.findings)),
            *(f"![{Path(link).stem}]({link})" for link in links),
            "Could not be measured:\n\n" + tables.listed(failures) if failures else "",
        ],
    )


def write_summary(folder: Path, names: Sequence[str]) -> Path:
    """Join the chapters that are there, in the order of their `names`, into ``report.md``."""
    chapters = [folder / f"{name}.md" for name in names]
    texts = [chapter.read_text().strip() for chapter in chapters if chapter.exists()]
    tables.write_markdown(folder / "report.md", ["# Evaluation", machine_line(_machine()), *texts])
    return folder / "report.md"


def _machine() -> Record:
    device = "cuda" if torch.cuda.is_available() else "cpu"
    return describe_machine(threads=torch.get_num_threads(), device=device)


# --- tables ---


def statistics(values: Floats) -> dict[str, float]:
    """Return mean, standard deviation (of the population), median, quartiles and their range."""
    low, median, high = map(float, np.percentile(values, (25, 50, 75)))
    spread = {"median": median, "q25": low, "q75": high, "iqr": high - low}
    return {"mean": float(values.mean()), "std": float(values.std()), **spread}


def _row_record(row: Row, question: str) -> Record:
    """Statistics over cases, per mode, and the mean of each case."""
    record: Record = {
        **row.labels,
        "method": row.method.facts,
        "functions": row.method.columns,
        "failures": row.failures,
    }
    if not row.cases:
        return record
    if theirs := _told_by_paper(question, row):
        record["paper"] = theirs._asdict()
    record |= {"seconds": row.seconds, "exact_seconds": row.exact_seconds}
    record["models_measured"] = [case.shape.name for case in row.cases]
    for error in ERRORS:
        modes = row.modes(error)
        known = ~np.isnan(modes).all(axis=0)
        quartiles = np.full((3, modes.shape[1]), np.nan)
        quartiles[:, known] = np.nanpercentile(modes[:, known], (25, 50, 75), axis=0)
        means = row.means(error)
        of_each = {"of_each": means, "per_mode_quartiles": quartiles}
        record[error] = {**statistics(means), **of_each}
    return record


def _finding_record(finding: Finding) -> Record:
    goals = [{**goal._asdict(), "met": goal.met(finding.value)} for goal in finding.goals]
    return {"text": finding.text, "value": finding.value, "goals": goals}


def _finding_line(finding: Finding) -> str:
    verdicts = [
        f"{'≤' if goal.at_most else '≥'} {tables.number(goal.limit)}"
        f" {'met' if goal.met(finding.value) else 'missed'}"
        for goal in finding.goals
    ]
    goals = f" ({', '.join(verdicts)})" if verdicts else ""
    return f"{finding.text}: **{tables.number(finding.value)}**{goals}"


def _error_table(rows: Sequence[Row], question: str) -> str:
    names = list(rows[0].labels)
    head = [*names, "functions", "clouds"]
    for title in ERRORS.values():
        head += [f"{title}, mean ± std", "median", "IQR"]
    told = [_told_by_paper(question, row) for row in rows]
    head += [f"the paper's {title}" for title in ERRORS.values() if any(told)]
    head += ["seconds", "ARPACK s"]
    lines = []
    for row, theirs in zip(rows, told, strict=True):
        cells = [f"{v:,}" if isinstance(v, int) else v for v in row.labels.values()]
        cells += [str(row.method.columns), str(len(row.cases))]
        for error in ERRORS:
            of = {name: tables.number(x) for name, x in statistics(row.means(error)).items()}
            cells += [f"{of['mean']} ± {of['std']}", of["median"], of["iqr"]]
        if any(told):
            cells += [tables.number(getattr(theirs, error, None)) for error in ERRORS]
        cells += [f"{row.seconds:.2f}", f"{row.exact_seconds:.2f}"]
        lines.append(cells)
    note = paper.note(theirs for theirs in told if theirs)
    return "\n\n".join([tables.table(head, lines), *([note] if note else [])])


def _told_by_paper(question: str, row: Row) -> paper.Told | None:
    """Return the paper's figures where the row is the network's alone, in one pose, unsmoothed."""
    alone = row.method.poses == 1 and row.method.solver is None
    return paper.errors_told(question, row.labels) if alone else None


def _rotation_table(rows: Sequence[Row]) -> str:
    lines = []
    for row in rows:
        means = row.means()
        spread = [f"{means.std() / means.mean():.3f}", f"{means.max() / means.min():.3f}"]
        cells = [*map(str, row.labels.values()), str(len(means)), tables.number(means.mean())]
        lines.append([*cells, *spread])
    head = ["models", "model", "rotations", "mean span error", "std / mean", "max / min"]
    return tables.table(head, lines)


def _model_table(rows: Sequence[Row]) -> str:
    return "\n\n".join(f"### {beside.place}\n\n{_of(beside)}" for beside in per_model.beside(rows))


def _of(beside: per_model.Beside) -> str:
    order, columns = beside.worst_first, beside.columns.items()
    lines = [
        [beside.cases[i].shape.name, *(tables.number(values[i]) for _, values in columns)]
        for i in order
    ]
    for name, pick in (("**mean**", per_model.mean), ("**worst**", per_model.worst)):
        lines.append([name, *(tables.number(pick(*column)) for column in columns)])
    return tables.table(["model", *beside.columns], lines)


# --- figures ---


def _draw(answer: Answer, folder: Path) -> list[Path]:
    """Draw what a question has to show: ``QUESTION-WHAT.png`` each."""
    rows, name = [row for row in answer.rows if row.cases], answer.name
    if name == "models":
        return [
            _ranking(beside, folder / f"models-{_slug(beside.place.models)}.png")
            for beside in per_model.beside(rows)
        ]
    drawn = []
    for place in dict.fromkeys(row.place for row in rows):
        here = [row for row in rows if row.place == place]
        title = str(place)
        points = f"-{place.points}-points" if place.points else ""
        path = folder / f"{name}-{place.models}{points}"
        if name == "rotation":
            drawn.append(_spread(here, title, path.with_name(f"{path.name}.png")))
        else:
            drawn.append(_modes(here, title, path.with_name(f"{path.name}-modes.png")))
    quantity = {"accuracy": "points", "precision": "points", "redundancy": "m"}.get(name, "")
    for models in dict.fromkeys(row.place.models for row in rows if quantity):
        these = [row for row in rows if row.place.models == models]
        if len({row.labels[quantity] for row in these}) > 1:
            drawn.append(_against(these, quantity, folder / f"{name}-{models}-{quantity}.png"))
    return drawn


def draw_worst(answer: Answer, folder: Path, *, count: int = 3) -> list[Path]:
    """Draw the worst modes of the models that `Neo` does worst: exact, predicted, difference."""
    drawn = []
    for beside in per_model.beside(answer.rows):
        for rank, i in enumerate(beside.worst_first[:count], start=1):
            case, error = beside.cases[i], beside.columns[per_model.WORST][i]
            exact, predicted, comparison = answer.study.compare(beside.method, case)
            name = f"worst-{_slug(beside.place.models)}-{rank}-{_slug(case.shape.name)}.png"
            plot_comparison(
                case.geometry(),
                exact,
                predicted,
                comparison,
                path=folder / name,
                modes=[int(mode) for mode in np.argsort(-comparison.span_error)[:_DRAWN]],
                page=Page(
                    f"{case}: the worst of {exact.k} modes",
                    f"{beside.method}; mean eigenvalue error {error:.1e}",
                    dpi=120,
                ),
            )
            drawn.append(folder / name)
    return drawn


def _slug(text: str) -> str:
    return text.replace(", ", "-").replace(" ", "-")


def _modes(rows: Sequence[Row], title: str, path: Path) -> Path:
    """Each error against the mode number: median over cases, and quartiles as a band."""
    figure, axes = figures.panels(title, 3)
    for i, row in enumerate(_best_bandwidths(rows)[:_LINES]):
        for panel, error in zip(axes, ERRORS, strict=True):
            modes = row.modes(error)
            # The constant mode is inside every span up to rounding: nothing for such an axis.
            number = np.flatnonzero((modes > _ROUNDING).all(axis=0))
            name = ", ".join(_told(row, but=("models", "points", "weights")))
            figures.band(panel, number, modes[:, number], name, color=figures.colour(i), lw=1.4)
    for panel, what in zip(axes, ERRORS.values(), strict=True):
        panel.set(title=what, xlabel="mode", yscale="log")
    figures.legend(figure, axes[0])
    return figures.save(figure, path)


def _against(rows: Sequence[Row], quantity: str, path: Path) -> Path:
    """Each error against a number: median over cases, and quartiles as a band."""
    figure, axes = figures.panels(rows[0].place.models, 3)
    lines: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        lines.setdefault(tuple(_told(row, but=("models", quantity, "weights"))), []).append(row)
    kept = _best_bandwidths([line[0] for line in lines.values()])[:_LINES]
    shown = {name: line for name, line in lines.items() if line[0] in kept}
    for i, (name, line) in enumerate(shown.items()):
        at = [int(row.labels[quantity]) for row in line]
        for panel, error in zip(axes, ERRORS, strict=True):
            quartiles = [np.percentile(row.means(error), (25, 50, 75)) for row in line]
            low, median, high = np.transpose(quartiles)
            panel.plot(at, median, color=figures.colour(i), marker="o", label=", ".join(name))
            panel.fill_between(at, low, high, color=figures.colour(i), alpha=0.15, lw=0)
    for panel, what in zip(axes, ERRORS.values(), strict=True):
        panel.set(title=what, xlabel=quantity, yscale="log")
        figures.ticks(panel, [int(row.labels[quantity]) for row in rows])
    figures.legend(figure, axes[0])
    return figures.save(figure, path)


def _ranking(beside: per_model.Beside, path: Path) -> Path:
    """Errors of each model, the worst first."""
    figure, (panel,) = figures.panels(f"{beside.place}, {beside.method}")
    order = beside.worst_first
    for i, name in enumerate(per_model.DRAWN):
        style = figures.dots(i) | {"ls": ""}
        panel.plot(range(len(order)), beside.columns[name][order], label=name, **style)
    _named(panel, [beside.cases[i].shape.name for i in order], "error")
    figures.legend(figure, panel)
    return figures.save(figure, path)


def _spread(rows: Sequence[Row], title: str, path: Path) -> Path:
    """Span error of each shape in each rotation, and their mean."""
    figure, (panel,) = figures.panels(f"{title}, random rotations")
    ranked = sorted(rows, key=lambda row: -row.mean())
    for i, row in enumerate(ranked):
        means = row.means()
        panel.scatter(np.full(len(means), i), means, color=figures.colour(0), s=10, alpha=0.6, lw=0)
        panel.plot([i - 0.3, i + 0.3], [means.mean()] * 2, color=figures.colour(1), lw=1.4)
    _named(panel, [str(row.labels["model"]) for row in ranked])
    return figures.save(figure, path)


def _named(panel: Axes, names: Sequence[str], what: str = "mean span error") -> None:
    panel.set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=7)
    panel.set(ylabel=what, yscale="log")


def _told(row: Row, *, but: Sequence[str]) -> list[str]:
    """Labels as words."""
    shown = {name: value for name, value in row.labels.items() if name not in but}
    return [f"{name} = {v:,}" if isinstance(v, int) else v for name, v in shown.items()]


def _best_bandwidths(rows: Sequence[Row]) -> list[Row]:
    """All networks, and of the methods with plane waves only the best of each size."""
    best: dict[object, Row] = {}
    for row in rows:
        method = row.method
        key = method.name if method.poses else (method.group, method.columns)
        if key not in best or row.mean() < best[key].mean():
            best[key] = row
    return list(best.values())
