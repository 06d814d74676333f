"""A volume cut open, to see functions inside it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import real_array
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import TriangleMesh, box_unit
from spectra_kit.geometry.tetrahedra import TetrahedralMesh


@checked
def cut_open(
    mesh: TetrahedralMesh, values: ArrayLike, *, normal: ArrayLike = (1.0, 0.0, 0.0)
) -> tuple[TriangleMesh, Floats]:
    """Cut a volume through its middle, and return the surface of what is left, with the section.

    Parameters
    ----------
    mesh : TetrahedralMesh
        With n vertices.
    values : array_like of shape (n,) or (n, c)
        Functions, such as ``spectrum.eigenvectors``.
    normal : array_like of shape (3,), default (1, 0, 0)
        Of the plane, towards what is taken away.

    Returns
    -------
    tuple of TriangleMesh and ndarray
        For `plot_fields`: the surface and the values there, linear inside each cell.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    >>> surface, x = sk.show.cut_open((corners, [[0, 1, 2, 3]]), [0.0, 1.0, 0.0, 0.0])
    >>> round(float(x.max()), 3)
    0.5
    """
    import pyvista as pv  # slow to import

    functions, towards = real_array("values", values), real_array("normal", normal)
    if functions.ndim not in (1, 2) or len(functions) != mesh.n:
        raise InvalidInputError("values", f"have shape ({mesh.n}, c)", functions.shape)
    if towards.shape != (3,) or not towards.any():
        got = towards.shape if towards.any() else "zeros"
        raise InvalidInputError("normal", "be a vector of three numbers, not all zero", got)
    unit = box_unit(mesh.points)
    middle = mesh.points.min(axis=0) / 2 + mesh.points.max(axis=0) / 2
    grid = pv.UnstructuredGrid({pv.CellType.TETRA: mesh.cells}, (mesh.points - middle) / unit)
    grid.point_data["values"] = functions
    half = grid.clip(normal=towards / np.abs(towards).max(), origin=(0, 0, 0)).triangulate()
    points = np.asarray(half.points, dtype=np.float64) * unit + middle
    surface = TetrahedralMesh(points, half.cells_dict[pv.CellType.TETRA]).surface
    return surface.mesh, np.asarray(half.point_data["values"])[surface.vertex_index]
