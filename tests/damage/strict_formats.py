"""What a file of each geometry format says, read to the letter and with nothing of the library.

A function takes the bytes and returns points (n, 3) and faces (f, 3) or None; it raises ValueError
where the bytes are not what the format describes. Slow and plain, to be compared with.
"""

from __future__ import annotations

import io
import itertools
import math
import re
import struct
from collections.abc import Callable, Iterator

import numpy as np

Shape = tuple[np.ndarray, np.ndarray | None]

NUMBER = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
INTEGER = re.compile(rb"[+-]?\d+")
OBJ_WORDS = frozenset(
    b"vt vn vp g s mg o p l curv curv2 surf fo deg bmat step cstype parm trim hole scrv sp end con"
    b" bevel c_interp d_interp lod usemtl mtllib usemap maplib shadow_obj trace_obj ctech stech"
    b" call csh".split()
)


def number(word: bytes) -> float:
    if not NUMBER.fullmatch(word) or not math.isfinite(float(word)):
        raise ValueError(word)
    return float(word)


def integer(word: bytes) -> int:
    if not INTEGER.fullmatch(word):
        raise ValueError(word)
    return int(word)


def lines(data: bytes) -> Iterator[list[bytes]]:
    """Words of the lines that hold any, without comments."""
    data = data.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    for line in re.sub(rb"\\\n", b" ", data).split(b"\n"):
        if line.endswith(b"\\"):
            raise ValueError(line)
        words = re.split(rb"[\s\x1c-\x1f]+", line.partition(b"#")[0].strip(WHITE))
        if words != [b""]:
            yield words


WHITE = b" \t\n\r\v\f\x1c\x1d\x1e\x1f"


def fans(polygons: list[list[int]], n: int) -> np.ndarray:
    faces = []
    for corners in polygons:
        if len(corners) < 3 or min(corners) < 0 or max(corners) >= n:
            raise ValueError(corners)
        faces += [(corners[0], a, b) for a, b in itertools.pairwise(corners[1:])]
    if not faces:
        raise ValueError("no face")
    return np.array(faces)


def obj(data: bytes) -> Shape:
    points: list[list[float]] = []
    polygons = []
    for keyword, *words in lines(data):
        if keyword == b"v":
            values = [number(word) for word in words]
            if len(values) not in (3, 4, 6, 7) or (len(values) == 4 and values[3] != 1):
                raise ValueError(words)
            points.append(values[:3])
        elif keyword == b"f":
            if len({word.count(b"/") for word in words}) != 1:
                raise ValueError(words)
            corners = [integer(word.split(b"/")[0]) for word in words]
            polygons.append([c - 1 if c > 0 else c + len(points) if c else -1 for c in corners])
        elif keyword not in OBJ_WORDS:
            raise ValueError(keyword)
    return np.array(points), fans(polygons, len(points))


def off(data: bytes) -> Shape:
    (keyword, *counts), *body = lines(data)
    glued = re.fullmatch(rb"(?:ST)?C?N?OFF(\d*)", keyword)
    if not glued:
        raise ValueError(keyword)
    counts = [glued[1]] * bool(glued[1]) + counts
    if not counts:
        counts, *body = body
    n, f = (integer(word) for word in counts[:2])
    if n < 1 or f < 0 or len(body) != n + f or len({len(words) for words in body[:n]}) != 1:
        raise ValueError("counts")
    points = [[number(word) for word in words[:3]] for words in body[:n]]
    sizes = [integer(words[0]) for words in body[n:]]
    polygons = [
        [integer(word) for word in words[1 : size + 1]]
        for size, words in zip(sizes, body[n:], strict=True)
    ]
    rest = {len(words) - size - 1 for size, words in zip(sizes, body[n:], strict=True)}
    if not rest <= {0, 3, 4} and rest != {1}:
        raise ValueError("colours")
    return three(points), fans(polygons, n) if f else None


def xyz(data: bytes) -> Shape:
    rows, mark = [], None
    for i, words in enumerate(lines(data)):
        line = b" ".join(words)
        if i == 0 and b"," in line:
            mark = b","
        rows.append(line.split(mark))
    if len({len(row) for row in rows}) != 1:
        raise ValueError("columns")
    return three([[number(word.strip()) for word in row[:3]] for row in rows]), None


def three(rows: object) -> np.ndarray:
    points = np.array(rows, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise ValueError(points.shape)
    return points


PLY_TYPES = {
    **{"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I"},
    **{"int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I"},
    **{"int64": "q", "uint64": "Q", "float": "f", "double": "d", "float32": "f", "float64": "d"},
}


def ply(data: bytes) -> Shape:
    end = re.compile(rb"^end_header[ \t]*\r?(?:\n|\Z)", re.MULTILINE)
    head, body = end.split(data, maxsplit=1)
    first, *header = [line.split() for line in head.split(b"\n") if line.split()]
    if first != [b"ply"]:
        raise ValueError(first)
    form, elements = None, []
    for words in header:
        if words[0] == b"format":
            form = form or words[1].decode()
        elif words[0] == b"element":
            _, name, count = words
            elements.append((name, integer(count), []))
        elif words[:2] == [b"property", b"list"]:
            size, kind, name = words[2:]
            elements[-1][2].append((name, PLY_TYPES[kind.decode()], PLY_TYPES[size.decode()]))
        elif words[0] == b"property":
            kind, name = words[1:]
            elements[-1][2].append((name, PLY_TYPES[kind.decode()], None))
        elif words[0] not in (b"comment", b"obj_info"):
            raise ValueError(words)
    values = _ply_words(body) if form == "ascii" else _ply_numbers(body, form)
    next(values)
    found: dict[bytes, list[dict[bytes, object]]] = {}
    for element, count, properties in elements:
        if element in found or len({p[0] for p in properties}) < len(properties) or count < 0:
            raise ValueError("twice")
        rows = found[element] = []
        for _ in range(count if properties else 0):
            row = {}
            for name, kind, size in properties:
                if size is None:
                    row[name] = values.send(kind)
                else:
                    length = values.send(size)
                    if size in "fd" or length != int(length) or length < 0:
                        raise ValueError("length")
                    row[name] = [values.send(kind) for _ in range(int(length))]
            rows.append(row)
    if values.send(None).strip(WHITE):
        raise ValueError("rest")
    points = three([[row[axis] for axis in (b"x", b"y", b"z")] for row in found[b"vertex"]])
    announced = sum(count for element, count, _ in elements if element == b"face")
    if not announced:
        return points, None
    polygons = [row.get(b"vertex_indices", row.get(b"vertex_index")) for row in found[b"face"]]
    if any(corner != int(corner) for corners in polygons for corner in corners):
        raise ValueError("corners")
    return points, fans([[int(corner) for corner in p] for p in polygons], len(points))


def _ply_words(body: bytes):
    """Give a number for each type that is sent; what is left for None."""
    words = body.split()
    place, asked = 0, (yield)
    while asked is not None:
        if place == len(words):
            raise ValueError("short")
        asked = yield number(words[place])
        place += 1
    yield b"".join(words[place:])


def _ply_numbers(body: bytes, form: str | None):
    mark = {"binary_little_endian": "<", "binary_big_endian": ">"}[form or ""]
    place, asked = 0, (yield)
    while asked is not None:
        size = struct.calcsize(mark + asked)
        if len(body) < place + size:
            raise ValueError("short")
        asked = yield struct.unpack_from(mark + asked, body, place)[0]
        place += size
    yield body[place:]


def npy(data: bytes) -> Shape:
    return three(np.load(io.BytesIO(data))), None


def npz(data: bytes) -> Shape:
    with np.load(io.BytesIO(data)) as arrays:
        return three(arrays["points"]), arrays["faces"]


PARSERS: dict[str, Callable[[bytes], Shape]] = {
    ".obj": obj,
    ".off": off,
    ".ply": ply,
    ".xyz": xyz,
    ".npy": npy,
    ".npz": npz,
}
