"""The log of a run: rows in memory, in a CSV file, and as TensorBoard events."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Self

from spectra_kit._core.files import atomic_path
from spectra_kit._core.optional import optional

FIELDS = ("step", "samples", "seconds", "lr", "rate", "loss", "validation", "smoothed")
Row = dict[str, float]


class Log:
    """Writes ``log.csv`` into a folder, row by row, and event files beside it if asked to.

    Of `rows`, those that a resumed run had logged up to its checkpoint, later ones are dropped.
    """

    def __init__(self, folder: Path, rows: Iterable[Row], *, tensorboard: bool = False) -> None:
        path, rows = folder / "log.csv", list(rows)
        self._events: Any = None
        if tensorboard:
            board = optional(
                "torch.utils.tensorboard", extra="tensorboard", needed_by="a run with event files"
            )
            purge = int(rows[-1]["step"]) + 1 if rows else 0
            self._events = board.SummaryWriter(str(folder / "events"), purge_step=purge)
        with atomic_path(path) as part, part.open("w", newline="") as file:
            writer = csv.DictWriter(file, FIELDS)
            writer.writeheader()
            writer.writerows(rows)
        self._file = path.open("a", newline="")
        self._csv = csv.DictWriter(self._file, FIELDS)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()
        if self._events is not None:
            self._events.close()

    def add(self, row: Row) -> None:
        """Write one row; values that it lacks stay empty."""
        self._csv.writerow(row)
        self._file.flush()
        if self._events is not None:
            for name in row.keys() - {"step"}:
                self._events.add_scalar(name, row[name], int(row["step"]))
