"""The one reporter: what was measured as tidy CSV, and tables of one kind as Markdown and JSON.

What the figures mean is told by hand, in the docstring of each study and in docs/measurements.md.
"""

from __future__ import annotations

import csv
import json
import math
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from spectra_kit._core.files import atomic_path
from spectra_kit.errors import MissingDependencyError
from studies.machine import machine_line
from studies.store import Record
from studies.study import Result

NONE = "-"
_OF_THE_STORE = ("key", "study", "contender", "problem", "repeat", "status", "reason", "files")


@dataclass(frozen=True, eq=False)
class Table:
    """Rows, and which of their values are shown, in which format."""

    title: str
    rows: Sequence[Record]  #: A row with a true ``best`` is told by a bold first cell.
    columns: Mapping[str, str]  #: From the name of a value to its format, "" for text.

    def __str__(self) -> str:
        lines = []
        for row in self.rows:
            first, *others = (cell(row.get(name), form) for name, form in self.columns.items())
            lines.append([f"**{first}**" if row.get("best") else first, *others])
        return aligned(list(self.columns), lines)


def write_report(
    folder: Path,
    name: str,
    results: Iterable[Result[Any, Any]],
    tables: Iterable[Table],
    machine: Record,
    *,
    figures: Iterable[Path] = (),
    **told: object,
) -> Path:
    """Write ``NAME.csv``, ``NAME.json`` and ``NAME.md``, print the last, and return it.

    The CSV has a line for each measurement (see `tidy`); the others have the tables that have rows,
    what failed and why, and the machine; the JSON also what else is told.
    """
    measured, shown = list(results), [table for table in tables if table.rows]
    folder.mkdir(parents=True, exist_ok=True)
    failed = failures(measured)
    write_csv(folder / f"{name}.csv", [tidy(result) for result in measured])
    record = {"machine": machine, **told, "tables": {t.title: t.rows for t in shown}}
    with atomic_path(folder / f"{name}.json") as part:
        part.write_text(json.dumps(plain({**record, "failed": failed}), indent=1) + "\n")
    parts = [f"# {name}", machine_line(machine)]
    for table in (*shown, Table("Not measured", failed, dict.fromkeys(_FAILED, ""))):
        if table.rows:
            parts += [f"## {table.title}", str(table)]
    links = [path.relative_to(folder) for path in figures]
    path = folder / f"{name}.md"
    with atomic_path(path) as part:
        part.write_text("\n\n".join([*parts, *(f"![{x.stem}]({x})" for x in links)]) + "\n")
    print(path.read_text())
    print("written:", path, *(folder / link for link in links), sep="\n  ", flush=True)
    return path


_FAILED = ("contender", "reason", "problems")


def failures(results: Iterable[Result[Any, Any]]) -> list[Record]:
    """Return what was not measured, those of one reason together."""
    reasons: dict[tuple[str, str], dict[str, None]] = {}
    for result in results:
        if not result.ok:
            where = reasons.setdefault((str(result.contender), result.reason), {})
            where[str(result.problem)] = None
    return [dict(zip(_FAILED, (*why, "; ".join(at)), strict=True)) for why, at in reasons.items()]


def tidy(result: Result[Any, Any]) -> Record:
    """Return a measurement as a line of a table: who, on what, and each value in its column.

    Values within values are named by both, with a dot; a list of numbers is one cell.
    """
    line: Record = {
        "contender": str(result.contender),
        "problem": str(result.problem),
        "repeat": result.repeat,
        "status": result.record["status"],
        "reason": result.reason,
        "key": result.record.get("key", ""),
    }
    for name, value in result.record.items():
        if name not in _OF_THE_STORE:
            _flatten(name, value, line)
    return line


def _flatten(name: str, value: Any, line: Record) -> None:
    items: Iterable[tuple[object, Any]]
    if isinstance(value, Mapping):
        items = value.items()
    elif isinstance(value, list) and any(isinstance(item, dict | list) for item in value):
        items = enumerate(value)
    else:
        line[name] = " ".join(map(cell, value)) if isinstance(value, list) else value
        return
    for key, item in items:
        _flatten(f"{name}.{key}", item, line)


def cell(value: Any, form: str = "") -> str:
    """Return a value as text, a dash for one that is missing."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return NONE
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        return str(value)
    return format(value, form or ("d" if isinstance(value, int | np.integer) else ".5g"))


@contextmanager
def unless_missing(what: str) -> Iterator[None]:
    """Tell what is not drawn, where a package for it is missing."""
    try:
        yield
    except MissingDependencyError as error:
        print(f"{what} not drawn: {error}", file=sys.stderr)


def ratio(a: float | None, b: float | None) -> float | None:
    """Return a / b, or None where one is missing."""
    return None if a is None or b is None or b == 0 else a / b


def aligned(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table with aligned columns, the first to the left; no newline ends it."""
    lines = [[cell.replace("|", r"\|") for cell in line] for line in (header, *rows)]
    width = [max(2, *(len(line[i]) for line in lines)) for i in range(len(header))]

    def text(cells: Sequence[str]) -> str:
        padded = [
            cell.rjust(w) if i else cell.ljust(w)
            for i, (cell, w) in enumerate(zip(cells, width, strict=True))
        ]
        return "| " + " | ".join(padded) + " |"

    rule = ["-" * (w - 1) + ":" if i else ":" + "-" * (w - 1) for i, w in enumerate(width)]
    return "\n".join([text(lines[0]), text(rule), *map(text, lines[1:])])


def write_csv(path: Path, rows: Sequence[Record]) -> None:
    """Write rows, with all columns that any of them has."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    with atomic_path(path) as part, part.open("w", newline="") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def plain(value: Any) -> Any:
    """Return a value as JSON has it: records for dataclasses, null for NaN and infinity."""
    if is_dataclass(value) and not isinstance(value, type):
        value = asdict(value)
    if isinstance(value, Mapping):
        return {str(name): plain(item) for name, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple | set):
        return [plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value
