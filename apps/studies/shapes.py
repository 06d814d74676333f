"""Shapes with a name and a digest, from files or made; and operators as files."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from spectra_kit._core.files import atomic_path, parsing
from spectra_kit._core.fingerprint import shape_digest
from spectra_kit._core.types import Floats
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import Geometry, TriangleMesh, creature, read, repair
from spectra_kit.geometry.io import READERS, is_readable
from spectra_kit.operators import Laplacian


@dataclass(frozen=True, eq=False)
class Shape:
    """A mesh and what to call it."""

    name: str  #: For tables, pictures and files.
    mesh: TriangleMesh  #: Every vertex in a face.

    def __str__(self) -> str:
        return self.name

    @cached_property
    def digest(self) -> str:
        """Hash of the mesh: what it is, wherever its file lies."""
        return shape_digest(self.mesh)


def data_folder(name: str) -> Path | None:
    """Return the folder of that name in ``$SPECTRA_KIT_DATA``, None where that is not set."""
    root = os.environ.get("SPECTRA_KIT_DATA")
    return Path(root) / name if root else None


def given_folder(given: Path | None, name: str) -> Path:
    """Return the folder that is given, or the one of that name in ``$SPECTRA_KIT_DATA``."""
    folder = given or data_folder(name)
    if folder is None:
        raise InvalidInputError(
            f"name a folder with --data, or set SPECTRA_KIT_DATA to that of {name}"
        )
    return folder


def repaired(geometry: Geometry) -> TriangleMesh:
    """Return a mesh without duplicate vertices and degenerate faces."""
    return as_mesh(repair(geometry).geometry)


def as_mesh(geometry: Geometry) -> TriangleMesh:
    """Return a geometry that is a mesh, as it was made of one."""
    assert isinstance(geometry, TriangleMesh)
    return geometry


def mean_edge(mesh: TriangleMesh) -> float:
    """Return the mean length of the edges."""
    a, b = mesh.points[mesh.unique_edges[0]].transpose(1, 0, 2)
    return float(np.linalg.norm(a - b, axis=1).mean())


def vertex_areas(mesh: TriangleMesh) -> Floats:
    """Return a third of the area of the triangles around each vertex, (n,)."""
    thirds = np.repeat(mesh.face_areas / 3, 3)
    return np.bincount(mesh.faces.ravel(), thirds, mesh.n).astype(np.float64)


def loop_subdivided(mesh: TriangleMesh, times: int = 1) -> TriangleMesh:
    """Split every triangle in four and smooth, after Loop."""
    import trimesh

    subdivide: Any = trimesh.remesh.subdivide_loop
    return TriangleMesh(*subdivide(mesh.points, mesh.faces, iterations=times))


def shape_at(path: Path) -> Shape:
    """Read a mesh and repair it."""
    return Shape(path.stem, repaired(read(path, kind="mesh")))


def shapes_in(folder: Path, limit: int | None = None) -> tuple[Shape, ...]:
    """Read the meshes of a folder, or the first so many, by name, as `shape_at` does."""
    entries = sorted(folder.iterdir()) if folder.is_dir() else []
    paths = [path for path in entries if is_readable(path)][:limit]
    if not paths:
        raise InvalidInputError(
            "folder",
            f"hold meshes ({', '.join(sorted(READERS))})",
            f"none in {folder}",
            advice="check the path, or set SPECTRA_KIT_DATA",
        )
    return tuple(map(shape_at, paths))


def shapes_named(names: Iterable[str]) -> tuple[Shape, ...]:
    """Read meshes by their files, or by their names in ``$SPECTRA_KIT_DATA/ood_public``.

    As they are, but without vertices that no face uses.
    """
    folder, found = data_folder("ood_public"), dict[str, Shape]()
    for name in names:
        path = Path(name)
        if not path.is_file() and folder:
            path = folder / f"{name}.npz"
        if not path.is_file():
            known = "name files, or, where SPECTRA_KIT_DATA is set, meshes in ood_public there"
            raise InvalidInputError("meshes", known, repr(name))
        if path.stem in found:
            raise InvalidInputError("meshes", "have names of their own", f"{path.stem} twice")
        mesh = as_mesh(read(path, kind="mesh"))
        found[path.stem] = Shape(path.stem, mesh.without_unreferenced())
    return tuple(found.values())


def demo_shapes(n: int = 1, vertices: int = 3000) -> tuple[Shape, ...]:
    """Make demo animals, all different, for trials without any data."""
    return tuple(Shape(f"creature {seed}", creature(vertices, seed=seed)) for seed in range(n))


def write_operator(laplacian: Laplacian, path: Path) -> None:
    """Write a Neumann operator to an ``.npz`` file, whole or not at all."""
    L = laplacian.stiffness
    with atomic_path(path) as part:
        np.savez(
            part,
            data=L.data,
            indices=L.indices,
            indptr=L.indptr,
            mass=laplacian.mass,
            points=laplacian.points,
            seconds=laplacian.seconds,
            operator=laplacian.operator,
        )


def read_operator(path: Path) -> Laplacian:
    """Read what `write_operator` wrote."""
    with parsing(path, "operator", remedy="delete it"), np.load(path) as file:
        n = len(file["mass"])
        stiffness = sparse.csr_array((file["data"], file["indices"], file["indptr"]), shape=(n, n))
        return Laplacian(
            stiffness,
            file["mass"],
            file["points"],
            operator=str(file["operator"]),
            seconds=float(file["seconds"]),
        )
