"""Folders that a command fills with files of its own."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from spectra_kit.errors import InvalidInputError


def check_folder(
    folder: Path, files: Sequence[str], known: Sequence[str], inputs: Iterable[Path]
) -> None:
    """Refuse to write over an input, or beside files of an earlier run that would stay.

    `files` are the names that will be written, `known` all that the command ever writes.
    """
    if not folder.parent.is_dir():
        raise InvalidInputError(f"cannot make {str(folder)!r}: there is no {str(folder.parent)!r}")
    if folder.exists() and not folder.is_dir():
        raise InvalidInputError(f"cannot make the folder {str(folder)!r}: a file has that name")
    read = {path.resolve() for path in inputs}
    if taken := [name for name in files if (folder / name).resolve() in read]:
        raise InvalidInputError(
            f"the output must not replace an input, got {', '.join(taken)} in {str(folder)!r} as"
            " one; name another folder with --output"
        )
    left = [
        name
        for name in known
        if name not in files and (folder / name).exists()
        if (folder / name).resolve() not in read
    ]
    if left:
        raise InvalidInputError(
            f"{str(folder)!r} must hold no other result, got {', '.join(left)}, which would stay"
            " beside the new one; remove what is old, or name another folder with --output"
        )
