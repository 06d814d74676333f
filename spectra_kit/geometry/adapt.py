"""`as_geometry`: what people have in hand becomes a mesh or a cloud, in one place."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from spectra_kit._checked import checked
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.io import read
from spectra_kit.geometry.shapes import Geometry, PointCloud, TriangleMesh

_OTHERS = (
    "a path, a mesh or cloud of trimesh or PyVista, (vertices, faces), or points of shape (n, 3)"
    " make one, too"
)


def as_geometry(thing: Any) -> Geometry:
    """Make a geometry of what you have; every function that takes a geometry does so by itself.

    Parameters
    ----------
    thing : TriangleMesh, PointCloud, path-like, trimesh, pyvista.PolyData, tuple or array_like
        A `TriangleMesh` or `PointCloud` is returned as it is, a path is read. A
        ``trimesh.Trimesh``, a ``pyvista.PolyData`` of triangles and ``(vertices, faces)`` make a
        mesh; a ``trimesh.PointCloud``, a ``PolyData`` without faces and an array of shape (n, 3)
        a cloud. Points keep their order and their number.

    Returns
    -------
    TriangleMesh or PointCloud
        In the unit of `thing`.

    Raises
    ------
    InvalidInputError
        If it is none of these, a file cannot be read, or the arrays are no valid geometry.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> sk.as_geometry(([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]))
    TriangleMesh(3 vertices, 1 faces)
    >>> sk.as_geometry([[0, 0, 0], [1, 0, 0]])
    PointCloud(2 points)
    """
    return _same(thing)


@checked
def _same(thing: Geometry) -> Geometry:
    """Return what the annotation lets through, or makes of it."""
    return thing


def adapted(thing: Any) -> Geometry:
    """Make a geometry of what is none yet."""
    if isinstance(thing, str | os.PathLike):
        return read(thing)
    # By the names of the modules: neither package is imported for what is not its own.
    toolkits = {base.__module__.partition(".")[0] for base in type(thing).__mro__}
    if "trimesh" in toolkits:
        return _of_trimesh(thing)
    if "pyvista" in toolkits:
        return _of_pyvista(thing)
    if isinstance(thing, tuple | list) and len(thing) == 2 and all(map(_is_table, thing)):
        return TriangleMesh(*thing)
    if not isinstance(thing, bytes) and (
        isinstance(thing, Sequence) or hasattr(thing, "__array__")
    ):
        return PointCloud(thing)
    raise _refused(thing, _OTHERS)


def _of_trimesh(thing: Any) -> Geometry:
    if hasattr(thing, "faces"):
        return TriangleMesh(np.asarray(thing.vertices), np.asarray(thing.faces))
    if hasattr(thing, "entities"):
        raise _refused(thing, "curves are no surface; its vertices, an array, make a cloud")
    if hasattr(thing, "vertices"):
        return PointCloud(np.asarray(thing.vertices))
    raise _refused(thing, "of a Scene, scene.to_mesh() makes one mesh")


def _of_pyvista(thing: Any) -> Geometry:
    if not hasattr(thing, "GetNumberOfPolys"):
        whole = "combine()." if hasattr(thing, "combine") else ""
        raise _refused(thing, f"its surface is {whole}extract_surface().triangulate()")
    if thing.GetNumberOfLines() or thing.GetNumberOfStrips():
        raise _refused(thing, "it has lines or strips; triangulate() leaves triangles alone")
    if not thing.GetNumberOfPolys():
        return PointCloud(np.asarray(thing.points))
    if not thing.is_all_triangles:
        raise _refused(thing, "it has faces of more than three corners; triangulate() cuts them")
    return TriangleMesh(np.asarray(thing.points), np.asarray(thing.regular_faces))


def _refused(thing: Any, advice: str) -> InvalidInputError:
    name = type(thing).__name__
    return InvalidInputError("thing", "be a TriangleMesh or PointCloud", name, advice=advice)


def _is_table(part: Any) -> bool:
    try:
        return np.ndim(part) == 2
    except ValueError:  # rows of several lengths
        return False
