"""Objects of other libraries as points and faces, in the order that they have.

No package is imported for what is not its own. What is no surface or cloud is refused with the call
that makes one of it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from spectra_kit._core.validate import quantity
from spectra_kit._core.warn import warn
from spectra_kit.errors import IgnoredContentWarning, InvalidInputError
from spectra_kit.geometry.formats._arrays import Arrays, bands
from spectra_kit.geometry.polygons import Polygons

_CURVES = "curves are no surface; its {}, an array, make a cloud"
_RIGID = 1e-3  # of the squares of lengths, for matrices written in few digits
_VERTICES, _LINES, _FACES = (1, 2), (3, 4), (5, 7, 9)  # cells of VTK; 0 is nothing


def _of_trimesh(thing: Any) -> Arrays:
    if hasattr(thing, "faces"):
        return np.asarray(thing.vertices), np.asarray(thing.faces)
    if hasattr(thing, "entities"):
        raise refused(thing, _CURVES.format("vertices"))
    if hasattr(thing, "vertices"):
        return np.asarray(thing.vertices), None
    raise refused(thing, "of a Scene, scene.to_mesh() makes one mesh")


def _of_vtk(thing: Any) -> Arrays:
    import pyvista  # which is slow to import

    return _of_pyvista(pyvista.wrap(thing))


def _of_pyvista(thing: Any) -> Arrays:
    """Return what a PolyData holds, or an UnstructuredGrid whose cells are flat."""
    if hasattr(thing, "GetPolys"):
        n_vertices, n_lines = thing.GetNumberOfVerts(), thing.GetNumberOfLines()
        faces = _cells(thing.GetPolys())
        if thing.GetNumberOfStrips():
            strips = _cells(thing.GetStrips())
            corners = np.insert(strips.corners, np.cumsum(strips.sizes), -1)
            faces = _joined([faces, Polygons.of(bands(corners))])
    elif hasattr(thing, "celltypes"):
        types = np.asarray(thing.celltypes)
        if not np.isin(types, (0, *_VERTICES, *_LINES, *_FACES)).all():
            raise refused_volume(thing, "extract_surface()")
        n_vertices, n_lines = (int(np.isin(types, kind).sum()) for kind in (_VERTICES, _LINES))
        cells, is_face = _cells(thing.GetCells()), np.isin(types, _FACES)
        if len(types) != len(cells.sizes):
            raise InvalidInputError(f"has {len(types)} types of {len(cells.sizes)} cells")
        faces = Polygons(cells.corners[np.repeat(is_face, cells.sizes)], cells.sizes[is_face])
    else:
        whole = "combine()." if hasattr(thing, "combine") else ""
        raise refused_volume(thing, f"{whole}extract_surface()")
    if not len(faces.sizes):
        if n_lines:
            raise refused(thing, _CURVES.format("points"))
        return np.asarray(thing.points), None
    _warn_of({"vertex cell": n_vertices, "line": n_lines})
    return np.asarray(thing.points), faces


def _cells(cells: Any) -> Polygons:
    """Return the corners of VTK's cells; by its own way of listing them, damaged ones crash it."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    if cells is None or not cells.GetNumberOfCells():
        return Polygons.of(np.empty((0, 3), np.int64))
    offsets, corners = map(vtk_to_numpy, (cells.GetOffsetsArray(), cells.GetConnectivityArray()))
    sizes = np.diff(offsets.astype(np.int64))
    if offsets[0] != 0 or sizes.min() < 0 or offsets[-1] != len(corners):
        raise InvalidInputError(
            f"has cells that do not follow each other in its {len(corners)} corners",
            advice="it may be damaged",
        )
    return Polygons(corners.astype(np.int64), sizes)


def _of_meshio(thing: Any) -> Arrays:
    others: Counter[str] = Counter()
    polygons = []
    for block in thing.cells:
        if block.type in ("triangle", "quad") or block.type.startswith("polygon"):
            polygons.append(Polygons.of(block.data))
        else:
            others[f"{block.type} cell"] += len(block.data)
    points = spatial(thing.points)
    if not others.keys() - {"vertex cell"} and not polygons:
        return points, None
    if not others.keys() - {"vertex cell", "line cell"} and not polygons:
        raise refused(thing, _CURVES.format("points"))
    # Volumes have a surface; triangles with points between their corners are more of one.
    if not polygons or any(kind.startswith(("triangle", "quad")) for kind in others):
        raise refused_volume(thing, "pyvista.wrap(mesh).extract_surface()")
    _warn_of(others)
    return points, _joined(polygons)


def _of_lapy(thing: Any) -> Arrays:
    if np.shape(thing.t)[1] != 3:
        raise refused_volume(thing, "boundary_tria()")
    return thing.v, thing.t


def _of_nibabel(thing: Any) -> Arrays:
    if not hasattr(thing, "agg_data"):
        raise refused(thing, "of labels, geometry.from_labels(image) makes a surface of each")
    points, faces = (thing.agg_data(kind) for kind in ("pointset", "triangle"))
    if np.ndim(points) != 2 or np.ndim(faces) != 2:
        raise refused(thing, "it holds no surface, which is one point set and its triangles")
    frame = thing.get_arrays_from_intent("NIFTI_INTENT_POINTSET")[0].coordsys
    turn = np.eye(3) if frame is None else np.asarray(frame.xform, float)[:3, :3]
    if not np.allclose(turn.T @ turn, np.eye(3), atol=_RIGID):
        warn(
            "passed over a matrix to other coordinates, which changes lengths",
            IgnoredContentWarning,
            advice="if they are meant, take points @ matrix[:3, :3].T + matrix[:3, 3]",
        )
    return points, faces


def _of_open3d(thing: Any) -> Arrays:
    if hasattr(thing, "to_legacy"):
        thing = thing.to_legacy()
    if hasattr(thing, "triangles") and len(thing.triangles):
        return np.asarray(thing.vertices), np.asarray(thing.triangles)
    if hasattr(thing, "lines") or not hasattr(thing, "points"):
        raise refused(thing, "of its points, an array makes a cloud")
    return np.asarray(thing.points), None


def _of_pymeshlab(thing: Any) -> Arrays:
    if hasattr(thing, "current_mesh"):
        thing = thing.current_mesh()
    points, faces = thing.vertex_matrix(), thing.face_matrix()
    return points, faces if len(faces) else None


def _of_torch_geometric(thing: Any) -> Arrays:
    faces = getattr(thing, "face", None)
    return thing.pos, None if faces is None else faces.T


def _of_physicsnemo(thing: Any) -> Arrays:
    points, cells = (part.detach().cpu().numpy() for part in (thing.points, thing.cells))
    if len(cells) and cells.shape[1] < 3:
        raise refused(thing, _CURVES.format("points"))
    if len(cells) and cells.shape[1] > 3:
        raise refused_volume(thing, "get_boundary_mesh()")
    return spatial(points), cells if len(cells) else None


_TOOLKITS: dict[str, Callable[[Any], Arrays]] = {
    "trimesh": _of_trimesh,
    "pyvista": _of_pyvista,  # whose classes are VTK's, too
    "vtkmodules": _of_vtk,
    "meshio": _of_meshio,
    "lapy": _of_lapy,
    "nibabel": _of_nibabel,
    "open3d": _of_open3d,
    "physicsnemo": _of_physicsnemo,
    "pymeshlab": _of_pymeshlab,
    "torch_geometric": _of_torch_geometric,
}


def arrays_of(thing: Any) -> Arrays | None:
    """Return the points and faces of an object of one of these libraries; None of others."""
    # By the names of the modules: no package is imported for what is not its own.
    toolkits = {base.__module__.partition(".")[0] for base in type(thing).__mro__}
    return next((take(thing) for name, take in _TOOLKITS.items() if name in toolkits), None)


def refused(thing: Any, advice: str) -> InvalidInputError:
    """Return what is to be raised of what is no surface or cloud."""
    name = type(thing).__name__
    return InvalidInputError("thing", "be a TriangleMesh or PointCloud", name, advice=advice)


def refused_volume(thing: Any, surface: str) -> InvalidInputError:
    """Return what is to be raised of cells that fill a volume: `surface` makes one of them."""
    return refused(
        thing, f"its surface is {surface}; of tetrahedra, tetrahedral_laplacian makes an operator"
    )


def _joined(polygons: Sequence[Polygons]) -> Polygons:
    return Polygons(*map(np.concatenate, zip(*polygons, strict=True)))


def spatial(points: Any) -> Any:
    """Return planar points (n, 2), of what says by its faces that it is a surface, in space."""
    planar = np.asarray(points)
    if planar.ndim != 2 or planar.shape[1] != 2:
        return points
    return np.column_stack([planar, np.zeros(len(planar))])


def _warn_of(cells: dict[str, int]) -> None:
    if told := ", ".join(quantity(n, kind) for kind, n in cells.items() if n):
        warn(f"passed over {told} beside the faces", IgnoredContentWarning)
