"""Wavefront OBJ: the lines ``v`` and ``f``; texture, normals, groups and materials are skipped."""

from __future__ import annotations

import re
from pathlib import Path

from spectra_kit._validate import quantity
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.formats._arrays import (
    Arrays,
    broken_line,
    real,
    text_lines,
    triangle_fans,
    whole,
)
from spectra_kit.geometry.shapes import TriangleMesh

# All that a line may begin with: other words are damage, which may have taken a face.
KEYWORDS = re.compile(
    "v|f|vt|vn|vp|g|s|mg|o|p|l|curv|curv2|surf|fo|deg|bmat|step|cstype|parm|trim|hole|scrv|sp|end"
    "|con|bevel|c_interp|d_interp|lod|usemtl|mtllib|usemap|maplib|shadow_obj|trace_obj|ctech|stech"
    "|call|csh"
)


def read(path: Path) -> Arrays:
    """Return all vertices in file order, whatever texture or group uses them, and the faces."""
    points: list[list[float]] = []
    polygons: list[list[int]] = []
    for number, words in text_lines(path):
        if not KEYWORDS.fullmatch(words[0]):
            raise InvalidInputError(
                f"line {number} must begin with a keyword of OBJ, got {words[0][:60]!r}; the file"
                " may be damaged"
            )
        try:
            if words[0] == "v":
                points.append(_position(words[1:]))
            elif words[0] == "f":
                polygons.append(_corners(words[1:], len(points)))
        except ValueError as error:
            raise broken_line(number, words, error) from error
    if not polygons:
        raise InvalidInputError(
            f"holds {quantity(len(points), 'vertex')} but no face line; the file may be cut short"
        )
    return points, triangle_fans(polygons)


def _position(words: list[str]) -> list[float]:
    """Return x, y, z of a vertex line, which may go on with a weight, a colour or both."""
    values = [real(word) for word in words]
    if len(values) not in (3, 4, 6, 7):
        raise ValueError(f"a vertex has 3 numbers, perhaps 4, 6 or 7, not {len(values)}")
    if len(values) == 4 and values[3] != 1:
        raise ValueError(f"the weight of a vertex must be 1, not {words[3]}")
    return values[:3]


def _corners(words: list[str], n_so_far: int) -> list[int]:
    """Return the 0-based vertices of corners like ``7``, ``7/1/3`` or ``-1`` (the last so far)."""
    if len({word.count("/") for word in words}) > 1:
        raise ValueError("its corners have different numbers of slashes")
    indices = [whole(word.partition("/")[0]) for word in words]
    if 0 in indices:
        raise ValueError("vertices count from 1, and 0 is none")
    return [index - 1 if index >= 0 else n_so_far + index for index in indices]


def write(mesh: TriangleMesh, path: Path) -> None:
    """Write with the shortest digits that give back the same float64."""
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.writelines(f"v {x!r} {y!r} {z!r}\n" for x, y, z in mesh.points.tolist())
        file.writelines(f"f {a} {b} {c}\n" for a, b, c in (mesh.faces + 1).tolist())
