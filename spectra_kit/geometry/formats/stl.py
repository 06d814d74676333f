"""STL, binary and ASCII: loose triangles, whose coincident corners are one vertex."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.formats._arrays import Arrays, real
from spectra_kit.geometry.shapes import TriangleMesh

HEADER = 80
WORDS = f"facet normal 0 0 0 outer loop {'vertex 0 0 0 ' * 3} endloop endfacet".split()
PATTERN = np.array(WORDS, dtype=object)
NUMBERS = PATTERN == "0"
CORNERS = NUMBERS & (np.arange(len(PATTERN)) > 4)  # without the normal, of which nothing is asked
FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read(path: Path) -> Arrays:
    """Return the mesh with exactly coincident corners joined, in order of first use.

    The format repeats a vertex in each of its triangles; joining them is reading it, not repair.
    """
    data = path.read_bytes()
    corners = _ascii_corners(data) if _is_ascii(data) else _binary_corners(data)
    if len(corners) == 0:
        raise InvalidInputError("holds no triangle")
    faces = np.arange(len(corners)).reshape(-1, 3)
    mesh = TriangleMesh(corners, faces).with_merged_vertices()
    return mesh.points, mesh.faces


def _is_ascii(data: bytes) -> bool:
    # Binary files may begin with "solid" too, but hold zero bytes early on.
    return data.lstrip()[:5].lower() == b"solid" and b"\0" not in data[:512]


def _binary_corners(data: bytes) -> NDArray[np.float64]:
    count = int.from_bytes(data[HEADER : HEADER + 4], "little")
    expected = HEADER + 4 + count * FACET.itemsize
    if len(data) != expected:
        raise InvalidInputError(
            f"the header announces {count} triangles, {expected} bytes, got {len(data)} bytes;"
            " the file may be cut short or no STL"
        )
    facets = np.frombuffer(data, dtype=FACET, offset=HEADER + 4)
    return np.asarray(facets["corners"].reshape(-1, 3), dtype=np.float64)


def _ascii_corners(data: bytes) -> NDArray[np.float64]:
    text = data.decode("utf-8", errors="replace").lower()
    head, *rest = re.split(r"^[ \t]*((?:end)?solid)\b.*$", text, flags=re.MULTILINE)
    marks, parts = rest[::2], rest[1::2]
    outside = [head, *parts[1::2]]
    if marks != ["solid", "endsolid"] * (len(marks) // 2) or any(map(str.split, outside)):
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
        return np.array([real(word) for word in facets[:, CORNERS].ravel()]).reshape(-1, 3)
    except ValueError as error:
        raise InvalidInputError(f"a vertex line must hold three numbers ({error})") from error


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
