"""XYZ and other tables: one point on each line, columns parted by blanks, commas or semicolons."""

from __future__ import annotations

import re
from contextlib import suppress
from itertools import islice
from pathlib import Path

import numpy as np

from spectra_kit._core.types import Floats
from spectra_kit._core.validate import quantity
from spectra_kit._core.warn import warn
from spectra_kit.errors import IgnoredContentWarning, InvalidInputError
from spectra_kit.geometry.formats._arrays import Arrays, position, real, whole
from spectra_kit.geometry.formats._text import (
    Lines,
    text_of,
    without_comments,
    words_of,
)
from spectra_kit.geometry.shapes import PointCloud

Rows = list[tuple[int, str]]  # (line number, line)
_PARAVIEW = {f"points{mark}{i}": axis for i, axis in enumerate("xyz") for mark in ":_"}


def read(path: Path) -> Arrays:
    """Return the columns x, y, z: the first three, or those that a line of names calls so.

    Every line must have the same number of columns; a count may stand in front.
    """
    text = _with_heading(text_of(path.read_bytes()))
    points = points_of(text)
    if path.suffix.lower() != ".pts":  # whose columns are agreed on
        _tell_of_rest(text)
    return points, None


def _tell_of_rest(text: bytes) -> None:
    """Warn of columns that no line names behind the third; not of normals and colours."""
    names, mark, rows = _beginning(text, 100)
    rest = np.array([_columns(line, mark)[3:] for _, line in rows])
    if names or not rest.size:
        return
    if rest.shape[1] == 3:
        with suppress(ValueError):  # of empty cells
            values = rest.astype(np.float64)
            is_colour = (values >= 0) & (values <= np.where(values % 1, 1, 255))
            if is_colour.all() or np.median(abs(np.linalg.norm(values, axis=1) - 1)) < 0.01:
                return
    told = f"passed over {quantity(rest.shape[1], 'column')} behind the first three, taken for"
    advice = "if these are others, call the columns x, y, z in a first line"
    warn(f"{told} x, y, z as no line names them", IgnoredContentWarning, advice=advice)


def holds_points(path: Path) -> bool:
    """Whether a table begins with numbers, or names columns x, y, z, and none that lists files."""
    with path.open("rb") as file:
        text = _with_heading(text_of(file.read(1 << 16)))
    names, mark, rows = _beginning(text, 1)
    if names:
        return "file" not in names
    return bool(rows) and all(map(_is_number, _columns(rows[0][1], mark)))


def _beginning(text: bytes, count: int) -> tuple[list[str], str | None, Rows]:
    """Return the names of columns, what parts them, and the first rows, without a count."""
    lines = islice(words_of(text), count + 2)
    rows = [(i, " ".join(words)) for i, words in lines if words[0][:2] != "//"]
    names, rows = _names(rows[bool(rows and rows[0][1].isdecimal()) :])
    mark = next((mark for mark in ";," if rows and mark in rows[0][1]), None)
    return names, mark, rows[:count]


def points_of(text: bytes) -> Floats | list[list[float]]:
    """Return the points of a text."""
    found = at_once(text)
    return line_by_line(text) if found is None else found


def _with_heading(text: bytes) -> bytes:
    """Return a text whose first comment names the columns, as NumPy writes it, without its mark."""
    start = re.match(rb"\s*(?:#|//)[ \t]*([^\n]*)\n([^\n]*)", text)
    if not start:
        return text
    heading, row = start[1].decode(errors="replace"), start[2].decode(errors="replace")
    names, _ = _names([(1, heading)])
    mark = next((mark for mark in ";," if mark in row), None)
    if not names or len(names) != len(_columns(row, mark)):
        return text
    return text[start.start(1) :]


def at_once(text: bytes) -> Floats | None:
    """Read a table without gaps, in which x, y, z follow each other; None of others."""
    text = without_comments(text).lstrip()
    count, start, width = -1, 0, 0
    heading, _, body = text.partition(b"\n")
    if heading.strip().isdigit():
        count, text = int(heading[:18]), body
        heading, _, body = body.partition(b"\n")
    if names := _names([(1, heading.decode(errors="replace"))])[0]:
        start, width, text = names.index("x"), len(names), body
        if names[start : start + 3] != ["x", "y", "z"]:
            return None
    n_commas = text.count(b",")
    if b";" in text or (n_commas and (b" " in text or b"\t" in text)):
        return None
    lines = Lines.of(text.replace(b",", b" ") if n_commas else text)
    width = width or (int(lines.widths[0]) if lines else 0)
    if not lines or width < 3 or (lines.widths != width).any() or count not in (-1, len(lines)):
        return None
    if n_commas not in (0, len(lines) * (width - 1)):  # an empty cell, or one behind the last
        return None
    return lines.points(slice(None), start)


def line_by_line(text: bytes) -> list[list[float]]:
    """Read any file, and say what is wrong with it."""
    rows = [(i, " ".join(words)) for i, words in words_of(text) if words[0][:2] != "//"]
    count = rows[0][1] if rows and rows[0][1].isdecimal() else ""
    names, rows = _names(rows[bool(count) :])
    if count and int(count[:18]) != len(rows):
        raise InvalidInputError(
            f"announces {count[:18]} points, followed by {quantity(len(rows), 'line')}; the file"
            " may be cut short"
        )
    # What parts the columns of the first line parts all; other commas are decimal.
    mark = next((mark for mark in ";," if rows and mark in rows[0][1]), None)
    width = max(len(_columns(rows[0][1], mark)), 3) if rows else 3
    if names and len(names) != width:
        raise InvalidInputError(
            f"names {len(names)} columns of {width}", advice="name them all, or remove that line"
        )
    order = [names.index(axis) if names else i for i, axis in enumerate("xyz")]
    points = []
    for number, line in rows:
        try:
            values = _columns(line, mark)
            named = [*(values[i] for i in order), *values[3:]] if len(values) == width else values
            points.append(position(named, width))
        except ValueError as error:
            raise InvalidInputError(
                f"line {number} is broken: {line[:60]!r} ({error}); expected {width} numbers, the"
                " first three being x, y, z, parted by spaces or by commas, with decimal points",
                advice="call columns of a heading x, y, z, or remove it" if not points else "",
            ) from error
    return points


def _names(rows: Rows) -> tuple[list[str], Rows]:
    """Return what a first line without numbers calls the columns, and the other lines.

    Units in brackets and quotes are no part of a name; a column of row numbers may have none.
    """
    line = re.sub(r"[\[(][^\])]*[\])]|[\"']", "", rows[0][1].lower()).strip() if rows else ""
    mark = next((mark for mark in ";," if mark in line), None)
    cells = (line.removesuffix(mark) if mark else line).split(mark)
    names = [_PARAVIEW.get(name.strip(), name.strip()) for name in cells]
    if not {"x", "y", "z"} <= {*names} or any(map(_is_number, names)):
        return [], rows
    return names, rows[1:]


def _columns(line: str, mark: str | None) -> list[str]:
    """Return what stands between the marks; one may end the line, and commas are decimal then."""
    if mark == ";":
        line = line.replace(",", ".")
    return (line.removesuffix(mark) if mark else line).split(mark)


def _is_number(word: str) -> bool:
    try:
        real(word)
    except ValueError:
        return False
    return True


def write(cloud: PointCloud, path: Path) -> None:
    """Write with the shortest digits that give back the same float64."""
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.writelines(f"{x!r} {y!r} {z!r}\n" for x, y, z in cloud.points.tolist())


def read_integers(path: Path, columns: int) -> list[tuple[int, ...]]:
    """Return the lines of a text as so many integers each; a ValueError tells which is not."""
    rows = []
    for number, words in words_of(text_of(path.read_bytes())):
        try:
            row = tuple(map(whole, words))
        except ValueError:
            row = ()
        if len(row) != columns:
            raise ValueError(f"{' '.join(words)[:60]!r} in line {number}")
        rows.append(row)
    return rows
