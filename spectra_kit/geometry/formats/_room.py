"""How much a file may unfold to: what packs, repeats or announces is bounded by the bytes there.

A file of half a megabyte can pack, or show five hundred times, what takes all memory. What it says
of its own size is compared with its room before anything is read or made.
"""

from __future__ import annotations

import bz2
import gzip
import lzma
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from spectra_kit.errors import InvalidInputError

# An even grid, the most regular of surfaces, packs 8 to 1 in gzip, 16 to 1 in bzip2, 75 to 1 in xz.
MULTIPLE = 100
ALWAYS = 1 << 26  # so much is there on any machine, and what small files repeat is small
PACKED: dict[str, tuple[bytes, Any]] = {
    ".gz": (b"\x1f\x8b", gzip.open),
    ".bz2": (b"BZh", bz2.open),
    ".xz": (b"\xfd7zXZ", lzma.open),
}
_BLOCK = 1 << 20


def room(size: int) -> int:
    """Return how many bytes may be made of a file of `size` bytes."""
    return max(MULTIPLE * size, ALWAYS)


def format_of(path: Path) -> str:
    """Return the extension that names the format, in lower case: of ``a.PLY.gz`` it is .ply."""
    inner = Path(path.stem) if path.suffix.lower() in PACKED else path
    return inner.suffix.lower()


def beginning(path: Path, size: int) -> bytes:
    """Return the first bytes of a file, or of what it packs; nothing where they cannot be read."""
    _, opened = PACKED.get(path.suffix.lower(), (b"", open))
    try:
        with opened(path, "rb") as file:
            return bytes(file.read(size))
    except (OSError, EOFError, zlib.error, lzma.LZMAError):
        return b""


@contextmanager
def unpacked(path: Path) -> Iterator[Path]:
    """Give the path of the file itself, or of what it packs, unpacked for as long as this lasts."""
    if path.suffix.lower() not in PACKED:
        yield path
        return
    with TemporaryDirectory(prefix="spectra_kit") as folder:
        plain = Path(folder, "unpacked" + format_of(path))
        _unpack(path, plain)
        yield plain


def _unpack(path: Path, plain: Path) -> None:
    start, opened = PACKED[path.suffix.lower()]
    with path.open("rb") as file:
        if file.read(len(start)) != start:
            raise InvalidInputError(
                f"is not packed, though its name ends in {path.suffix}",
                advice=f"rename it to {path.stem}",
            )
    bound = left = room(path.stat().st_size)
    try:
        with opened(path) as packed, plain.open("wb") as file:
            while block := packed.read(_BLOCK):
                left -= len(block)
                if left < 0:
                    break
                file.write(block)
    except (OSError, EOFError, zlib.error, lzma.LZMAError) as error:
        raise InvalidInputError(
            f"cannot be unpacked ({error})",
            advice="the file may be cut short or damaged, or the disk of temporary files be full",
        ) from error
    if left < 0:
        raise InvalidInputError(
            f"unpacks to more than {bound:,} bytes, which is {MULTIPLE} times its size or 64 MiB",
            advice=f"if that is right, unpack it yourself and read {path.stem}",
        )
    if not plain.stat().st_size:
        raise InvalidInputError("what it packs is empty")
