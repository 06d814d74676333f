"""Where the commands write: blocks of text or JSON to stdout, files where it was asked for."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

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
    if not os.access(path.parent, os.W_OK):
        raise InvalidInputError(
            f"cannot write {str(path)!r}: the folder {str(path.parent)!r} is not yours to write"
            " to; name another place"
        )
    if path.resolve() in {Path(name).resolve() for name in inputs}:
        raise InvalidInputError(
            f"the output must not replace an input, got {str(path)!r} as both; name another file"
        )


def print_blocks(*blocks: str) -> None:
    """Write blocks of text, an empty line between them."""
    sys.stdout.write("\n\n".join(blocks) + "\n")


def print_json(**record: object) -> None:
    """JSON knows no NaN: null stands for it."""
    sys.stdout.write(json.dumps(plain(record), indent=2, allow_nan=False) + "\n")


def plain(value: object) -> object:
    """Return `value` as JSON has it."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
