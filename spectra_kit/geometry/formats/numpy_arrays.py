"""NumPy's npy (points) and npz (points with faces, or alone)."""

from __future__ import annotations

import lzma
import math
import zipfile
import zlib
from pathlib import Path
from tokenize import TokenError
from typing import IO

import numpy as np
from numpy.typing import NDArray

from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.formats._arrays import Arrays
from spectra_kit.geometry.shapes import Geometry, PointCloud, TriangleMesh

# What NumPy, zipfile and the decompressors raise on damaged files; an OSError here is a seek to a
# bad place, a RuntimeError an encrypted array or a header of a thousand brackets.
BROKEN = (
    ValueError,
    TypeError,
    LookupError,
    SyntaxError,
    EOFError,
    OSError,
    OverflowError,
    RuntimeError,
    TokenError,
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
)
POINTS, FACES = ("points", "V", "vertices", "verts"), ("faces", "F")


def read_npy(path: Path) -> Arrays:
    """Return the array as points."""
    _check_beginning(path, b"\x93NUMPY", "npy")
    try:
        with path.open("rb") as file:
            return _array(file), None
    except BROKEN as error:
        raise InvalidInputError(f"not a whole npy file of numbers ({error})") from error


def _array(file: IO[bytes]) -> NDArray[np.generic]:
    """Return the array that `file` holds, all of it and nothing else.

    `numpy.load` reads what the header announces, so that in an archive the checksum of a longer
    array is never compared, and makes room for it before it knows how much there is.
    """
    version, form = np.lib.format.read_magic(file), np.lib.format
    readers = {(1, 0): form.read_array_header_1_0, (2, 0): form.read_array_header_2_0}
    if version not in readers:
        raise ValueError(f"it has version {version}, known are (1, 0) and (2, 0)")
    shape, by_columns, dtype = readers[version](file)
    if dtype.hasobject:
        raise ValueError("it holds Python objects")
    data = file.read()
    if len(data) != math.prod(shape) * dtype.itemsize:
        raise ValueError(f"its header announces shape {shape} of {dtype}, got {len(data)} bytes")
    return np.frombuffer(data, dtype).reshape(shape, order="F" if by_columns else "C")


def write_npy(cloud: PointCloud, path: Path) -> None:
    """Write the points as they are."""
    with path.open("wb") as file:  # given a name, NumPy would append ".npy" to ".NPY"
        np.save(file, cloud.points)


def read_npz(path: Path) -> Arrays:
    """Return ``points`` (or V, vertices, verts) and ``faces`` (or F), which may be absent."""
    _check_beginning(path, b"PK", "npz")
    points, faces, names = [], [], []
    try:
        with zipfile.ZipFile(path) as archive:
            for member in archive.infolist():
                name = member.filename.removesuffix(".npy")
                names.append(name)
                with archive.open(member) as file:  # compares what the two tables say of it
                    if name in POINTS:
                        points.append(_array(file))
                    elif name in FACES:
                        faces.append(_array(file))
    except BROKEN as error:
        raise InvalidInputError(f"not a whole npz file of numbers ({error})") from error
    if len(points) != 1 or len(faces) > 1:
        raise InvalidInputError(
            f"must hold one array of points (called {', '.join(POINTS)}) and at most one of"
            f" faces ({', '.join(FACES)}), got {', '.join(names) or 'nothing'}"
        )
    return points[0], faces[0] if faces else None


def write_npz(geometry: Geometry, path: Path) -> None:
    """Write the arrays as they are."""
    with path.open("wb") as file:
        if isinstance(geometry, TriangleMesh):
            np.savez(file, points=geometry.points, faces=geometry.faces)
        else:
            np.savez(file, points=geometry.points)


def _check_beginning(path: Path, start: bytes, kind: str) -> None:
    """Refuse what is something else; NumPy would take it for a pickle."""
    with path.open("rb") as file:
        found = file.read(len(start))
    if found != start:
        raise InvalidInputError(
            f"not a whole {kind} file of numbers (it begins with {found!r}, not with {start!r})"
        )
