"""NumPy's npy (points) and npz (points with faces, or alone)."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path
from tokenize import TokenError

import numpy as np

from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.formats._arrays import Arrays
from spectra_kit.geometry.shapes import Geometry, PointCloud, TriangleMesh

# What NumPy, zipfile and zlib raise on damaged files; an OSError here is a seek to a bad place.
BROKEN = (
    ValueError,
    EOFError,
    OSError,
    NotImplementedError,
    TokenError,
    zipfile.BadZipFile,
    zlib.error,
)
POINTS, FACES = ("points", "V", "vertices", "verts"), ("faces", "F")


def read_npy(path: Path) -> Arrays:
    """Return the array as points."""
    _check_beginning(path, b"\x93NUMPY", "npy")
    try:
        return np.load(path, allow_pickle=False), None
    except BROKEN as error:
        raise InvalidInputError(f"not a whole npy file of numbers ({_told(error)})") from error


def write_npy(cloud: PointCloud, path: Path) -> None:
    """Write the points as they are."""
    with path.open("wb") as file:  # given a name, NumPy would append ".npy" to ".NPY"
        np.save(file, cloud.points)


def read_npz(path: Path) -> Arrays:
    """Return ``points`` (or V, vertices, verts) and ``faces`` (or F), which may be absent."""
    _check_beginning(path, b"PK", "npz")
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            points = [name for name in POINTS if name in archive]
            faces = [name for name in FACES if name in archive]
            if len(points) == 1 and len(faces) <= 1:
                return archive[points[0]], archive[faces[0]] if faces else None
            found = ", ".join(archive.files) or "nothing"
    except BROKEN as error:
        raise InvalidInputError(f"not a whole npz file of numbers ({_told(error)})") from error
    raise InvalidInputError(
        f"must hold one array of points (called {', '.join(POINTS)}) and at most one of"
        f" faces ({', '.join(FACES)}), got {found}"
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


def _told(error: Exception) -> str:
    """What went wrong; NumPy's advice for its objects would let a file run any code."""
    return "it holds Python objects" if "allow_pickle" in str(error) else str(error)
