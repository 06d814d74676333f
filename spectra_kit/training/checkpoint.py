"""Checkpoints: written whole, and read only as they were written."""

from __future__ import annotations

import hashlib
import io
from pathlib import Path
from typing import Any

import torch

from spectra_kit._files import atomic_path
from spectra_kit.errors import InvalidInputError

NAME = "checkpoint.pt"
# Optimiser states stand in the order of the network's parameters; where that, or what a checkpoint
# holds, changes, this does, and older ones are refused.
_FORMAT = b"spectra_kit checkpoint 2"
_DIGEST = hashlib.sha256().digest_size


def write(folder: Path, content: dict[str, Any]) -> None:
    """Write ``checkpoint.pt`` into a folder."""
    with atomic_path(folder / NAME) as path:
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
    """Return the bytes of a checkpoint: as PyTorch writes it, then a sha256 of that."""
    buffer = io.BytesIO()
    torch.save(content, buffer)
    return buffer.getvalue() + _digest(buffer.getvalue())


def _digest(body: bytes) -> bytes:
    return hashlib.sha256(_FORMAT + body).digest()


def unpacked(data: bytes, path: Path, remedy: str) -> dict[str, Any]:
    """Return the content of a checkpoint; PyTorch, which compares no checksum, sees whole ones."""
    body, digest = data[:-_DIGEST], data[-_DIGEST:]
    if _digest(body) != digest:
        raise InvalidInputError(
            f"{path} must end in the sha256 of its {len(body)} bytes, and does not: it was"
            " damaged, or written by an older version",
            advice=remedy,
        )
    content: dict[str, Any] = torch.load(io.BytesIO(body), map_location="cpu", weights_only=True)
    return content
