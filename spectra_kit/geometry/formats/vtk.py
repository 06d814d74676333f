"""VTK's own formats, old (vtk) and XML (vtp, vtu), read and written by VTK."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from spectra_kit._core.validate import quantity
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.formats._arrays import Arrays
from spectra_kit.geometry.formats._room import room
from spectra_kit.geometry.formats.foreign import held_by, read_by
from spectra_kit.geometry.shapes import Geometry, TriangleMesh

_COUNTS = re.compile(
    rb'NumberOf\w+="\s*(\d+)|^(?:POINTS|VERTICES|LINES|POLYGONS|TRIANGLE_STRIPS|CELLS|CELL_TYPES)'
    rb"\s+(\d+)(?:\s+(\d+))?",
    re.MULTILINE,
)
# Where the last cell ends, which XML says beside the number of cells.
_ENDS = re.compile(rb'Name="offsets"[^>]*RangeMax="(\d+)"')
_SMALLEST = 4  # bytes of what is counted, once unpacked


def read(path: Path) -> Arrays:
    """Return vertices and faces of a PolyData, or of a grid whose cells are flat."""
    thing = object_of(path)
    return held_by(thing, "pyvista.read(path)", is_bare=not thing.n_cells)


def object_of(path: Path) -> Any:
    """Return a file as PyVista has it.

    VTK makes room for what a file announces, and dies of strange headers, before it says a word.
    """
    data = path.read_bytes()
    is_old = path.suffix.lower() == ".vtk"
    if is_old and not re.match(rb"# vtk DataFile Version \d\.\d\s", data):
        raise InvalidInputError("must begin with '# vtk DataFile Version'")
    announced = max((int(n) for found in _COUNTS.findall(data) for n in found if n), default=0)
    if announced * _SMALLEST > room(len(data)):
        raise InvalidInputError(
            f"announces {announced:,} of a kind in {len(data):,} bytes; it may be damaged"
        )
    thing = _object(path)
    ends = sum(int(end) for end in _ENDS.findall(data))
    if ends and ends != (held := _n_corners(thing)):
        raise InvalidInputError(
            f"counts {quantity(held, 'corner')} of cells in {ends:,}; it may be damaged"
        )
    return thing


def _n_corners(thing: Any) -> int:
    """Return how many corners all cells have."""
    parts = ("GetVerts", "GetLines", "GetPolys", "GetStrips", "GetCells")
    cells = [getattr(thing, part)() for part in parts if hasattr(thing, part)]
    return sum(one.GetNumberOfConnectivityIds() for one in cells if one is not None)


def _object(path: Path) -> Any:
    """Return what VTK reads, if it has nothing to complain of."""
    import pyvista  # which is slow to import; its own `read` logs, and goes on
    from vtkmodules import vtkIOLegacy, vtkIOXML

    reader: Any = {
        ".vtk": vtkIOLegacy.vtkGenericDataObjectReader,
        ".vtp": vtkIOXML.vtkXMLPolyDataReader,
        ".vtu": vtkIOXML.vtkXMLUnstructuredGridReader,
    }[path.suffix.lower()]()
    with read_by("VTK"), pyvista.vtk_verbosity("off"):
        with pyvista.VtkErrorCatcher(send_to_logging=False) as heard:
            reader.SetFileName(str(path))
            reader.Update()
        if heard.events:
            raise ValueError(heard.events[0].alert)
        return pyvista.wrap(reader.GetOutput())


def write(geometry: Geometry, path: Path, fields: Mapping[str, Any] | None = None) -> None:
    """Write binary, with double coordinates, and `fields` of the points."""
    import pyvista

    points: Any = np.array(geometry.points)
    made: Any = pyvista.PolyData(points)
    if isinstance(geometry, TriangleMesh):
        faces: Any = np.array(geometry.faces)
        made = pyvista.PolyData.from_regular_faces(points, faces)
    made.point_data.update({name: np.array(values) for name, values in (fields or {}).items()})
    made.save(path)
