"""What the format readers share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spectra_kit._validate import quantity
from spectra_kit.errors import InvalidInputError

Arrays = tuple[ArrayLike, ArrayLike | None]
"""Points of shape (n, 3) and faces of shape (f, 3), or None where the file holds none."""


def text_lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield (line number, words) of each line that is not blank, without ``#`` comments.

    A line that ends in a backslash goes on in the next one, and has the number of its last.
    """
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    begun = ""
    # Not `splitlines`, which ends a comment at separators that no editor shows as one.
    for number, line in enumerate(text.split("\n"), start=1):
        if line.endswith("\\"):
            begun += line[:-1] + " "
            continue
        whole, begun = begun + line, ""
        words = (whole.partition("#")[0] if "#" in whole else whole).split()
        if words:
            yield number, words
    if begun.split():
        raise InvalidInputError(
            f"ends in a backslash, after which line {number} must go on; the file may be cut short"
        )


def broken_line(number: int, words: Sequence[str], error: ValueError) -> InvalidInputError:
    """Return what is to be raised of a line that cannot be read."""
    return InvalidInputError(
        f"line {number} is broken: {' '.join(words)[:60]!r} ({error})",
        advice="the file may be cut short or damaged",
    )


def real(word: str) -> float:
    """Return the number that `word` is in any program; Python alone reads ``1_0``."""
    if "_" in word or not word.isascii():
        raise ValueError(f"{word!r} is no number")
    return float(word)


def whole(word: str) -> int:
    """Return the integer that `word` is in any program, if an index can be as large."""
    if "_" in word or not word.isascii():
        raise ValueError(f"{word!r} is no integer")
    value = int(word)
    if not -(2**63) <= value < 2**63:
        raise ValueError(f"{word[:20]!r} has more than 64 bits")
    return value


def position(columns: list[str], width: int) -> list[float]:
    """Return x, y, z, the first of `width` columns, of which all lines of a file have as many."""
    if len(columns) != width:
        raise ValueError(f"{quantity(len(columns), 'column')} where there must be {width}")
    return [real(column.strip()) for column in columns[:3]]


def triangle_fans(polygons: Sequence[Sequence[int]]) -> NDArray[np.int64]:
    """Cut polygons of three or more corners into triangles that share their first corner.

    The order of the polygons is kept; a triangle stays as it is. Shape (f, 3).
    """
    shortest = min(map(len, polygons), default=3)
    if shortest < 3:
        raise InvalidInputError(f"a face must have at least 3 corners, got one with {shortest}")
    if all(len(polygon) == 3 for polygon in polygons):
        return np.array(polygons, dtype=np.int64).reshape(-1, 3)
    return np.array(
        [(p[0], p[i], p[i + 1]) for p in polygons for i in range(1, len(p) - 1)], dtype=np.int64
    )
