"""`as_geometry`: what people have in hand becomes a mesh or a cloud, in one place."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from spectra_kit._core.checked import checked
from spectra_kit._core.validate import quantity
from spectra_kit._core.warn import warn
from spectra_kit.errors import IgnoredContentWarning
from spectra_kit.geometry.io import read
from spectra_kit.geometry.polygons import Polygons, surface
from spectra_kit.geometry.shapes import Geometry, GeometryLike, PointCloud, TriangleMesh
from spectra_kit.geometry.tetrahedra import TetrahedralMesh
from spectra_kit.geometry.toolkits import arrays_of, refused, spatial

_VOLUME = "tetrahedral_laplacian(mesh) is its operator, mesh.surface.mesh its surface"
_OTHERS = (
    "a path, a mesh or cloud of trimesh, PyVista or meshio, (vertices, faces), or points of shape"
    " (n, 3) make one, too"
)


def as_geometry(thing: Any) -> Geometry:
    """Make a geometry of what you have; every function that takes a geometry does so by itself.

    Parameters
    ----------
    thing : TriangleMesh, PointCloud, path-like, tuple, array_like or object of another library
        A `TriangleMesh` or `PointCloud` is returned as it is, a path is read. ``(vertices,
        faces)``, a ``trimesh.Trimesh``, a ``pyvista.PolyData``, a ``meshio.Mesh``, a
        ``lapy.TriaMesh``, a ``GiftiImage`` of nibabel, meshes of Open3D, PyMeshLab and PyTorch
        Geometric, and whatever has vertices and faces make a mesh; an array of shape (n, 3), and
        objects of these libraries that have points and no cells, a cloud. Points keep their order,
        and their number, but for NaN points that no face uses.

    Returns
    -------
    TriangleMesh or PointCloud
        In the unit of `thing`. Polygons become triangles. Planar vertices (n, 2) with faces get
        z = 0.

    Warns
    -----
    IgnoredContentWarning
        If there is more in `thing` that is no part of a surface: lines, vertex cells and volumes
        beside its faces, NaN points that no face uses, or what follows the faces in a tuple.

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
def _same(thing: GeometryLike) -> Geometry:
    """Return what the annotation lets through, or makes of it."""
    return thing


def adapted(thing: Any) -> Geometry:
    """Make a geometry of what is none yet."""
    if isinstance(thing, str | os.PathLike):
        return read(thing)
    if not isinstance(thing, np.ndarray) and (arrays := arrays_of(thing)) is not None:
        points, faces = np.asarray(arrays[0]), arrays[1]
        return PointCloud(points) if faces is None else surface(points, faces)
    if isinstance(thing, tuple | list) and len(thing) > 1 and _is_table(thing[0]):
        points, faces, *others = thing
        is_ragged = isinstance(faces, list | tuple) and all(map(_is_row, faces))
        if _is_table(faces) if not others else _is_table(faces, "iu"):
            if others:  # as readers return normals, values and headers
                warn(
                    f"passed over what follows the faces: {quantity(len(others), 'item')}",
                    IgnoredContentWarning,
                )
            return _of_table(spatial(points), faces)
        if is_ragged and not others:
            return surface(spatial(points), Polygons.of(faces))
    if all(_is_table(getattr(thing, name, None)) for name in ("vertices", "faces")):
        return _of_table(np.asarray(thing.vertices), np.asarray(thing.faces))
    if not isinstance(thing, bytes) and (
        isinstance(thing, Sequence) or hasattr(thing, "__array__")
    ):
        return PointCloud(thing)
    raise refused(thing, _VOLUME if isinstance(thing, TetrahedralMesh) else _OTHERS)


def _of_table(points: Any, faces: Any) -> TriangleMesh:
    """Return the mesh of arrays; rows of four may be quads or tetrahedra, which no array says."""
    return surface(points, faces) if np.shape(faces)[1] == 3 else TriangleMesh(points, faces)


def _is_table(part: Any, kinds: str = "") -> bool:
    try:
        return np.ndim(part) == 2 and (not kinds or np.asarray(part).dtype.kind in kinds)
    except ValueError:  # rows of several lengths
        return False


def _is_row(part: Any) -> bool:
    return isinstance(part, list | tuple | np.ndarray) and all(
        isinstance(corner, int | np.integer) for corner in part
    )


TriangleMesh._made_of = PointCloud._made_of = adapted
