"""What a run leaves in its folder: checkpoints, read only as they were written, and a log."""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, Self

import torch
from torch import Tensor

from spectra_kit._core.files import atomic_path
from spectra_kit._core.optional import optional
from spectra_kit.errors import InvalidInputError

NAME = "checkpoint.pt"
FIELDS = ("step", "samples", "seconds", "lr", "rate", "loss", "validation", "smoothed")
Row = dict[str, float]
# Optimiser states stand in the order of the network's parameters; where that, or what a checkpoint
# holds, changes, this does, and older ones are refused.
_FORMAT = b"spectra_kit checkpoint 3"
_DIGEST = hashlib.sha256().digest_size


class Writer:
    """Writes checkpoints into a folder from a thread, one at a time; leaving waits for the last."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._thread = ThreadPoolExecutor(1)
        self._last: Future[None] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        self._thread.shutdown()
        if self._last is not None and error is None:
            self._last.result()

    @property
    def busy(self) -> bool:
        """Whether the last checkpoint is still on its way to the disk."""
        return self._last is not None and not self._last.done()

    def write(self, content: dict[str, Any]) -> None:
        """Copy the tensors of `content` now, and write them meanwhile."""
        if self._last is not None:
            self._last.result()  # an error of the last write must not pass unseen
        snapshot = _copied(content)
        self._last = self._thread.submit(write, self._folder, snapshot)


def write(folder: Path, content: dict[str, Any]) -> None:
    """Write ``checkpoint.pt`` into a folder: as PyTorch writes it, then a sha256 of that."""
    buffer = io.BytesIO()
    torch.save(content, buffer)
    with atomic_path(folder / NAME) as path:
        path.write_bytes(buffer.getvalue() + _digest(buffer.getvalue()))


def read(folder: Path) -> dict[str, Any] | None:
    """Return the content of the checkpoint in a folder; None where there is none."""
    path = folder / NAME
    if not path.is_file():
        return None
    data = path.read_bytes()
    body, digest = data[:-_DIGEST], data[-_DIGEST:]
    if _digest(body) != digest:  # PyTorch, which compares no checksum, sees whole ones
        raise InvalidInputError(
            f"{path} must end in the sha256 of its {len(body)} bytes, and does not: it was"
            " damaged, or written by an older version",
            advice="begin the run again, or put a copy of it there",
        )
    content: dict[str, Any] = torch.load(io.BytesIO(body), map_location="cpu", weights_only=True)
    return content


def _digest(body: bytes) -> bytes:
    return hashlib.sha256(_FORMAT + body).digest()


def _copied(content: Any) -> Any:
    """Return nested dicts, lists and tuples with a copy of every tensor, on the CPU."""
    if isinstance(content, Tensor):
        return content.detach().to("cpu", copy=True)
    if isinstance(content, dict):
        return {key: _copied(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return type(content)(map(_copied, content))
    return content


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
