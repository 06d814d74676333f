"""Where the commands write: blocks of text or JSON to stdout, progress to a terminal."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import numpy as np

from spectra_kit.errors import InvalidInputError


def check_output(path: Path, suffix: str) -> None:
    """Refuse a bad output path before the work, not after it."""
    if path.suffix.lower() != suffix:
        raise InvalidInputError(f"the output must be a {suffix} file, got {str(path)!r}")
    if not path.parent.is_dir():
        raise InvalidInputError(
            f"cannot write {str(path)!r}: there is no folder {str(path.parent)!r}"
        )


_START = time.perf_counter()


def progress(text: str) -> None:
    """Tell a person at the terminal what goes on; say nothing to a file or a pipe."""
    if sys.stderr.isatty():
        sys.stderr.write(f"[{time.perf_counter() - _START:6.1f} s] {text}\n")


def print_blocks(*blocks: str) -> None:
    """Write blocks of text, an empty line between them."""
    sys.stdout.write("\n\n".join(blocks) + "\n")


def print_json(**record: object) -> None:
    """JSON knows no NaN: null stands for it."""
    json.dump(plain(record), sys.stdout, indent=2, allow_nan=False)
    sys.stdout.write("\n")


def plain(value: object) -> object:
    """Return `value` as JSON has it."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
