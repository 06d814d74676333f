"""`TetrahedralMesh`: a volume cut into tetrahedra, and its surface with the way back."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spectra_kit._core.checked import checked
from spectra_kit._core.records import Rebuilt, frozen
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import as_array, check_indices, check_points, quantity
from spectra_kit._core.warn import warn
from spectra_kit.errors import IgnoredContentWarning, InvalidInputError
from spectra_kit.geometry.formats import elements, vtk
from spectra_kit.geometry.io import taken_of
from spectra_kit.geometry.shapes import TriangleMesh, distinct_rows

_BLOCK = 1 << 15
_FLAT = 1e-14  # of the cube of the longest side: a determinant below has no digit that counts
#: The face opposite each corner, wound outwards where the determinant of the cell is positive.
_FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])


class BoundarySurface(NamedTuple):
    """The surface of a volume.

    Attributes
    ----------
    mesh : TriangleMesh
        Closed, wound outwards.
    vertex_index : ndarray of shape (n,)
        The vertex of the volume that each of its vertices is, ascending.
    """

    mesh: TriangleMesh
    vertex_index: Ints


@checked
@dataclass(frozen=True, eq=False)
class TetrahedralMesh(Rebuilt):
    """A volume cut into tetrahedra.

    Where one is asked for, whatever `of` takes does as well: a file, ``(points, cells)``. The
    constructor refuses NaN and indices out of range, and keeps all else as it came.

    Parameters
    ----------
    points : array_like of shape (n, 3)
        Vertex coordinates, in any unit of length.
    cells : array_like of shape (m, 4)
        Vertex indices of each tetrahedron, counted from 0; of either orientation.

    Examples
    --------
    >>> from spectra_kit.geometry import TetrahedralMesh
    >>> corner = TetrahedralMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2, 3]])
    >>> round(6 * corner.volume, 12), corner.surface.mesh
    (1.0, TriangleMesh(4 vertices, 4 faces))
    """

    points: Floats
    cells: Ints

    if TYPE_CHECKING:  # what it is made of is more than what it holds

        def __init__(self, points: ArrayLike, cells: ArrayLike) -> None: ...

    def __post_init__(self) -> None:
        points, cells = check_points("points", self.points), as_array("cells", self.cells)
        if cells.ndim != 2 or cells.shape[1] != 4 or not len(cells):
            raise InvalidInputError("cells", "have shape (m, 4), m >= 1", cells.shape)
        cells = check_indices("cells", cells, len(points))
        object.__setattr__(self, "points", frozen(points.copy()))
        object.__setattr__(self, "cells", frozen(cells.copy()))

    @property
    def n(self) -> int:
        """Number of vertices."""
        return len(self.points)

    @cached_property
    def cell_volumes(self) -> Floats:
        """Volume of each tetrahedron, shape (m,), in length^3; infinite where it is no number."""
        with np.errstate(over="ignore"):
            return frozen(np.ldexp(np.abs(self._measured[0]) / 6, 3 * self._measured[1]))

    @property
    def volume(self) -> float:
        """Total volume, in length^3."""
        return float(self.cell_volumes.sum())

    @cached_property
    def surface(self) -> BoundarySurface:
        """The faces of one cell alone, and where their vertices are in the volume."""
        first, counts, faces = self._faces
        outer = faces[np.sort(first[counts == 1])]
        if not len(outer):
            advice = "is each cell there twice?"
            raise InvalidInputError("mesh", "have faces of one cell alone", "none", advice=advice)
        used = np.unique(outer)
        mesh = TriangleMesh(self.points[used], np.searchsorted(used, outer))
        return BoundarySurface(mesh, frozen(used))

    @property
    def boundary_vertices(self) -> Ints:
        """Vertices of the `surface`, ascending."""
        return self.surface.vertex_index

    def without_unreferenced(self) -> TetrahedralMesh:
        """Return the mesh with only those vertices that a cell uses, in their original order."""
        used = np.unique(self.cells)
        return TetrahedralMesh(self.points[used], np.searchsorted(used, self.cells))

    def without_degenerate_cells(self) -> TetrahedralMesh:
        """Return the mesh without `degenerate_cells`. Vertices stay, some without a cell."""
        return TetrahedralMesh(self.points, self.cells[~self.degenerate_cells()])

    def degenerate_cells(self) -> NDArray[np.bool_]:
        """Mark cells without a volume, and those of the same vertices as one before: (m,).

        Six times a volume is none up to 1e-14 of the cube of about the longest side.
        """
        flat = np.abs(self._measured[0]) <= _FLAT
        flat[np.setdiff1d(np.arange(len(flat)), distinct_rows(np.sort(self.cells, axis=1))[0])] = 1
        return flat

    @cached_property
    def _measured(self) -> tuple[Floats, NDArray[np.int32]]:
        """Signed six-fold volume of each cell, and its unit of length as a power of two."""
        blocks = [((a * cross(b, c)).sum(axis=0), e) for _, (a, b, c), e in scaled_sides(self)]
        return tuple(np.concatenate(parts) for parts in zip(*blocks, strict=True))  # type: ignore[return-value]

    @cached_property
    def _faces(self) -> tuple[Ints, Ints, Ints]:
        """Where each distinct face comes first, in how many cells it is, and all (4m, 3)."""
        turned = np.where(self._measured[0][:, None, None] < 0, _FACES[:, ::-1], _FACES)
        faces = np.take_along_axis(self.cells[:, None, :], turned, axis=2).reshape(-1, 3)
        a, b, c = np.sort(faces, axis=1).T
        order = np.lexsort((c, a * self.n + b))
        same = np.diff(np.stack([a, b, c])[:, order], axis=1, prepend=-1) == 0
        starts = np.flatnonzero(~same.all(axis=0))
        return order[starts], np.diff(np.append(starts, len(order))), faces

    @staticmethod
    def of(thing: Any) -> TetrahedralMesh:
        """Make one of a file, or of what another library has.

        Parameters
        ----------
        thing : path-like, or mesh of another library
            A file of Gmsh (``.msh``), MEDIT (``.mesh``; both by the extra ``meshio``) or VTK
            (``.vtk``, ``.vtu``); ``(points, cells)``, a ``lapy.TetMesh``, a ``meshio.Mesh``,
            PyVista's ``UnstructuredGrid`` or scikit-fem's ``MeshTet``.

        Returns
        -------
        TetrahedralMesh
            The linear tetrahedra alone; an `IgnoredContentWarning` tells of other cells.

        Raises
        ------
        InvalidFileError
            If the file is not there, damaged, of another format, or without linear tetrahedra.

        Examples
        --------
        >>> from spectra_kit.geometry import TetrahedralMesh
        >>> points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [9, 9, 9]]
        >>> TetrahedralMesh.of((points, [[0, 1, 2, 3]])).without_unreferenced().n
        4
        """
        if isinstance(thing, TetrahedralMesh):
            return thing
        if isinstance(thing, str | os.PathLike):
            return taken_of(Path(thing), _of_file)
        if isinstance(thing, tuple | list) and len(thing) == 2:
            return TetrahedralMesh(*thing)
        if hasattr(thing, "v") and hasattr(thing, "t"):  # of LaPy
            return TetrahedralMesh(thing.v, thing.t)
        if hasattr(thing, "p") and hasattr(thing, "t"):  # of scikit-fem, by columns
            return TetrahedralMesh(thing.p.T, thing.t.T)
        # By names, nothing is imported: of meshio by words, of PyVista by VTK's numbers.
        kinds = {str(kind): cells for kind, cells in getattr(thing, "cells_dict", {}).items()}
        cells = kinds.pop("tetra", kinds.pop("10", None))
        if cells is None:
            advice = "(points, cells), files and meshes of linear tetrahedra make one"
            raise InvalidInputError("thing", "be a TetrahedralMesh", advice=advice)
        if n := sum(map(len, kinds.values())):
            warn(f"passed over {quantity(n, 'cell')} beside the tetrahedra", IgnoredContentWarning)
        return TetrahedralMesh(thing.points, cells)

    _made_of = of


def _of_file(path: Path) -> TetrahedralMesh:
    suffix = path.suffix.lower()
    if suffix not in (*elements.MODULES, ".vtk", ".vtu"):
        problem = f"of {suffix!r} no tetrahedra are read; known are .msh, .mesh, .vtk and .vtu"
        raise InvalidInputError(problem, advice="hand over meshio.read(path)")
    thing = (elements.mesh_of if suffix in elements.MODULES else vtk.object_of)(path)
    try:
        return TetrahedralMesh.of(thing)
    except InvalidInputError as error:
        if error.argument != "thing":
            raise
        raise InvalidInputError("holds no linear tetrahedra") from error


def scaled_sides(mesh: TetrahedralMesh) -> Iterator[tuple[slice, Floats, NDArray[np.int32]]]:
    """Yield sides from the first corner to the others, (3 sides, 3, b), of blocks of cells.

    In a unit of each cell's own, two to the powers (b,) that come with them: nothing overflows.
    """
    columns = np.ascontiguousarray(mesh.points.T)
    for start in range(0, len(mesh.cells), _BLOCK):
        block = slice(start, start + _BLOCK)
        halves = columns[:, mesh.cells[block].T] / 2  # of which no difference overflows
        sides = np.moveaxis(halves[:, 1:] - halves[:, :1], 0, 1)
        exponents = np.frexp(np.abs(sides).max(axis=(0, 1)))[1]
        half = -exponents // 2  # one power of two might overflow
        yield block, np.ldexp(np.ldexp(sides, half), -exponents - half), exponents + 1


def cross(a: Floats, b: Floats) -> Floats:
    """Return the vector products of columns, (3, b)."""
    (ax, ay, az), (bx, by, bz) = a, b
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
