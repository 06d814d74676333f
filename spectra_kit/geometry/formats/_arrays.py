"""What the format readers share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spectra_kit.errors import InvalidInputError

Arrays = tuple[ArrayLike, ArrayLike | None]
"""Points of shape (n, 3) and faces of shape (f, 3), or None where the file holds none."""


def text_lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield (line number, words) of each line that is not blank, without ``#`` comments.

    A line that ends in a backslash goes on in the next one, and has the number of its last.
    """
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    begun = ""
    for number, line in enumerate(text.splitlines(), start=1):
        if line.endswith("\\"):
            begun += line[:-1] + " "
            continue
        whole, begun = begun + line, ""
        words = (whole.partition("#")[0] if "#" in whole else whole).split()
        if words:
            yield number, words


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
