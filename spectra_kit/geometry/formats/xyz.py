"""XYZ: one point on each line, columns parted by spaces or commas."""

from __future__ import annotations

from pathlib import Path

from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.formats._arrays import Arrays, position, text_lines
from spectra_kit.geometry.shapes import PointCloud


def read(path: Path) -> Arrays:
    """Return the first three columns; every line must have the same number of columns."""
    rows: list[list[float]] = []
    width, mark = 0, None
    for number, words in text_lines(path):
        line = " ".join(words)
        if not rows:  # what parts the columns of the first line parts all; other commas are decimal
            mark = "," if "," in line else None
            width = max(len(line.split(mark)), 3)
        try:
            rows.append(position(line.split(mark), width))
        except ValueError as error:
            raise InvalidInputError(
                f"line {number} is broken: {line[:60]!r} ({error}); expected {width} numbers, the"
                " first three being x, y, z, parted by spaces or by commas, with decimal points"
            ) from error
    return rows, None


def write(cloud: PointCloud, path: Path) -> None:
    """Write with the shortest digits that give back the same float64."""
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.writelines(f"{x!r} {y!r} {z!r}\n" for x, y, z in cloud.points.tolist())
