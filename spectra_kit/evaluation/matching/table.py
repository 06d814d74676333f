"""`PairTable`: one line of CSV for each matched pair, written as it comes, read after a crash."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from spectra_kit._files import atomic_path
from spectra_kit.errors import InvalidInputError
from spectra_kit.evaluation.matching.measure import PairResult

_ARRAYS = ("accuracy", "accuracy_either")


@dataclass(frozen=True)
class Task:
    """One pair to match in one way.

    Attributes
    ----------
    source, target : str
        Names of subjects.
    kind : str
        "mesh" or "cloud".
    backend, method : str
        Whose spectra, and what matches them.
    """

    source: str
    target: str
    kind: str
    backend: str
    method: str


_TASK = [f.name for f in fields(Task)]
_NUMBERS = [f.name for f in fields(PairResult)]
_COLUMNS = [*_TASK, "digest", *_NUMBERS]


class PairTable:
    """Results by task, in a CSV file that grows line by line.

    Parameters
    ----------
    path : Path
        There or not; a last line that a crash cut short is dropped.

    Raises
    ------
    InvalidInputError
        If the file is no such table.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from spectra_kit.evaluation.matching import PairTable, Task
    >>> path = Path(tempfile.mkdtemp()) / "pairs.csv"
    >>> PairTable(path).get(Task("a", "b", "mesh", "exact", "wks-zoomout"), "0") is None
    True
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._results: dict[tuple[Task, str], PairResult] = {}
        if not path.exists():
            with atomic_path(path) as part:
                part.write_text(_line(_COLUMNS))
        text = path.read_text()
        if not text.endswith("\n"):  # cut short by a crash: measured again
            text = text[: text.rfind("\n") + 1]
            with atomic_path(path) as part:
                part.write_text(text)
        rows = csv.DictReader(io.StringIO(text))
        if rows.fieldnames != _COLUMNS:
            raise InvalidInputError(
                f"{path} must be a table of matched pairs of this version, got columns"
                f" {rows.fieldnames}; move the file away"
            )
        for number, row in enumerate(rows, start=2):
            try:
                task = Task(**{name: row[name] for name in _TASK})
                self._results[task, row["digest"]] = _parsed(row)
            except (ValueError, TypeError, AttributeError) as error:
                raise InvalidInputError(
                    f"line {number} of {path} must be a matched pair, got something else"
                    f" ({error}); remove the line"
                ) from error

    def get(self, task: Task, digest: str) -> PairResult | None:
        """Return what was measured of a task on the inputs that `digest` stands for."""
        return self._results.get((task, digest))

    def add(self, task: Task, digest: str, result: PairResult) -> None:
        """Append a result."""
        values = [*(getattr(task, name) for name in _TASK), digest]
        with self.path.open("a", newline="") as file:
            file.write(_line([*values, *(_text(getattr(result, name)) for name in _NUMBERS)]))
        self._results[task, digest] = result


def _line(values: Iterable[str]) -> str:
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerow(values)
    return buffer.getvalue()


def _text(value: object) -> str:
    if isinstance(value, np.ndarray):
        return " ".join(f"{x:.5g}" for x in value)
    return str(int(value)) if isinstance(value, bool) else f"{value:.7g}"


def _parsed(row: dict[str, str]) -> PairResult:
    values: dict[str, object] = {name: float(row[name]) for name in _NUMBERS if name not in _ARRAYS}
    values |= {name: bool(values[name]) for name in ("flipped", "ambiguous")}
    values |= {name: np.array(row[name].split(), dtype=np.float64) for name in _ARRAYS}
    return PairResult(**values)  # type: ignore[arg-type]
