"""Checkpoints: written whole and beside the loop, or in halves and parts where room is short."""

from __future__ import annotations

import hashlib
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
_DIGEST = hashlib.sha256().digest_size
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
            path.write_bytes(_packed(content))


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
    return _unpacked(path.read_bytes(), path, "begin the run again, or put a copy of it there")


def _packed(content: dict[str, Any]) -> bytes:
    """Return the bytes of a checkpoint: as PyTorch writes it, then the sha256 of that."""
    buffer = io.BytesIO()
    torch.save(content, buffer)
    return buffer.getvalue() + hashlib.sha256(buffer.getbuffer()).digest()


def _unpacked(data: bytes, path: Path, remedy: str) -> dict[str, Any]:
    """Return the content of a checkpoint; PyTorch, which compares no checksum, sees whole ones."""
    body, digest = data[:-_DIGEST], data[-_DIGEST:]
    if hashlib.sha256(body).digest() != digest:
        raise InvalidInputError(
            f"{path} must end in the sha256 of its {len(body)} bytes, and does not: it was"
            f" damaged, or written by an older version; {remedy}"
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


def write_parts(folder: Path, content: dict[str, Any], *, limit: int = 15 * 2**20) -> list[Path]:
    """Write a checkpoint small, as ``checkpoint.01of03`` and so on, of at most `limit` bytes each.

    A run goes on from there well, but not bit by bit: the averaged weights alone are kept, as
    float16, which is as exact as the shipped files; Muon's momentum, an average over some twenty
    steps, begins anew; AdamW's averages are kept as bfloat16, for they may be smaller than
    float16 goes.

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
    weights = content["average"] or content["network"]
    small = {
        **content,
        "network": mapped(weights, lambda tensor: tensor.half()),
        "average": {},
        "optimizers": [_without_momentum(saved) for saved in content["optimizers"]],
    }
    data = _packed(small)
    for old in folder.glob(_PARTS):
        old.unlink()
    total, paths = -(-len(data) // limit), []
    for number in range(total):
        paths.append(folder / f"checkpoint.{number + 1:02d}of{total:02d}")
        with atomic_path(paths[-1]) as path:
            path.write_bytes(data[number * limit : (number + 1) * limit])
    return paths


def read_parts(folder: str | os.PathLike[str]) -> dict[str, Any]:
    """Return what `write_parts` wrote, in float32, the average in place of the weights too.

    Raises
    ------
    InvalidInputError
        If there are no parts, not all of them, or damaged ones.
    """
    paths = sorted(Path(folder).glob(_PARTS))
    total = int(paths[0].name[-2:]) if paths else 1
    if len(paths) != total:
        raise InvalidInputError(
            f"`folder` must hold all {total} parts of a checkpoint, found {len(paths)} in {folder};"
            " copy the rest there, and nothing older"
        )
    data = b"".join(path.read_bytes() for path in paths)
    content = _unpacked(data, Path(folder) / NAME, "copy all its parts there again")
    whole: dict[str, Any] = mapped(content, lambda t: t.float() if t.is_floating_point() else t)
    return {**whole, "average": whole["network"]}


def _without_momentum(saved: dict[str, Any]) -> dict[str, Any]:
    def halved(tensor: Tensor) -> Tensor:
        return tensor.bfloat16() if tensor.ndim else tensor  # counts of steps stay exact

    kept = {
        index: mapped(state, halved)
        for index, state in saved["state"].items()
        if "momentum_buffer" not in state
    }
    return {**saved, "state": kept}
