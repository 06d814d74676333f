"""Tables and numbers as Markdown, CSV and JSON: the one way reports write them."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from spectra_kit._core.files import atomic_path

NONE = "-"


def number(value: float | None, form: str = ".3g") -> str:
    """Return a value in a format, or a dash for one that is missing."""
    return NONE if value is None or math.isnan(value) else format(value, form)


def ratio(a: float | None, b: float | None) -> float | None:
    """Return a / b, or None where one is missing."""
    return None if a is None or b is None or b == 0 else a / b


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
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


def listed(items: Iterable[str]) -> str:
    """Return a Markdown list."""
    return "\n".join(f"- {item}" for item in items)


def write_markdown(path: Path, parts: Iterable[str]) -> str:
    """Write paragraphs, those that are empty left out, and return the text."""
    text = "\n\n".join(part for part in parts if part) + "\n"
    with atomic_path(path) as part:
        part.write_text(text)
    return text


def write_json(path: Path, record: Mapping[str, Any]) -> Path:
    """Write a record; dataclasses and arrays become JSON, NaN and infinity null."""
    with atomic_path(path) as part:
        part.write_text(json.dumps(plain(record), indent=1, allow_nan=False) + "\n")
    return path


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> Path:
    """Write rows of the same columns, those of the first."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]) if rows else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    with atomic_path(path) as part:
        part.write_text(text.getvalue())
    return path


def plain(value: Any) -> Any:
    """Return a value as JSON has it."""
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
