"""Meshes of finite elements, in formats that meshio reads: the extra `meshio` installs it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from spectra_kit._core.optional import optional
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.formats._arrays import Arrays
from spectra_kit.geometry.formats.foreign import held_by, read_by

MODULES = {".mesh": "medit", ".msh": "gmsh"}


_COUNTS = re.compile(rb"^(?:\$?[A-Z][A-Za-z]+)\s+(\d+)(?:[ \t]+(\d+))?", re.MULTILINE)


def read(path: Path) -> Arrays:
    """Return the points, and the triangles, quads and polygons."""
    thing = mesh_of(path)
    return held_by(thing, "meshio.read(path)", is_bare=not thing.cells)


def mesh_of(path: Path) -> Any:
    """Return a file as meshio has it.

    What a file announces is what meshio makes room for, and waits for, however short it is.
    """
    suffix = path.suffix.lower()
    data = path.read_bytes()
    if suffix == ".msh" and data.lstrip()[:1] == b"(":  # which meshio writes of that name, too
        raise InvalidInputError(
            "is a mesh of ANSYS, expected one of Gmsh",
            advice="hand over meshio.read(path), or write it by meshio.write(path, mesh,"
            ' file_format="gmsh")',
        )
    announced = max((int(n[:18]) for found in _COUNTS.findall(data) for n in found if n), default=0)
    if announced > len(data):
        raise InvalidInputError(
            f"announces {announced:,} of a kind in {len(data):,} bytes; it may be damaged"
        )
    for part in (b"Nodes", b"Elements"):  # of which meshio says as much on stderr
        if b"$" + part in data and b"$End" + part not in data:
            raise InvalidInputError(f"does not end its ${part.decode()}; it may be cut short")
    meshio = optional("meshio", extra="meshio", needed_by=f"reading {suffix[1:]}")
    # By its module: `meshio.read` ends the process where it fails.
    module = getattr(meshio, MODULES[suffix])
    with read_by("meshio", meshio.ReadError):
        return module.read(str(path))
