"""XYZ: one point on each line, columns parted by spaces or commas."""

from __future__ import annotations

from pathlib import Path

from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.formats._arrays import Arrays, text_lines
from spectra_kit.geometry.shapes import PointCloud


def read(path: Path) -> Arrays:
    """Return the first three columns; every line must have the same number of columns."""
    rows: list[list[float]] = []
    width = 0
    for number, words in text_lines(path):
        line = " ".join(words)
        columns = line.replace(",", " ").split()
        width = width or len(columns)
        message = (
            f"line {number} is broken: {line[:60]!r}; expected {max(width, 3)} numbers,"
            " the first three being x, y, z"
        )
        if len(columns) != max(width, 3):
            raise InvalidInputError(message)
        try:
            rows.append([float(column) for column in columns[:3]])
        except ValueError as error:
            raise InvalidInputError(message) from error
    return rows, None


def write(cloud: PointCloud, path: Path) -> None:
    """Write with the shortest digits that give back the same float64."""
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.writelines(f"{x!r} {y!r} {z!r}\n" for x, y, z in cloud.points.tolist())
