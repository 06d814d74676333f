"""Checkpoints: written whole and beside the loop, or in halves and parts where room is short."""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import torch
from torch import Tensor

from spectra_kit._files import atomic_path
from spectra_kit.errors import InvalidInputError

NAME = "checkpoint.pt"
_PARTS = "checkpoint.[0-9][0-9]of[0-9][0-9]"


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

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
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
            torch.save(content, path)


def read(folder: Path) -> dict[str, Any] | None:
    """Return the content of the checkpoint in a folder; None where there is none."""
    path = folder / NAME
    if not path.is_file():
        return None
    content: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
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


def write_parts(folder: Path, content: dict[str, Any], *, limit: int = 15 * 2**20) -> list[Path]:
    """Write a checkpoint as ``checkpoint.01of03`` and so on, of at most `limit` bytes each.

    Weights and their average are stored as float16, which is as exact as the shipped files, and
    the optimisers' averages as bfloat16, because gradients may be smaller than float16 goes.
    A run goes on from there as if by a rounding of its weights: not bit by bit.

    Parameters
    ----------
    folder : Path
        Parts of an earlier checkpoint in it are removed.
    content : dict
        Of a checkpoint.
    limit : int
        Bytes per file.

    Returns
    -------
    list of Path
    """
    halves = {
        key: mapped(value, lambda t, key=key: _halved(t, key))  # type: ignore[misc]
        for key, value in content.items()
    }
    buffer = io.BytesIO()
    torch.save(halves, buffer)
    data = buffer.getvalue()
    for old in folder.glob(_PARTS):
        old.unlink()
    total, paths = -(-len(data) // limit), []
    for number in range(total):
        paths.append(folder / f"checkpoint.{number + 1:02d}of{total:02d}")
        with atomic_path(paths[-1]) as path:
            path.write_bytes(data[number * limit : (number + 1) * limit])
    return paths


def read_parts(folder: str | os.PathLike[str]) -> dict[str, Any]:
    """Return what `write_parts` wrote, in float32.

    Raises
    ------
    InvalidInputError
        If there are no parts, or not all of them.
    """
    paths = sorted(Path(folder).glob(_PARTS))
    total = int(paths[0].name[-2:]) if paths else 1
    if len(paths) != total:
        raise InvalidInputError(
            f"`folder` must hold all {total} parts of a checkpoint, found {len(paths)} in {folder};"
            " copy the rest there, and nothing older"
        )
    data = b"".join(path.read_bytes() for path in paths)
    content = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    whole: dict[str, Any] = mapped(content, lambda t: t.float() if t.is_floating_point() else t)
    return whole


def _halved(tensor: Tensor, key: str) -> Tensor:
    if tensor.ndim < 2:  # small, and the optimisers' counts of steps are among them
        return tensor
    return tensor.to(torch.bfloat16 if key == "optimizers" else torch.float16)
