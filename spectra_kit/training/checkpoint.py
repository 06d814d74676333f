"""Checkpoints: written whole, and beside the loop."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, Self

import torch
from torch import Tensor

from spectra_kit._files import atomic_path
from spectra_kit.errors import InvalidInputError

NAME = "checkpoint.pt"
_DIGEST = hashlib.sha256().digest_size


class Writer:
    """Writes checkpoints from a thread, one at a time; leaving it waits for the last.

    Parameters
    ----------
    folder : path
        Where ``checkpoint.pt`` lies.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / NAME
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
        snapshot = mapped(content, lambda tensor: tensor.detach().to("cpu", copy=True))
        self._last = self._thread.submit(self._write, snapshot)

    def _write(self, content: dict[str, Any]) -> None:
        with atomic_path(self._path) as path:
            path.write_bytes(packed(content))


def read(folder: Path) -> dict[str, Any] | None:
    """Return the content of the checkpoint in a folder; None where there is none.

    Raises
    ------
    InvalidInputError
        If it is damaged.
    """
    path = folder / NAME
    if not path.is_file():
        return None
    return unpacked(path.read_bytes(), path, "begin the run again, or put a copy of it there")


def packed(content: dict[str, Any]) -> bytes:
    """Return the bytes of a checkpoint: as PyTorch writes it, then the sha256 of that."""
    buffer = io.BytesIO()
    torch.save(content, buffer)
    return buffer.getvalue() + hashlib.sha256(buffer.getbuffer()).digest()


def unpacked(data: bytes, path: Path, remedy: str) -> dict[str, Any]:
    """Return the content of a checkpoint; PyTorch, which compares no checksum, sees whole ones."""
    body, digest = data[:-_DIGEST], data[-_DIGEST:]
    if hashlib.sha256(body).digest() != digest:
        raise InvalidInputError(
            f"{path} must end in the sha256 of its {len(body)} bytes, and does not: it was"
            " damaged, or written by an older version",
            advice=remedy,
        )
    content: dict[str, Any] = torch.load(io.BytesIO(body), map_location="cpu", weights_only=True)
    return content


def mapped(content: Any, change: Callable[[Tensor], Tensor]) -> Any:
    """Return nested dicts, lists and tuples with every tensor changed."""
    if isinstance(content, Tensor):
        return change(content)
    if isinstance(content, dict):
        return {key: mapped(value, change) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return type(content)(mapped(value, change) for value in content)
    return content
