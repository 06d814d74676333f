"""STL, binary and ASCII: loose triangles, whose coincident corners are one vertex."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from spectra_kit._core.types import Floats
from spectra_kit._core.warn import warn
from spectra_kit.errors import IgnoredContentWarning, InvalidInputError
from spectra_kit.geometry.formats._arrays import Arrays, check_rest, real
from spectra_kit.geometry.formats._text import Lines, text_of
from spectra_kit.geometry.shapes import TriangleMesh

HEADER = 80
WORDS = f"facet normal 0 0 0 outer loop {'vertex 0 0 0 ' * 3} endloop endfacet".split()
PATTERN = np.array(WORDS, dtype=object)
NUMBERS = PATTERN == "0"
WIDTHS, VERTICES = np.array([5, 2, 4, 4, 4, 1, 1]), slice(2, 5)  # of its lines
CORNERS = NUMBERS & (np.arange(len(PATTERN)) > 4)  # without the normal, of which nothing is asked
FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
UNKNOWN = 0, 0xFFFFFFFF  # what stands for the count where a program wrote before it knew


def read(path: Path) -> Arrays:
    """Return the mesh with exactly coincident corners joined, in order of first use.

    The format repeats a vertex in each of its triangles; joining them is reading it, not repair.
    """
    data = path.read_bytes()
    is_ascii = _is_ascii(data)
    if is_ascii:
        text = text_of(data)
        found = at_once(text)
        corners, is_ended = word_by_word(text) if found is None else (found, True)
    else:
        corners, is_ended = _binary_corners(data), True
    if len(corners) == 0:
        raise InvalidInputError("holds no triangle")
    faces = np.arange(len(corners)).reshape(-1, 3)
    mesh = TriangleMesh(corners, faces).with_merged_vertices()
    if not is_ended:
        # Where a surface is closed, nothing was cut off.
        if len(mesh.boundary_vertices):
            raise InvalidInputError(
                "has no last line `endsolid`, and its surface has a boundary; the file may be cut"
                " short",
                advice="if it is whole, add that line",
            )
        warn("has no last line `endsolid`, though its surface is closed", IgnoredContentWarning)
    return mesh.points, mesh.faces


def _is_ascii(data: bytes) -> bool:
    # Binary files may begin with "solid" too, but hold zero bytes early on.
    start = text_of(data[:512])
    return start.lstrip()[:5].lower() == b"solid" and b"\0" not in start


def _binary_corners(data: bytes) -> Floats:
    count = int.from_bytes(data[HEADER : HEADER + 4], "little")
    held, surplus = divmod(len(data) - HEADER - 4, FACET.itemsize)
    if count in UNKNOWN and held > 0 and not surplus:
        told = f"passed over the count in its header, {count}: it holds {held}"
        warn(told, IgnoredContentWarning)
        count = held
    end = HEADER + 4 + count * FACET.itemsize
    if len(data) < end:
        raise InvalidInputError(
            f"the header announces {count} triangles, {end} bytes, got {len(data)} bytes;"
            " the file may be cut short or no STL"
        )
    check_rest(data[end:], is_row=not surplus or not count)
    facets = np.frombuffer(data, dtype=FACET, count=count, offset=HEADER + 4)
    return np.asarray(facets["corners"].reshape(-1, 3), dtype=np.float64)


def at_once(text: bytes) -> Floats | None:
    """Return the corners of a text of which all is as usual, a facet on seven lines; or None."""
    lines = Lines.of(text + b"\n" * 16)
    if lines is None:
        return None
    begin, fourth = lines.character(0) | 32, lines.character(3) | 32
    is_mark = (begin == ord("s")) | ((begin == ord("e")) & (fourth == ord("s")))
    marks, of_facets = np.flatnonzero(is_mark), np.flatnonzero(~is_mark)
    if len(marks) % 2 or len(of_facets) % len(WIDTHS) or not len(of_facets):
        return None
    starts, ends = marks[::2], marks[1::2]
    if starts[0] or ends[-1] < len(lines) - 1 or (starts[1:] != ends[:-1] + 1).any():
        return None
    if (lines.widths[of_facets].reshape(-1, len(WIDTHS)) != WIDTHS).any():
        return None
    first = lines.first[of_facets].reshape(-1, len(WIDTHS))[:, 0]
    if not (
        lines.are(lines.first[starts], b"solid")
        and lines.are(lines.first[ends], b"endsolid")
        and all(lines.are(first + i, WORDS[i].encode()) for i in np.flatnonzero(~NUMBERS))
    ):
        return None
    return lines.points(of_facets.reshape(-1, len(WIDTHS))[:, VERTICES].ravel(), 1)


def word_by_word(data: bytes) -> tuple[Floats, bool]:
    """Return the corners of all facets, and whether a last line ends them; say what is wrong."""
    text = data.decode("utf-8", errors="replace").lower()
    text = re.sub(r"\bend[ \t]+(solid|loop|facet)\b", r"end\1", text)
    head, *rest = re.split(r"^[ \t]*((?:end)?solid)\b.*$", text, flags=re.MULTILINE)
    # A first and a last line that are there twice are one of each.
    marks: list[str] = []
    parts: list[str] = []
    outside = head.split()
    for mark, part in zip(rest[::2], rest[1::2], strict=True):
        if marks and marks[-1] == mark and not parts[-1].split():
            parts[-1] = part
            continue
        marks.append(mark)
        parts.append(part)
    is_ended = len(marks) % 2 == 0
    outside += " ".join(parts[1::2]).split()
    pairs = ["solid", "endsolid"] * len(marks)
    if marks != pairs[: len(marks)] or outside:
        raise InvalidInputError(
            "all facets must stand between a line `solid` and a line `endsolid`; the file may be"
            " cut short"
        )
    words = np.array([word for part in parts[::2] for word in part.split()], dtype=object)
    n_facets, surplus = divmod(len(words), len(PATTERN))
    facets = words[: n_facets * len(PATTERN)].reshape(n_facets, len(PATTERN))
    is_whole = (facets[:, ~NUMBERS] == PATTERN[~NUMBERS]).all(axis=1)
    if surplus or not is_whole.all():
        first = n_facets if is_whole.all() else int(is_whole.argmin())
        found = " ".join(words[first * len(PATTERN) :][: len(PATTERN)])
        raise InvalidInputError(
            f"facet {first}, counted from 0, must be {' '.join(PATTERN)!r}, got {found[:200]!r};"
            " the file may be cut short"
        )
    try:
        corners = np.array([real(word) for word in facets[:, CORNERS].ravel()]).reshape(-1, 3)
    except ValueError as error:
        raise InvalidInputError(f"a vertex line must hold three numbers ({error})") from error
    return corners, is_ended


def write(mesh: TriangleMesh, path: Path) -> None:
    """Write binary STL: coordinates are rounded to float32, unused vertices are lost."""
    facets = np.zeros(len(mesh.faces), dtype=FACET)
    corners = mesh.points[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    facets["normal"] = np.divide(normals, lengths, out=normals, where=lengths > 0)
    facets["corners"] = corners
    count = len(facets).to_bytes(4, "little")
    path.write_bytes(bytes(HEADER) + count + facets.tobytes())
