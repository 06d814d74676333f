"""Wavefront OBJ: the lines ``v`` and ``f``; texture, normals, groups and materials are skipped."""

from __future__ import annotations

from pathlib import Path

from spectra_kit._validate import quantity
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.formats._arrays import Arrays, text_lines, triangle_fans
from spectra_kit.geometry.shapes import TriangleMesh


def read(path: Path) -> Arrays:
    """Return all vertices in file order, whatever texture or group uses them, and the faces."""
    points: list[list[float]] = []
    polygons: list[list[int]] = []
    for number, words in text_lines(path):
        try:
            if words[0] == "v":
                x, y, z = words[1:4]
                points.append([float(x), float(y), float(z)])
            elif words[0] == "f":
                polygons.append([_index(corner, len(points)) for corner in words[1:]])
        except ValueError as error:
            raise InvalidInputError(
                f"line {number} is broken: {' '.join(words)[:60]!r}; the file may be cut short"
            ) from error
    if not polygons:
        raise InvalidInputError(
            f"holds {quantity(len(points), 'vertex')} but no face line; the file may be cut short"
        )
    return points, triangle_fans(polygons)


def _index(corner: str, n_so_far: int) -> int:
    """Return the 0-based vertex of a corner such as ``7``, ``7/1/3`` or ``-1`` (the last one)."""
    index = int(corner.split("/", 1)[0])
    # The format counts from 1; 0 means nothing in it and becomes -1, out of range as it should be.
    return index - 1 if index >= 0 else n_so_far + index


def write(mesh: TriangleMesh, path: Path) -> None:
    """Write with the shortest digits that give back the same float64."""
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.writelines(f"v {x!r} {y!r} {z!r}\n" for x, y, z in mesh.points.tolist())
        file.writelines(f"f {a} {b} {c}\n" for a, b, c in (mesh.faces + 1).tolist())
