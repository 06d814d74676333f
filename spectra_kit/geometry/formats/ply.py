"""Polygon File Format (PLY), ASCII and binary: coordinates and faces, other properties skipped."""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import quantity
from spectra_kit._core.warn import warn
from spectra_kit.errors import IgnoredContentWarning, InvalidInputError
from spectra_kit.geometry.formats._arrays import (
    Arrays,
    bands,
    check_corners,
    check_rest,
    real,
    whole,
)
from spectra_kit.geometry.formats._text import Lines, are_laid_out, numbers, text_of
from spectra_kit.geometry.polygons import Polygons
from spectra_kit.geometry.shapes import Geometry, TriangleMesh

TYPES = {
    f"{kind}{8 * size}": f"{kind[0]}{size}" for kind in ("int", "uint") for size in (1, 2, 4, 8)
}
TYPES |= {"char": "i1", "short": "i2", "int": "i4", "uchar": "u1", "ushort": "u2", "uint": "u4"}
TYPES |= {"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"}
_BLOCK = 1 << 18
ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}

CORNERS = ("vertex_indices", "vertex_index")
STRIPS = "tristrips"  # as scanners and Stanford's tools write: corners of a band, -1 between bands

Columns = dict[str, NDArray[Any] | Polygons]
"""By property: a number or a list of each row; lists of several lengths one after the other."""


@dataclass(frozen=True)
class _Property:
    name: str
    dtype: np.dtype[np.generic]
    size_dtype: np.dtype[np.generic] | None  # of the length in front of a list; None for a number


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: list[_Property]


def read(path: Path) -> Arrays:
    """Return vertices and faces in file order; no faces where the file announces none."""
    elements, body, lines = _split(path.read_bytes())
    columns: dict[str, Columns] = {}
    offset = 0
    for element in elements:
        columns[element.name], offset = _read_element(element, body, offset)
    points = _points(columns.get("vertex", {}))
    try:
        faces: Polygons | InvalidInputError | None = _faces(elements, columns)
    except InvalidInputError as error:  # who wants the points alone need not know
        faces = error
    if lines is None:
        if isinstance(faces, Polygons):
            check_corners(faces)
        check_rest(body[offset:], _is_part(elements, body[offset:], faces))
    elif len(body) > offset:
        raise InvalidInputError(
            f"holds {(len(body) - offset) // 8} numbers more than its header announces; it may be"
            " damaged"
        )
    else:
        _check_layout(elements, columns, lines)
    return points, faces


def _split(data: bytes) -> tuple[list[_Element], bytes, Ints | None]:
    """Return the announced elements, the bytes after the header, and where lines of numbers end.

    Where lines end is None of a binary file.
    """
    if data[:1] != b"p":
        data = text_of(data)
    end = re.search(rb"^end_header[ \t]*(?:\r\n?|\n|$)", data.replace(b"\r", b"\n"), re.MULTILINE)
    head = data[: end.start() if end else 0].replace(b"\r", b"\n").split(b"\n")
    lines = [[word.decode("latin-1") for word in line.split()] for line in head if line.split()]
    if not end or not lines or lines[0] != ["ply"]:
        raise InvalidInputError("must begin with a PLY header; the file may be cut short")
    is_pair = data[end.end() - 1 : end.end() + 1] == b"\r\n"
    body = data[end.end() + is_pair :]
    encoding = next((" ".join(words[1:2]) for words in lines if words[0] == "format"), "")
    if encoding not in ORDERS:
        raise InvalidInputError(f"the format must be one of {', '.join(ORDERS)}, got {encoding!r}")
    # ASCII bodies are turned into doubles below, so that one reader serves both.
    types = dict.fromkeys(TYPES, "f8") if encoding == "ascii" else TYPES
    elements: list[_Element] = []
    unknown: list[str] = []
    try:
        for words in lines[1:]:
            match words:
                case ["element", name, count]:
                    elements.append(_Element(name, whole(count), []))
                case ["property", "list", size, kind, name] if TYPES[size][0] != "f":
                    dtypes = [np.dtype(ORDERS[encoding] + types[word]) for word in (kind, size)]
                    elements[-1].properties.append(_Property(name, *dtypes))
                case ["property", kind, name]:
                    dtype = np.dtype(ORDERS[encoding] + types[kind])
                    elements[-1].properties.append(_Property(name, dtype, None))
                case ["format" | "comment" | "obj_info", *_]:
                    pass
                case [_, *_] if not elements:  # a comment without its word, as Blender once wrote
                    unknown.append(" ".join(words))
                case _:
                    raise ValueError(f"{words[0]!r} begins no such line")  # noqa: TRY301
    except (ValueError, LookupError) as error:
        raise InvalidInputError(f"the header line {' '.join(words)!r} is broken") from error
    _check(elements)
    if unknown:
        told = f"passed over {quantity(len(unknown), 'line')} of the header, {unknown[0][:60]!r}"
        warn(told, IgnoredContentWarning)
    if encoding != "ascii":
        return elements, body, None
    return elements, *_without_surplus(elements, *_doubles(text_of(body)))


def _check(elements: list[_Element]) -> None:
    """Refuse headers that announce what this module cannot read, or nobody."""
    for element in elements:
        if element.count < 0:
            raise InvalidInputError(f"cannot hold {element.count} rows of {element.name!r}")
        for p in element.properties:
            is_corners, is_list = p.name in CORNERS, p.size_dtype is not None
            if (is_corners and not is_list) or (is_list and p.name.lower() in ("x", "y", "z")):
                raise InvalidInputError(
                    f"{p.name!r} must be a {'number' if is_list else 'list'}, got a"
                    f" {'list' if is_list else 'number'}"
                )
    for names in ([e.name for e in elements], *([p.name for p in e.properties] for e in elements)):
        if len(set(names)) < len(names):
            raise InvalidInputError(f"the header must name each thing once, got {', '.join(names)}")


def _doubles(text: bytes) -> tuple[Floats, Ints]:
    """Return the numbers of a text, and how many there are up to the end of each line."""
    lines = Lines.of(text)
    if lines is not None:
        total = int(lines.widths.sum())
        found = numbers(text, np.float64, total)
        if found is not None:
            return found, np.cumsum(lines.widths)
    words: list[str] = []
    ends = []
    try:
        for line in text.decode("ascii").split("\n"):
            if row := line.split():
                words += row
                ends.append(len(words))
        return np.array([real(word) for word in words]), np.array(ends, dtype=np.int64)
    except ValueError as error:
        raise InvalidInputError(f"must hold numbers only after its header ({error})") from error


def _without_surplus(elements: list[_Element], values: Floats, lines: Ints) -> tuple[bytes, Ints]:
    """Return the numbers without those that end each row of an element and are not announced.

    Some programs write more than they declare, as many behind each row. One row alone that is
    longer has a number that was torn in two.
    """
    as_they_are = values.tobytes(), lines
    if len(lines) != sum(element.count for element in elements if element.properties):
        return as_they_are
    widths = np.diff(lines, prepend=0)
    needed = np.zeros(len(lines), dtype=np.int64)
    told = []
    row = 0
    for element in elements:
        if not element.properties or not element.count:
            continue
        here = slice(row, row := row + element.count)
        start, stop = lines[here] - widths[here], lines[here]
        place = start.copy()
        for p in element.properties:
            place += 1
            if p.size_dtype is not None:
                sizes = values[np.minimum(place, stop) - 1]
                if not (sizes == np.clip(np.rint(sizes), 0, len(values))).all():
                    return as_they_are
                place += sizes.astype(np.int64)
        surplus = np.unique(stop - place)
        if len(surplus) > 1 or surplus[0] < 0 or (surplus[0] > 0 and element.count < 2):
            return as_they_are
        needed[here] = place - start
        if surplus[0]:
            told.append(f"{quantity(surplus[0], 'number')} behind each row of {element.name!r}")
    if not told:
        return as_they_are
    warn(f"passed over {' and '.join(told)}, which its header announces not", IgnoredContentWarning)
    within = np.arange(len(values)) - np.repeat(lines - widths, widths)
    return values[within < np.repeat(needed, widths)].tobytes(), np.cumsum(needed)


def _read_element(element: _Element, body: bytes, start: int) -> tuple[Columns, int]:
    """Return the columns of `element`, and where the next one begins."""
    if element.count == 0 or not element.properties:
        return {}, start
    first, _ = _read_rows(element, body, start, 1)
    # Nearly always the lists have one length, that of the first row: then all is one table.
    sizes = {name: int(c.sizes[0]) for name, c in first.items() if isinstance(c, Polygons)}
    fields: list[tuple[str, np.dtype[np.generic], tuple[int, ...]]] = []
    for p in element.properties:
        if p.size_dtype is not None:
            fields.append((f"size of {p.name}", p.size_dtype, ()))
        fields.append((p.name, p.dtype, (sizes[p.name],) if p.name in sizes else ()))
    row = np.dtype(fields)
    if len(body) - start >= element.count * row.itemsize:
        table = np.frombuffer(body, row, element.count, start)
        if all((table[f"size of {name}"] == size).all() for name, size in sizes.items()):
            return {p.name: table[p.name] for p in element.properties}, start + table.nbytes
    return _read_rows(element, body, start, element.count)


def _read_rows(element: _Element, body: bytes, offset: int, count: int) -> tuple[Columns, int]:
    """Read `count` rows whose lists may have any length: where they stand, one by one."""
    sizes: dict[str, list[int]] = {p.name: [] for p in element.properties}
    places: dict[str, list[int]] = {p.name: [] for p in element.properties}
    steps = [
        (p.name, p.dtype.itemsize, p.size_dtype and _unpacker(p.size_dtype))
        for p in element.properties
    ]
    try:
        for _ in range(count):
            for name, itemsize, unpack in steps:
                size = 1
                if unpack is not None:
                    (announced,) = unpack.unpack_from(body, offset)
                    if not 0 <= announced <= len(body) or announced != int(announced):
                        raise ValueError(f"{name!r} cannot have {announced} entries")  # noqa: TRY301
                    size = int(announced)
                    offset += unpack.size
                    sizes[name].append(size)
                places[name].append(offset)
                offset += size * itemsize
            if offset > len(body):
                raise ValueError(f"{offset} bytes where there are {len(body)}")  # noqa: TRY301
    except (ValueError, struct.error) as error:
        raise InvalidInputError(
            f"ends before the {element.count} rows of {element.name!r} that its header announces"
            f" ({error}); the file may be cut short or damaged"
        ) from error
    columns: Columns = {}
    for p in element.properties:
        lengths = np.array(sizes[p.name], dtype=np.int64)
        where = np.array(places[p.name], dtype=np.int64)
        if p.size_dtype is None:
            columns[p.name] = _gathered(body, where, p.dtype)
        else:
            within = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
            where = np.repeat(where, lengths) + p.dtype.itemsize * within
            columns[p.name] = Polygons(_gathered(body, where, p.dtype), lengths)
    return columns, offset


def _unpacker(dtype: np.dtype[np.generic]) -> struct.Struct:
    letters = {"i": "bhiq", "u": "BHIQ", "f": "  fd"}[dtype.kind]
    return struct.Struct(
        f"{'>' if dtype.byteorder == '>' else '<'}{letters[dtype.itemsize.bit_length() - 1]}"
    )


def _gathered(body: bytes, places: Ints, dtype: np.dtype[np.generic]) -> NDArray[Any]:
    """Return the numbers that begin at these bytes."""
    found = np.empty(len(places), dtype=dtype)
    whole_body = np.frombuffer(body, dtype=np.uint8)
    for start in range(0, len(places), _BLOCK):
        some = slice(start, start + _BLOCK)
        at = places[some, None] + np.arange(dtype.itemsize)
        found[some] = whole_body[at].view(dtype).ravel()
    return found


def _is_part(elements: list[_Element], rest: bytes, faces: Any) -> bool:
    """Whether bytes behind the announced end may be of what is announced.

    That is for a header, or a row before, that is damaged; only whole faces show that it is not.
    """
    if isinstance(faces, Polygons) and (faces.sizes < 3).any():
        return True
    if not isinstance(faces, Polygons) or elements[-1].name not in ("face", STRIPS):
        return True
    try:
        columns, end = _read_rows(elements[-1], rest, 0, 1)
    except InvalidInputError:
        return False
    sizes = [column.sizes[0] for column in columns.values() if isinstance(column, Polygons)]
    return len(rest) % end == 0 and max(sizes) >= 3


def _check_layout(elements: list[_Element], columns: dict[str, Columns], lines: Ints) -> None:
    """Refuse text whose rows overlap with its lines, which end behind so many numbers."""
    start = 0
    for element in elements:
        widths = np.zeros(element.count if columns[element.name] else 0, dtype=np.int64)
        for column in columns[element.name].values():
            if isinstance(column, Polygons):
                widths += 1 + column.sizes
            else:
                widths += 1 + column.shape[1] if column.ndim == 2 else 1
        has_lists = any(p.size_dtype is not None for p in element.properties)
        if not are_laid_out(widths, start, lines, lists=has_lists):
            raise InvalidInputError("a row must end where its line ends; the file may be damaged")
        start += int(widths.sum())


def _points(columns: Columns) -> NDArray[Any]:
    """Return x, y, z, whose names may be in capitals."""
    names = {name.lower(): name for name in columns} | {name: name for name in columns}
    try:
        return np.column_stack([np.asarray(columns[names[axis]]) for axis in "xyz"])
    except KeyError as error:
        raise InvalidInputError(f"has no vertices with x, y and z (missing {error})") from error


def _faces(elements: list[_Element], columns: dict[str, Columns]) -> Polygons | None:
    """Return the polygons, and behind them the triangles of strips; None where there are none."""
    found = []
    for element in elements:
        named = [name for name in CORNERS if name in columns[element.name]]
        if element.name in ("face", STRIPS) and element.count:
            if not named:
                names = ", ".join(columns[element.name]) or "nothing"
                raise InvalidInputError(f"faces must have vertex_indices, got {names}")
            lists = columns[element.name][named[0]]
            if not isinstance(lists, Polygons):
                lists = Polygons.of(lists)
            polygons = Polygons(_whole(lists.corners), lists.sizes)
            if element.name == STRIPS:
                corners = np.insert(polygons.corners, np.cumsum(polygons.sizes), -1)
                polygons = Polygons.of(bands(corners))
            found.append(polygons)
        elif named:
            raise InvalidInputError(
                f"stores {named[0]} of {element.name!r}, only those of 'face' and {STRIPS!r} are"
                " read; convert it to a list of faces",
                advice="or use {}",
                remedies=('kind="cloud"',),
            )
    if not found:
        return None
    return Polygons(*map(np.concatenate, zip(*found, strict=True)))


def _whole(corners: NDArray[Any]) -> Ints:
    # Where a double holds every integer; NaN is in no range.
    if (
        corners.dtype.kind == "f"
        and not ((corners == np.rint(corners)) & (np.abs(corners) < 2**53)).all()
    ):
        raise InvalidInputError("faces must hold whole numbers")
    return corners.astype(np.int64)


def write(
    geometry: Geometry, path: Path, properties: Mapping[str, NDArray[np.generic]] | None = None
) -> None:
    """Write little-endian binary with double coordinates, which loses nothing.

    `properties` are more columns of the vertices, each of shape (n,), float64 or uint8.
    """
    faces = geometry.faces if isinstance(geometry, TriangleMesh) else None
    columns = dict(zip("xyz", geometry.points.T, strict=True)) | dict(properties or {})
    kinds = {np.dtype("f8"): "double", np.dtype("u1"): "uchar"}
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {geometry.n}"]
    header += [f"property {kinds[column.dtype]} {name}" for name, column in columns.items()]
    fields = [(name, column.dtype.newbyteorder("<")) for name, column in columns.items()]
    vertices = np.empty(geometry.n, dtype=fields)
    for name, column in columns.items():
        vertices[name] = column
    body = vertices.tobytes()
    if faces is not None:
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        rows = np.zeros(len(faces), dtype=[("size", "u1"), ("corners", "<i4", 3)])
        rows["size"], rows["corners"] = 3, faces
        body += rows.tobytes()
    path.write_bytes("\n".join([*header, "end_header", ""]).encode("ascii") + body)
