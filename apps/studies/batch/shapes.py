"""The shapes of the trials, as files: a part of the pool, and real ones in many sizes."""

from __future__ import annotations

from pathlib import Path

import igl
import numpy as np

from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import TriangleMesh, as_geometry, write
from spectra_kit.interop import to_pyvista
from spectra_kit.neo.train.pool import open_pool
from studies.shapes import repaired

_SMALLEST = 300  # vertices of what is taken from the pool
_SIZES = (3_000, 135_000)


def write_pool(pool: Path, folder: Path, count: int) -> list[Path]:
    """Write the first so many shapes of the pool's training split, repaired; return their files."""
    meshes, paths = open_pool(pool, "train"), list[Path]()
    folder.mkdir(parents=True, exist_ok=True)
    for i in range(len(meshes)):
        if len(paths) == count:
            return paths
        if len(meshes.points[i]) < _SMALLEST:
            continue
        path = folder / f"{meshes.names[i]}.ply"
        if not path.exists():
            mesh = repaired(meshes.mesh(i))
            if mesh.n < _SMALLEST:
                continue
            write(mesh, path)
        paths.append(path)
    if len(paths) < count:
        raise InvalidInputError("shapes", f"be at most {len(paths)}, as the pool has", count)
    return paths


def write_sizes(folder: Path, out: Path, count: int) -> list[Path]:
    """Write public models in so many sizes, by turns; return their files."""
    models = sorted(folder.glob("*.npz"))
    out.mkdir(parents=True, exist_ok=True)
    paths = [out / f"{i:03}.ply" for i in range(count)]
    for i, path in enumerate(paths):
        if not path.exists():
            with np.load(models[i % len(models)]) as file:
                mesh = repaired(TriangleMesh(file["V"], file["F"]))
            write(_resized(mesh, int(np.geomspace(*_SIZES, count)[i])), path)
    return paths


def _resized(mesh: TriangleMesh, size: int) -> TriangleMesh:
    """Return a mesh of about so many vertices: subdivided at edges, then decimated."""
    points, faces = mesh.points, mesh.faces
    while len(points) < size:
        points, faces = igl.upsample(points, faces)
    fine = to_pyvista(TriangleMesh(points, faces))
    return repaired(as_geometry(fine.decimate(1 - min(1.0, size / len(points)))))
