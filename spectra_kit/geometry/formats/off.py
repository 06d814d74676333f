"""Object File Format (OFF), ASCII and binary; colours, normals and texture columns are skipped."""

from __future__ import annotations

import re
from collections import Counter
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from spectra_kit._core.validate import quantity
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.formats._arrays import (
    Arrays,
    broken_line,
    check_corners,
    check_rest,
    position,
    real,
    whole,
)
from spectra_kit.geometry.formats._text import (
    Lines,
    are_laid_out,
    numbers,
    passed_over,
    text_of,
    without_comments,
    words_of,
)
from spectra_kit.geometry.polygons import Polygons
from spectra_kit.geometry.shapes import TriangleMesh

_Lines = list[tuple[int, list[str]]]


class _Header(NamedTuple):
    """What the first lines announce, and how many lines and words they are."""

    has_weights: bool
    n_points: int
    n_faces: int
    lines: int
    words: int


def read(path: Path) -> Arrays:
    """Return vertices and faces in file order; no faces where the header announces none."""
    data = path.read_bytes()
    if start := re.match(rb"\s*(ST)?(C)?(N)?(4)?OFF[ \t]+BINARY[^\n]*\n", data):
        widths = (3 + (start[4] is not None), 3 * (start[3] is not None))
        return _binary(data[start.end() :], *widths, 4 * bool(start[2]) + 2 * bool(start[1]))
    data = text_of(data)
    text = without_comments(data)
    header = _header([words for _, words in islice(words_of(text), 3)])
    found = at_once(text, header)
    return line_by_line(text, header) if found is None else found


def at_once(text: bytes, header: _Header) -> Arrays | None:
    """Read a file of which all is as usual; None of others."""
    lines = Lines.of(text)
    n, start = header.n_points, header.lines
    if lines is None or header.has_weights or min(n, header.n_faces) < 1:
        return None
    if len(lines) - start != n + header.n_faces:
        return None
    of_points, of_faces = slice(start, start + n), slice(start + n, None)
    widths, columns = lines.widths[of_faces], {*np.unique(lines.widths[of_points]).tolist()}
    sizes = numbers(lines.text(of_faces, 0, 1), np.int64, len(widths))
    if len(columns) > 1 or min(columns) < 3 or sizes is None or sizes.min() < 3:
        return None
    behind = widths - 1 - sizes
    if not ({*np.unique(behind).tolist()} <= {0, 3, 4} or (behind == 1).all()):
        return None
    points = lines.points(of_points)
    corners = numbers(lines.text(of_faces, 1, 1 + sizes), np.int64, int(sizes.sum()))
    colours = numbers(lines.text(of_faces, 1 + sizes), np.float64, int(behind.sum()))
    if points is None or corners is None or colours is None:
        return None
    return points, Polygons(corners, sizes)


def line_by_line(text: bytes, header: _Header) -> Arrays:
    """Read any file, and say what is wrong with it, or odd."""
    lines = list(words_of(text))
    try:
        return _parsed(lines[header.lines :], header)
    except InvalidInputError:
        if rows := _rows_of_flow(lines, header):
            return _parsed(rows, header)
        raise


def _parsed(body: _Lines, header: _Header) -> Arrays:
    n_points, n_faces = header.n_points, header.n_faces
    n = n_points + n_faces
    if min(n_points, n_faces) < 0 or len(body) < n or _hold_faces(body[n:]):
        raise InvalidInputError(
            f"the header announces {quantity(n_points, 'vertex')} and {quantity(n_faces, 'face')},"
            f" followed by {quantity(len(body), 'line')}; the file may be cut short"
        )
    points: list[list[float]] = []
    polygons: list[list[int]] = []
    colours: Counter[int] = Counter()
    edges: set[int] = set()
    width = max(len(body[0][1]), 3) if body else 3
    for i, (number, words) in enumerate(body[:n]):
        try:
            if i < n_points:
                points.append(position(words, width))
                if header.has_weights:
                    points[-1] = _divided(points[-1], words)
            else:
                corners, colour = _corners(words)
                polygons.append(corners)
                if len(corners) < 3:
                    edges.add(colour)
                else:
                    colours[colour] += 1
        except ValueError as error:
            raise broken_line(number, words, error) from error
    # One number behind one face alone is the end of an index that was torn in two; what stands
    # behind an edge as behind no face may be its corners.
    behind = colours.keys() | edges
    if not behind <= {0, 1, 3, 4} or colours[1] == 1 < len(polygons) or not edges <= {0, *colours}:
        raise InvalidInputError(
            f"after its corners a face must have no number, 3 or 4 for a colour, or 1 in all, got"
            f" {' or '.join(map(str, sorted(behind)))}; the file may be damaged"
        )
    passed_over([number for number, _ in body[n:]], "behind the faces")
    return points, Polygons.of(polygons) if polygons else None


def _hold_faces(lines: _Lines) -> bool:
    """Whether one of these lines, more than are announced, could be a vertex or a face."""
    for _, (first, *others) in lines:
        size = int(first) if first.isdecimal() and len(first) < 9 else 0
        if len(others) >= size >= 3 or any("." in word for word in others):
            return True
    return False


def _rows_of_flow(lines: _Lines, header: _Header) -> _Lines:
    """Return rows of numbers that flow, whatever lines they stand on; nothing where none fit.

    Nothing tells corners from colours then, of which there can be none.
    """
    flow = [(number, word) for number, words in lines for word in words][header.words :]
    rows: _Lines = []
    end = 0
    for i in range(min(header.n_points + header.n_faces, len(flow))):
        number, word = flow[end] if end < len(flow) else (0, "")
        if i >= header.n_points and not re.fullmatch(r"\d{1,9}", word):
            return []
        size = 3 + header.has_weights if i < header.n_points else 1 + int(word)
        rows.append((number, [word for _, word in flow[end : end + size]]))
        end += size
    widths = np.array([len(words) for _, words in rows], dtype=np.int64)
    breaks = np.cumsum([len(words) for _, words in lines]) - header.words
    n = header.n_points
    of_points = are_laid_out(widths[:n], 0, breaks, lists=False)
    of_faces = are_laid_out(widths[n:], int(widths[:n].sum()), breaks, lists=True)
    return rows if end == len(flow) and of_points and of_faces else []


def _divided(point: list[float], words: list[str]) -> list[float]:
    """Return x, y, z of a point in four coordinates, of which the last divides the others."""
    weight = real(words[3]) if len(words) > 3 else 0.0
    if weight == 0:
        raise ValueError("a fourth coordinate must be there, and not 0")
    return point if weight == 1 else [value / weight for value in point]


def _corners(words: list[str]) -> tuple[list[int], int]:
    """Return the vertices of a face line, behind their number, and how many numbers follow."""
    size = whole(words[0])
    corners = [whole(word) for word in words[1 : size + 1]]
    if len(corners) != size:
        raise ValueError(f"{quantity(len(corners), 'corner')} where {size} are announced")
    return corners, len([real(word) for word in words[size + 1 :]])


def _header(lines: list[list[str]]) -> _Header:
    """Return what the first lines announce: a keyword, which may be absent, and three counts."""
    first = lines[0] if lines else [""]
    # Some files glue the counts to the keyword, as in "OFF490 518 0".
    keyword = re.fullmatch(r"(?:ST)?C?N?(4?)(n?)OFF(\d*)|([Oo]ff)(\d*)", first[0])
    if keyword is None and not all(map(str.isdecimal, first)):
        raise InvalidInputError(f"must start with the keyword OFF, got {first[0][:20]!r}")
    glued = (keyword[3] or keyword[5]) if keyword else ""
    counts = [*([glued] if glued else []), *(first[1:] if keyword else first)]
    used = 1
    dimension = "3"
    if keyword and keyword[2]:
        if not counts:
            counts, used = lines[1] if len(lines) > 1 else [], 2
        dimension, *counts = counts or [""]
    if not counts and len(lines) > used:
        counts, used = lines[used], used + 1
    try:
        n_points, n_faces = (whole(count) for count in counts[:2])
    except ValueError as error:
        raise InvalidInputError(
            f"must announce its numbers of vertices and faces, got {' '.join(counts)[:60]!r}"
        ) from error
    if dimension != "3":
        raise InvalidInputError(f"must have vertices of 3 coordinates, got {dimension[:20]}")
    words = sum(map(len, lines[:used])) - max(len(counts) - 3, 0)
    return _Header(bool(keyword and keyword[1]), n_points, n_faces, used, words)


def _binary(body: bytes, width: int, *others: int) -> Arrays:
    """Read numbers of four bytes, the largest first: counts, vertices, and faces with colours."""
    whole_numbers = np.frombuffer(body, ">i4", len(body) // 4).tolist()
    end = 3
    problem = "the header announces more than the file holds; it may be cut short"
    if len(whole_numbers) < 3:
        raise InvalidInputError(problem)
    n_points, n_faces = whole_numbers[:2]
    columns = width + sum(others)
    end += n_points * columns
    if min(n_points, n_faces) < 0 or end > len(whole_numbers):
        raise InvalidInputError(problem)
    points = np.frombuffer(body, ">f4", n_points * columns, 12).reshape(n_points, columns)
    points = points[:, :width].astype(np.float64)
    if width == 4:
        points = points / points[:, 3:]
    polygons: list[list[int]] = []
    for _ in range(n_faces):
        size = whole_numbers[end] if end < len(whole_numbers) else -1
        colour = whole_numbers[end + 1 + size] if 0 <= size < len(whole_numbers) - end - 1 else -1
        polygons.append(whole_numbers[end + 1 : end + 1 + size])
        end += 2 + size + colour
        if colour < 0 or end > len(whole_numbers):
            raise InvalidInputError(problem)
    rest = whole_numbers[end : end + 1]
    check_rest(body[4 * end :], bool(rest) and 3 <= rest[0] <= len(whole_numbers) - end - 2)
    faces = Polygons.of(polygons)
    check_corners(faces)
    return points[:, :3], faces if polygons else None


def write(mesh: TriangleMesh, path: Path) -> None:
    """Write with the shortest digits that give back the same float64."""
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.write(f"OFF\n{mesh.n} {len(mesh.faces)} 0\n")
        file.writelines(f"{x!r} {y!r} {z!r}\n" for x, y, z in mesh.points.tolist())
        file.writelines(f"3 {a} {b} {c}\n" for a, b, c in mesh.faces.tolist())
