"""Polygon File Format (PLY), ASCII and binary: coordinates and faces, other properties skipped."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.formats._arrays import Arrays, triangle_fans, whole
from spectra_kit.geometry.shapes import Geometry, TriangleMesh

TYPES = {
    f"{kind}{8 * size}": f"{kind[0]}{size}" for kind in ("int", "uint") for size in (1, 2, 4, 8)
}
TYPES |= {"char": "i1", "short": "i2", "int": "i4", "uchar": "u1", "ushort": "u2", "uint": "u4"}
TYPES |= {"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"}
ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}

CORNERS = ("vertex_indices", "vertex_index")

Columns = dict[str, NDArray[np.generic] | list[NDArray[np.generic]]]


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
    if body[offset:].strip():
        raise InvalidInputError(
            f"holds {len(body) - offset} bytes more than its header announces; it may be damaged"
        )
    # Where a number is torn in two, rows that follow may still add up to what is announced.
    if lines and not np.isin(lines, _row_ends(elements, columns)).all():
        raise InvalidInputError("a row must end where its line ends; the file may be damaged")
    try:
        points = np.column_stack([columns["vertex"][axis] for axis in "xyz"])
    except KeyError as error:
        raise InvalidInputError(f"has no vertices with x, y and z (missing {error})") from error
    n_faces = sum(element.count for element in elements if element.name == "face")
    return points, _faces(columns["face"]) if n_faces else None


def _split(data: bytes) -> tuple[list[_Element], bytes, list[int]]:
    """Return the announced elements, the bytes after the header, and where lines of numbers end."""
    end = re.search(rb"^end_header[ \t]*\r?$\n?", data, re.MULTILINE)
    head = data[: end.start() if end else 0].split(b"\n")
    lines = [[word.decode("latin-1") for word in line.split()] for line in head if line.split()]
    if not end or not lines or lines[0] != ["ply"]:
        raise InvalidInputError("must begin with a PLY header; the file may be cut short")
    body = data[end.end() :]
    encoding = next((" ".join(words[1:2]) for words in lines if words[0] == "format"), "")
    if encoding not in ORDERS:
        raise InvalidInputError(f"the format must be one of {', '.join(ORDERS)}, got {encoding!r}")
    # ASCII bodies are turned into doubles below, so that one reader serves both.
    types = dict.fromkeys(TYPES, "f8") if encoding == "ascii" else TYPES
    elements: list[_Element] = []
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
                case _:
                    raise ValueError(f"{words[0]!r} begins no such line")  # noqa: TRY301
    except (ValueError, LookupError) as error:
        raise InvalidInputError(f"the header line {' '.join(words)!r} is broken") from error
    _check(elements)
    return (elements, *_doubles(body)) if encoding == "ascii" else (elements, body, [])


def _check(elements: list[_Element]) -> None:
    """Refuse headers that announce what this module cannot read, or nobody."""
    for element in elements:
        if element.count < 0:
            raise InvalidInputError(f"cannot hold {element.count} rows of {element.name!r}")
        for p in element.properties:
            is_corners, is_list = p.name in CORNERS, p.size_dtype is not None
            if element.name != "face" and is_corners and element.count:
                raise InvalidInputError(
                    f"stores {p.name} of {element.name!r}, only those of 'face' are read; convert"
                    " it to a list of faces first"
                )
            if (is_corners and not is_list) or (is_list and p.name in ("x", "y", "z")):
                raise InvalidInputError(
                    f"{p.name!r} must be a {'number' if is_list else 'list'}, got a"
                    f" {'list' if is_list else 'number'}"
                )
    for names in ([e.name for e in elements], *([p.name for p in e.properties] for e in elements)):
        if len(set(names)) < len(names):
            raise InvalidInputError(f"the header must name each thing once, got {', '.join(names)}")


def _doubles(body: bytes) -> tuple[bytes, list[int]]:
    """Return the numbers of a text in binary, and how many there are up to the end of each line."""
    words: list[str] = []
    ends = []
    # An underscore is what Python, and it alone, reads as part of a number.
    try:
        for line in body.replace(b"_", b"\xff").decode("ascii").replace("\r", "\n").split("\n"):
            words += line.split()
            ends.append(len(words))
        return np.array(words, dtype="<f8").tobytes(), ends
    except ValueError as error:
        raise InvalidInputError(f"must hold numbers only after its header ({error})") from error


def _read_element(element: _Element, body: bytes, start: int) -> tuple[Columns, int]:
    """Return the columns of `element`, and where the next one begins."""
    if element.count == 0 or not element.properties:
        return {}, start
    first, _ = _read_rows(element, body, start, 1)
    # Nearly always the lists have one length, that of the first row: then all is one table.
    sizes = {p.name: len(first[p.name][0]) for p in element.properties if p.size_dtype is not None}
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
    """Read `count` rows one by one, whose lists may have any length."""
    columns: dict[str, list[NDArray[np.generic]]] = {p.name: [] for p in element.properties}
    try:
        for _ in range(count):
            for p in element.properties:
                size = 1
                if p.size_dtype is not None:
                    (announced,) = np.frombuffer(body, p.size_dtype, 1, offset).tolist()
                    if not 0 <= announced <= len(body) or announced != int(announced):
                        raise ValueError(f"{p.name!r} cannot have {announced} entries")  # noqa: TRY301
                    size = int(announced)
                    offset += p.size_dtype.itemsize
                values = np.frombuffer(body, p.dtype, size, offset) if size else np.empty(0)
                columns[p.name].append(values)
                offset += values.nbytes
    except ValueError as error:
        raise InvalidInputError(
            f"ends before the {element.count} rows of {element.name!r} that its header announces"
            f" ({error}); the file may be cut short or damaged"
        ) from error
    return dict(columns), offset


def _row_ends(elements: list[_Element], columns: dict[str, Columns]) -> NDArray[np.int64]:
    """Return how many numbers there are up to the end of each row, and 0."""
    widths = [np.zeros(1, dtype=np.int64)]
    for element in elements:
        if not columns[element.name]:
            continue
        widths.append(np.zeros(element.count, dtype=np.int64))
        for p in element.properties:
            lists = columns[element.name][p.name]
            if p.size_dtype is None:
                widths[-1] += 1
            elif isinstance(lists, np.ndarray):
                widths[-1] += 1 + lists.shape[1]
            else:
                widths[-1] += [1 + len(values) for values in lists]
    return np.cumsum(np.concatenate(widths))


def _faces(columns: Columns) -> NDArray[np.int64]:
    named = [columns[name] for name in CORNERS if name in columns]
    if not named:
        found = ", ".join(columns) or "nothing"
        raise InvalidInputError(f"faces must have vertex_indices, got {found}")
    corners = named[0]
    flat = np.ravel(corners) if isinstance(corners, np.ndarray) else np.concatenate(corners)
    # Where a double holds every integer; NaN is in no range.
    if flat.dtype.kind == "f" and not ((flat == np.rint(flat)) & (np.abs(flat) < 2**53)).all():
        raise InvalidInputError("faces must hold whole numbers")
    if isinstance(corners, np.ndarray) and corners.shape[1] == 3:
        return corners.astype(np.int64)
    return triangle_fans([row.astype(np.int64).tolist() for row in corners])


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
