"""Meshes of finite elements, in formats that meshio reads: the extra `meshio` installs it."""

from __future__ import annotations

from pathlib import Path

from spectra_kit._core.optional import optional
from spectra_kit.geometry.formats._arrays import Arrays
from spectra_kit.geometry.formats.foreign import held_by, read_by

MODULES = {".inp": "abaqus", ".mesh": "medit", ".msh": "gmsh"}


def read(path: Path) -> Arrays:
    """Return the points, and the triangles, quads and polygons."""
    suffix = path.suffix.lower()
    meshio = optional("meshio", extra="meshio", needed_by=f"reading {suffix[1:]}")
    # By its module: `meshio.read` ends the process where it fails.
    module = getattr(meshio, MODULES[suffix])
    with read_by("meshio", meshio.ReadError):
        thing = module.read(str(path))
    return held_by(thing, "meshio.read(path)", is_bare=not thing.cells)
