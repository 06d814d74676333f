"""Wavefront OBJ: the lines ``v`` and ``f``; texture, normals, groups and materials are skipped."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from spectra_kit._core.types import Floats
from spectra_kit._core.validate import quantity
from spectra_kit._core.warn import warn
from spectra_kit.errors import IgnoredContentWarning, InvalidInputError
from spectra_kit.geometry.formats._arrays import Arrays, broken_line, real, whole
from spectra_kit.geometry.formats._text import (
    Lines,
    lines_of,
    numbers,
    passed_over,
    text_of,
    without_comment,
    without_comments,
)
from spectra_kit.geometry.polygons import Polygons
from spectra_kit.geometry.shapes import TriangleMesh

# Lines of numbers, which a backslash continues, and of names, which may end in one.
OF_NUMBERS = re.compile("v|f|vt|vn|vp|p|l|curv|curv2|surf|deg|bmat|step|parm|trim|hole|scrv|sp|con")
OF_NAMES = re.compile(
    "g|s|mg|o|fo|cstype|end|bevel|c_interp|d_interp|lod|usemtl|mtllib|usemap|maplib|shadow_obj"
    "|trace_obj|ctech|stech|call|csh"
)
SHAPES = ("l", "curv", "curv2", "surf", "call")  # that no triangle shows


def read(path: Path) -> Arrays:
    """Return all vertices in file order, whatever texture or group uses them, and the faces."""
    text = text_of(path.read_bytes())
    found = at_once(text)
    return line_by_line(text) if found is None else found


def at_once(text: bytes) -> Arrays | None:
    """Read a file of which all is as usual; None of others."""
    text = without_comments(text)
    lines = None if b"\\" in text else Lines.of(text)
    if lines is None or not len(lines):
        return None
    begin, second, third = (lines.character(i) for i in range(3))
    is_v, is_f = ((begin == ord(letter)) & (second <= ord(" ")) for letter in "vf")
    is_skipped = (begin == ord("v")) & np.isin(second, list(b"tn")) & (third <= ord(" "))
    rest = np.flatnonzero(~(is_v | is_f | is_skipped))
    at = lines.words[lines.first[rest]].tolist()
    words = {text[i : i + 12].split()[0].decode() for i in at}
    if not is_f.any() or not all(map(_is_quiet, words)):
        return None
    columns, sizes = lines.widths[is_v] - 1, lines.widths[is_f] - 1
    if not {*np.unique(columns).tolist()} <= {3, 4, 6, 7}:
        return None
    points = lines.points(is_v, 1)
    behind = numbers(lines.text(is_v, 4), np.float64, int((columns - 3).sum()))
    if points is None or behind is None:
        return None
    if (behind[(np.cumsum(columns - 3) - 1)[columns == 4]] != 1).any():  # weights
        return None
    of_f = lines.text(is_f, 1)
    if b"/" in of_f:
        of_f = _before_slashes(of_f)
    corners = numbers(of_f, np.int64, int(sizes.sum()))
    if corners is None or not corners.all():
        return None
    so_far = np.repeat(np.cumsum(is_v)[is_f], sizes)
    return points, Polygons(np.where(corners > 0, corners - 1, so_far + corners), sizes)


def _before_slashes(text: bytes) -> bytes:
    """Return each word up to its first slash."""
    characters = np.frombuffer(text, dtype=np.uint8)
    ends = np.flatnonzero((characters <= ord(" ")) | (characters == ord("/")))
    kept = np.repeat(characters[ends] <= ord(" "), np.diff(ends, append=len(text)))
    return text[: ends[0]] + characters[ends[0] :][kept].tobytes()


def _is_quiet(word: str) -> bool:
    """Whether such a line says nothing of the surface."""
    return word not in SHAPES and bool(OF_NUMBERS.fullmatch(word) or OF_NAMES.fullmatch(word))


def line_by_line(text: bytes) -> Arrays:
    """Read any file, and say what is wrong with it, or odd."""
    rows: list[list[float]] = []
    polygons: list[list[int]] = []
    first: dict[int, tuple[int, list[str]]] = {}  # vertex of each number of columns
    passed: dict[str, list[int]] = {}
    textured = False
    for number, words in _statements(text):
        word = words[0]
        try:
            if word == "v":
                rows.append([real(value) for value in words[1:]])
                columns = len(words) - 1
                first.setdefault(
                    -4 if columns == 4 and rows[-1][3] != 1 else columns, (number, words)
                )
            elif word == "f":
                polygons.append(_corners(words[1:], len(rows)))
            elif word in SHAPES:
                passed.setdefault(f"beginning with {word!r}", []).append(number)
            elif not _is_quiet(word):
                _check_unknown(words)
                passed.setdefault("of unknown words", []).append(number)
            textured |= word in ("vt", "usemtl")
        except ValueError as error:
            raise broken_line(number, words, error) from error
    points = _positions(rows, first)
    for which, found in passed.items():
        passed_over(found, which)
    if polygons:
        return points, Polygons.of(polygons)
    if textured:
        return points, InvalidInputError(
            f"holds {quantity(len(points), 'vertex')} and texture, but no face line; the file may"
            " be cut short",
            advice="of the points alone, use {}",
            remedies=('kind="cloud"',),
        )
    return points, None


def _positions(rows: list[list[float]], first: dict[int, tuple[int, list[str]]]) -> Floats:
    """Return x, y, z; a weight of 1 or a colour may follow, and anything that follows in each row.

    One row alone of another length may be cut short. `first` is the first line of each number of
    columns; -4 where a weight is another.
    """
    odd = sorted(first.keys() - {3, 4, 6, 7})
    columns = {abs(width) for width in first}
    if odd and (columns in ({0}, {1}) or len(columns) > 1 or len(rows) == 1):
        number, words = first[odd[0]]
        problem = (
            f"the weight of a vertex must be 1, not {words[4]}"
            if odd[0] == -4
            else f"a vertex has 3 numbers, perhaps 4, 6 or 7, not {odd[0]}"
        )
        raise broken_line(number, words, ValueError(problem))
    if columns == {2}:
        warn("its vertices have x and y alone: z is 0", IgnoredContentWarning)
        return np.pad(np.array(rows), ((0, 0), (0, 1)))
    if odd == [-4]:
        warn("passed over weights of vertices that are not 1", IgnoredContentWarning)
    elif odd:
        behind = quantity(odd[0] - 3, "number")
        warn(f"passed over {behind} behind x, y, z of each vertex", IgnoredContentWarning)
    return np.array([row[:3] for row in rows]).reshape(-1, 3)


def _statements(text: bytes) -> Iterator[tuple[int, list[str]]]:
    """Yield (line number, words); a line of numbers that ends in a backslash goes on in the next.

    It has the number of its last.
    """
    begun: list[str] = []
    number = 0
    for number, line in lines_of(text):
        words = without_comment(line).split()
        if begun or (words and OF_NUMBERS.fullmatch(words[0])):
            words = begun + words
            if words[-1].endswith("\\"):
                begun = [*words[:-1], words[-1][:-1]] if words[-1] != "\\" else words[:-1]
                continue
        begun = []
        if words and not words[0].startswith("//"):
            yield number, words
    if begun:
        raise InvalidInputError(
            f"ends in a backslash, after which line {number} must go on; the file may be cut short"
        )


def _check_unknown(words: list[str]) -> None:
    """Refuse what may have been a vertex or a face: those of other programs have longer names."""
    is_tag = words[0] == "t" and len(words) > 1 and words[1].isalpha()  # of subdivision surfaces
    if not is_tag and not re.fullmatch("[A-Za-z]{2}[A-Za-z0-9_.:-]*", words[0]):
        raise ValueError("it must begin with a keyword of OBJ")


def _corners(words: list[str], n_so_far: int) -> list[int]:
    """Return the 0-based vertices of corners like ``7``, ``7/1/3`` or ``-1`` (the last so far)."""
    indices = [whole(word.partition("/")[0]) for word in words]
    if 0 in indices:
        raise ValueError("vertices count from 1, and 0 is none")
    return [index - 1 if index >= 0 else n_so_far + index for index in indices]


def write(mesh: TriangleMesh, path: Path) -> None:
    """Write with the shortest digits that give back the same float64."""
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.writelines(f"v {x!r} {y!r} {z!r}\n" for x, y, z in mesh.points.tolist())
        file.writelines(f"f {a} {b} {c}\n" for a, b, c in (mesh.faces + 1).tolist())
