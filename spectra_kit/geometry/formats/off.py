"""Object File Format (OFF), ASCII; colours, normals and texture columns are skipped."""

from __future__ import annotations

import re
from pathlib import Path

from spectra_kit._validate import quantity
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.formats._arrays import (
    Arrays,
    broken_line,
    position,
    real,
    text_lines,
    triangle_fans,
    whole,
)
from spectra_kit.geometry.shapes import TriangleMesh


def read(path: Path) -> Arrays:
    """Return vertices and faces in file order; no faces where the header announces none."""
    lines = list(text_lines(path))
    n_points, n_faces, body = _header(lines)
    if min(n_points, n_faces) < 0 or len(body) != n_points + n_faces:
        raise InvalidInputError(
            f"the header announces {quantity(n_points, 'vertex')} and {quantity(n_faces, 'face')},"
            f" followed by {quantity(len(body), 'line')}; the file may be cut short"
        )
    points: list[list[float]] = []
    polygons: list[list[int]] = []
    colours: set[int] = set()
    for i, (number, words) in enumerate(body):
        try:
            if i < n_points:
                points.append(position(words, max(len(body[0][1]), 3)))
            else:
                corners, colour = _corners(words)
                polygons.append(corners)
                colours.add(colour)
        except ValueError as error:
            raise broken_line(number, words, error) from error
    if not colours <= {0, 3, 4} and colours != {1}:
        raise InvalidInputError(
            f"after its corners a face must have no number, 3 or 4 for a colour, or 1 in all, got"
            f" {' or '.join(map(str, sorted(colours)))}; the file may be damaged"
        )
    return points, triangle_fans(polygons) if polygons else None


def _corners(words: list[str]) -> tuple[list[int], int]:
    """Return the vertices of a face line, behind their number, and how many numbers follow."""
    size = whole(words[0])
    corners = [whole(word) for word in words[1 : size + 1]]
    if len(corners) != size:
        raise ValueError(f"{quantity(len(corners), 'corner')} where {size} are announced")
    return corners, len([real(word) for word in words[size + 1 :]])


def _header(lines: list[tuple[int, list[str]]]) -> tuple[int, int, list[tuple[int, list[str]]]]:
    """Return the announced numbers of vertices and faces, and the lines after the header."""
    words = lines[0][1] if lines else []
    # Some files glue the counts to the keyword, as in "OFF490 518 0".
    keyword = re.fullmatch(r"(?:ST)?C?N?OFF(\d*)", words[0]) if words else None
    if keyword is None:
        start = words[0][:20] if words else ""
        raise InvalidInputError(f"must start with the keyword OFF, got {start!r}")
    counts, body = [*keyword.groups(), *words[1:]], lines[1:]
    counts = [count for count in counts if count]
    if not counts and body:
        counts, body = body[0][1], body[1:]
    try:
        n_points, n_faces = (whole(count) for count in counts[:2])
    except ValueError as error:
        raise InvalidInputError(
            f"must announce its numbers of vertices and faces, got {' '.join(counts)[:60]!r}"
        ) from error
    return n_points, n_faces, body


def write(mesh: TriangleMesh, path: Path) -> None:
    """Write with the shortest digits that give back the same float64."""
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.write(f"OFF\n{mesh.n} {len(mesh.faces)} 0\n")
        file.writelines(f"{x!r} {y!r} {z!r}\n" for x, y, z in mesh.points.tolist())
        file.writelines(f"3 {a} {b} {c}\n" for a, b, c in mesh.faces.tolist())
