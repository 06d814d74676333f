"""NumPy's npy (points) and npz (points with faces, or alone)."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.validate import check_faces
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.formats._arrays import BROKEN, Arrays
from spectra_kit.geometry.formats._room import MULTIPLE, room
from spectra_kit.geometry.shapes import Geometry, PointCloud, TriangleMesh

POINTS, FACES = ("points", "V", "vertices", "verts"), ("faces", "F")
# What others call them, in any case, where none is called so.
OTHER_POINTS, OTHER_FACES = ("vert", "v", "xyz"), ("triangles", "tris", "tri", "triv", "f")
_BLOCK = 1 << 20


def read_npy(path: Path) -> Arrays:
    """Return the array as points."""
    _check_beginning(path, b"\x93NUMPY", "npy")
    try:
        with path.open("rb") as file:
            return _array(file, path.stat().st_size), None
    except BROKEN as error:
        raise InvalidInputError(f"not a whole npy file of numbers ({error})") from error


def _array(file: IO[bytes], size: int) -> NDArray[np.generic]:
    """Return the array that `file` of `size` bytes holds, all of it and nothing else.

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
    held = size - file.tell()
    if held != math.prod(shape) * dtype.itemsize:
        raise ValueError(f"its header announces shape {shape} of {dtype}, got {held} bytes")
    data = bytearray(held)
    for start in range(0, held, _BLOCK):
        block = file.read(min(_BLOCK, held - start))
        data[start : start + len(block)] = block
    if len(data) != held or file.read(1):
        raise ValueError(f"it has not the {held} bytes of its header")
    return np.frombuffer(data, dtype).reshape(shape, order="F" if by_columns else "C")


def write_npy(cloud: PointCloud, path: Path) -> None:
    """Write the points as they are."""
    with path.open("wb") as file:  # given a name, NumPy would append ".npy" to ".NPY"
        np.save(file, cloud.points)


def read_npz(path: Path) -> Arrays:
    """Return ``points`` (or V, vertices, verts) and ``faces`` (or F), which may be absent.

    Packed arrays may take as much as `room` says. Arrays of other names are somebody else's.
    """
    _check_beginning(path, b"PK", "npz")
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            for member in members:
                archive.open(member).close()  # compares what the two tables say of it
            names = [member.filename.removesuffix(".npy") for member in members]
            points, faces = _chosen(names)
            chosen = [members[i] for i in points + faces]
            _check_packing(chosen, path.stat().st_size)
            arrays = []
            for member in chosen:
                with archive.open(member) as file:
                    arrays.append(_array(file, member.file_size))
    except InvalidInputError:
        raise
    except BROKEN as error:
        raise InvalidInputError(f"not a whole npz file of numbers ({error})") from error
    is_matlab = bool(faces) and names[faces[0]].lower() == "triv" and arrays[1].dtype.kind in "iu"
    if is_matlab and arrays[1].size and arrays[1].min() > 0:
        raise InvalidInputError(  # as MATLAB writes it
            f"{names[faces[0]]} must count from 0, where no face uses vertex 0",
            advice="if it counts from 1, hand over d = numpy.load(path), (d[...], d[...] - 1); if"
            " not, call it faces",
        )
    if not faces or arrays[1].ndim != 2 or arrays[1].shape[1] <= 3:
        return arrays[0], arrays[1] if faces else None
    try:  # quads, or tetrahedra: no array says which
        return arrays[0], check_faces("faces", arrays[1], len(arrays[0]))
    except InvalidInputError as error:
        return arrays[0], error


def _chosen(names: Sequence[str]) -> tuple[list[int], list[int]]:
    """Return which of the arrays holds the points, and which the faces, if one does."""
    lower = [name.lower() for name in names]
    points = [i for i, name in enumerate(names) if name in POINTS]
    faces = [i for i, name in enumerate(names) if name in FACES]
    points = points or [i for i, name in enumerate(lower) if name in OTHER_POINTS]
    faces = faces or [i for i, name in enumerate(lower) if name in OTHER_FACES]
    if len(points) != 1 or len(faces) > 1:
        raise InvalidInputError(
            f"must hold one array of points (called {', '.join(POINTS)}) and at most one of faces"
            f" ({', '.join(FACES)}), got {', '.join(names) or 'nothing'}",
            advice="hand over those that you mean: d = numpy.load(path), (d[...], d[...])",
        )
    return points, faces


def _check_packing(members: Sequence[zipfile.ZipInfo], size: int) -> None:
    """Refuse what would unpack to too much, or by itself decides to how much."""
    if sum(member.file_size for member in members) > room(size):
        problem = f"its arrays unpack to more than {room(size):,} bytes: {MULTIPLE} times the file"
    elif not {m.compress_type for m in members} <= {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}:
        # `zipfile` bounds the output of deflation alone.
        problem = "its arrays are packed otherwise than NumPy packs them"
    else:
        return
    raise InvalidInputError(
        problem, advice="if it is right, numpy.savez(path, **numpy.load(path)) writes it unpacked"
    )


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
