"""Writing files so that a reader never meets half of one."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from spectra_kit.errors import InvalidInputError


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path that takes the place of `path` once it is completely written.

    The temporary file lies in the same folder and has the same suffix. When the block ends well
    it is flushed to the disk and renamed over `path` in one step; when the block raises, also on
    Ctrl-C, it is removed and `path` keeps its old content. A symbolic link is followed.

    Parameters
    ----------
    path : path-like
        Where the finished file shall lie.

    Yields
    ------
    Path
        Where the block must write.

    Raises
    ------
    InvalidInputError
        If the folder of `path` does not exist, or `path` is a folder.
    OSError
        If no file can be made there.
    """
    target = check_target(path)
    part = target.with_name(f".{target.stem}-{secrets.token_hex(4)}{target.suffix}")
    with naming(path):
        part.touch()
    try:
        yield part
        with part.open("rb+") as file:
            os.fsync(file.fileno())
        os.replace(part, target)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def naming(path: str | os.PathLike[str]) -> Iterator[None]:
    """Let an OSError of the block name `path`, not a temporary file that nobody has heard of."""
    try:
        yield
    except OSError as error:
        error.filename = str(path)
        raise


def check_target(path: str | os.PathLike[str]) -> Path:
    """Return the file that writing to `path` would write, links followed, if it can be written.

    Raises
    ------
    InvalidInputError
        As in `atomic_path`.
    """
    target = Path(os.path.realpath(path))
    if target.is_dir():
        raise InvalidInputError(f"`path` must name a file, got the folder {str(path)!r}")
    if not target.parent.is_dir():
        raise InvalidInputError(
            f"cannot write {str(path)!r}: the folder {str(target.parent)!r} does not exist"
        )
    return target
