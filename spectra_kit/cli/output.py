"""Where the commands write: blocks of text or JSON to stdout, files where it was asked for."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from spectra_kit._files import is_special
from spectra_kit.cli.folder import drawing
from spectra_kit.errors import InvalidInputError


def check_output(path: Path, suffixes: Sequence[str], inputs: Iterable[str | Path] = ()) -> None:
    """Refuse a bad output path before the work, not after it; and one that would eat an input."""
    if path.suffix.lower() not in suffixes:
        known = " or ".join(suffixes)
        raise InvalidInputError(f"the output must be a {known} file, got {str(path)!r}")
    if not path.parent.is_dir():
        raise InvalidInputError(
            f"cannot write {str(path)!r}: there is no folder {str(path.parent)!r}; make it first"
        )
    if path.is_dir():
        raise InvalidInputError(f"cannot write {str(path)!r}: a folder has that name")
    if not os.access(path if is_special(path) else path.parent, os.W_OK):
        what = "it" if is_special(path) else f"the folder {str(path.parent)!r}"
        raise InvalidInputError(
            f"cannot write {str(path)!r}: {what} is not yours to write to; name another place"
        )
    if path.resolve() in {Path(name).resolve() for name in inputs}:
        raise InvalidInputError(
            f"the output must not replace an input, got {str(path)!r} as both; name another file"
        )


def print_blocks(*blocks: str) -> None:
    """Write blocks of text, an empty line between them."""
    sys.stdout.write("\n\n".join(blocks) + "\n")


def print_json(**record: object) -> None:
    """Write one object; JSON knows no NaN: null stands for it."""
    sys.stdout.write(as_json(record))


def finish(
    json: bool, picture: Path | None, draw: Callable[[Path], object], *, kept: str, **record: object
) -> None:
    """Draw where that was asked for; print the JSON after that, also where it ends early."""
    drawn = None
    try:
        if picture:
            with drawing([picture], kept=kept):
                draw(picture)
            drawn = str(picture)
    finally:
        if json:
            print_json(**record, picture=drawn)
    if drawn and not json:
        print_blocks(f"picture: {drawn}")


def as_json(record: object) -> str:
    """Return JSON in which an array of numbers is one line.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.cli.output import as_json
    >>> print(as_json({"k": 2, "eigenvalues": np.array([0.0, 2.5])}), end="")
    {
      "k": 2,
      "eigenvalues": [0.0, 2.5]
    }
    """
    return _indented(_plain(record), "") + "\n"


def _indented(value: object, margin: str) -> str:
    """Objects line by line, and lists of objects; whatever else on one line."""
    inner = margin + "  "
    if isinstance(value, dict) and value:
        parts = [f"{json.dumps(key)}: {_indented(item, inner)}" for key, item in value.items()]
        opening, closing = "{}"
    elif isinstance(value, list) and any(isinstance(item, dict) for item in value):
        parts = [_indented(item, inner) for item in value]
        opening, closing = "[]"
    else:
        return json.dumps(value, allow_nan=False)
    lines = ",\n".join(inner + part for part in parts)
    return f"{opening}\n{lines}\n{margin}{closing}"


def _plain(value: object) -> object:
    """Return `value` as JSON has it."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
