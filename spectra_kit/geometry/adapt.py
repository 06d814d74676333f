"""`as_geometry`: what people have in hand becomes a mesh or a cloud, in one place."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from spectra_kit._core.checked import checked
from spectra_kit._core.validate import quantity
from spectra_kit._core.warn import warn
from spectra_kit.errors import IgnoredContentWarning, InvalidInputError
from spectra_kit.geometry.io import read
from spectra_kit.geometry.polygons import Polygons, surface
from spectra_kit.geometry.shapes import Geometry, PointCloud, TriangleMesh
from spectra_kit.geometry.tetrahedra import TetrahedralMesh

_OTHERS = (
    "a path, a mesh or cloud of trimesh, PyVista or meshio, (vertices, faces), or points of shape"
    " (n, 3) make one, too"
)
_CURVES = "curves are no surface; its {}, an array, make a cloud"


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
def _same(thing: Geometry) -> Geometry:
    """Return what the annotation lets through, or makes of it."""
    return thing


def adapted(thing: Any) -> Geometry:
    """Make a geometry of what is none yet."""
    if isinstance(thing, str | os.PathLike):
        return read(thing)
    # By the names of the modules: no package is imported for what is not its own.
    bases = () if isinstance(thing, np.ndarray) else type(thing).__mro__
    toolkits = {base.__module__.partition(".")[0] for base in bases}
    for toolkit, made_of in _TOOLKITS.items():
        if toolkit in toolkits:
            return made_of(thing)
    if isinstance(thing, tuple | list) and len(thing) > 1 and _is_table(thing[0]):
        points, faces, *others = thing
        is_ragged = isinstance(faces, list | tuple) and all(map(_is_row, faces))
        if _is_table(faces) if not others else _is_table(faces, "iu"):
            if others:  # as readers return normals, values and headers
                warn(
                    f"passed over what follows the faces: {quantity(len(others), 'item')}",
                    IgnoredContentWarning,
                )
            return _of_table(_spatial(points), faces)
        if is_ragged and not others:
            return surface(_spatial(points), Polygons.of(faces))
    if all(_is_table(getattr(thing, name, None)) for name in ("vertices", "faces")):
        return _of_table(np.asarray(thing.vertices), np.asarray(thing.faces))
    if not isinstance(thing, bytes) and (
        isinstance(thing, Sequence) or hasattr(thing, "__array__")
    ):
        return PointCloud(thing)
    is_volume = isinstance(thing, TetrahedralMesh)
    raise _refused(thing, "its surface is mesh.surface.mesh" if is_volume else _OTHERS)


def _of_trimesh(thing: Any) -> Geometry:
    if hasattr(thing, "faces"):
        return surface(np.asarray(thing.vertices), np.asarray(thing.faces))
    if hasattr(thing, "entities"):
        raise _refused(thing, _CURVES.format("vertices"))
    if hasattr(thing, "vertices"):
        return PointCloud(np.asarray(thing.vertices))
    raise _refused(thing, "of a Scene, scene.to_mesh() makes one mesh")


def _of_vtk(thing: Any) -> Geometry:
    import pyvista  # which is slow to import

    return _of_pyvista(pyvista.wrap(thing))


def _of_pyvista(thing: Any) -> Geometry:
    if not hasattr(thing, "GetNumberOfPolys"):
        whole = "combine()." if hasattr(thing, "combine") else ""
        raise _refused(thing, f"its surface is {whole}extract_surface()")
    cells = {"vertex cell": thing.GetNumberOfVerts(), "line": thing.GetNumberOfLines()}
    if thing.GetNumberOfStrips():
        thing = thing.triangulate()
    if not thing.GetNumberOfPolys():
        if cells["line"]:
            raise _refused(thing, _CURVES.format("points"))
        return PointCloud(np.asarray(thing.points))
    _warn_of(cells)
    table = np.asarray(thing.faces)
    width = table[0] + 1  # each row begins with the number of its corners
    is_regular = len(table) == width * thing.GetNumberOfPolys()
    if is_regular and (table[::width] == table[0]).all():
        return surface(thing.points, Polygons.of(table.reshape(-1, width)[:, 1:]))
    return surface(thing.points, Polygons.of(thing.irregular_faces))


def _of_meshio(thing: Any) -> Geometry:
    others: Counter[str] = Counter()
    polygons = []
    for block in thing.cells:
        if block.type in ("triangle", "quad") or block.type.startswith("polygon"):
            polygons.append(Polygons.of(block.data))
        else:
            others[f"{block.type} cell"] += len(block.data)
    if not others.keys() - {"vertex cell"} and not polygons:
        return PointCloud(_spatial(thing.points))
    if not others.keys() - {"vertex cell", "line cell"} and not polygons:
        raise _refused(thing, _CURVES.format("points"))
    # Volumes have a surface; triangles with points between their corners are more of one.
    if not polygons or any(kind.startswith(("triangle", "quad")) for kind in others):
        raise _refused(thing, "its surface is pyvista.wrap(mesh).extract_surface()")
    _warn_of(others)
    joined = Polygons(*map(np.concatenate, zip(*polygons, strict=True)))
    return surface(_spatial(thing.points), joined)


def _of_lapy(thing: Any) -> Geometry:
    if np.shape(thing.t)[1] != 3:
        raise _refused(thing, "its surface is boundary_tria()")
    return TriangleMesh(thing.v, thing.t)


def _of_nibabel(thing: Any) -> Geometry:
    if not hasattr(thing, "agg_data"):
        advice = "skimage.measure.marching_cubes(image.get_fdata(), level) makes a surface of it"
        raise _refused(thing, advice)
    points, faces = (thing.agg_data(kind) for kind in ("pointset", "triangle"))
    if not (_is_table(points) and _is_table(faces)):
        raise _refused(thing, "it holds no surface, which is a point set and its triangles")
    return TriangleMesh(points, faces)


def _of_open3d(thing: Any) -> Geometry:
    if hasattr(thing, "to_legacy"):
        thing = thing.to_legacy()
    if hasattr(thing, "triangles") and len(thing.triangles):
        return TriangleMesh(np.asarray(thing.vertices), np.asarray(thing.triangles))
    if hasattr(thing, "lines") or not hasattr(thing, "points"):
        raise _refused(thing, "of its points, an array makes a cloud")
    return PointCloud(np.asarray(thing.points))


def _of_pymeshlab(thing: Any) -> Geometry:
    if hasattr(thing, "current_mesh"):
        thing = thing.current_mesh()
    points, faces = thing.vertex_matrix(), thing.face_matrix()
    return TriangleMesh(points, faces) if len(faces) else PointCloud(points)


def _of_torch_geometric(thing: Any) -> Geometry:
    faces = getattr(thing, "face", None)
    return PointCloud(thing.pos) if faces is None else TriangleMesh(thing.pos, faces.T)


_TOOLKITS: dict[str, Callable[[Any], Geometry]] = {
    "trimesh": _of_trimesh,
    "pyvista": _of_pyvista,  # whose classes are VTK's, too
    "vtkmodules": _of_vtk,
    "meshio": _of_meshio,
    "lapy": _of_lapy,
    "nibabel": _of_nibabel,
    "open3d": _of_open3d,
    "pymeshlab": _of_pymeshlab,
    "torch_geometric": _of_torch_geometric,
}


def _of_table(points: Any, faces: Any) -> TriangleMesh:
    """Return the mesh of arrays; rows of four may be quads or tetrahedra, which no array says."""
    return surface(points, faces) if np.shape(faces)[1] == 3 else TriangleMesh(points, faces)


def _spatial(points: Any) -> Any:
    """Return planar points (n, 2), of what says by its faces that it is a surface, in space."""
    planar = np.asarray(points)
    if planar.ndim != 2 or planar.shape[1] != 2:
        return points
    return np.column_stack([planar, np.zeros(len(planar))])


def _warn_of(cells: dict[str, int]) -> None:
    if told := ", ".join(quantity(n, kind) for kind, n in cells.items() if n):
        warn(f"passed over {told} beside the faces", IgnoredContentWarning)


def _refused(thing: Any, advice: str) -> InvalidInputError:
    name = type(thing).__name__
    return InvalidInputError("thing", "be a TriangleMesh or PointCloud", name, advice=advice)


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
