"""glTF 2.0 as one file (glb) or as JSON (gltf), through trimesh."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np

from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.formats._arrays import Arrays
from spectra_kit.geometry.shapes import TriangleMesh


def read(path: Path) -> Arrays:
    """Return every mesh of the scene, moved to its place and stacked into one.

    Vertices stay in the order of the file, mesh after mesh. Curves, and point sets that stand next
    to meshes, are left out; a scene of point sets alone gives a cloud.
    """
    import trimesh  # here, because it is slow to import and no other format needs it

    try:
        parts = trimesh.load_scene(path, process=False, skip_materials=True).dump()
    except (
        ValueError,
        LookupError,
        TypeError,
        AttributeError,
        OSError,
        NotImplementedError,
        struct.error,
    ) as error:
        raise InvalidInputError(
            f"not a whole glTF file ({type(error).__name__}: {error})"
        ) from error
    meshes = [part for part in parts if isinstance(part, trimesh.Trimesh)]
    if not meshes:
        clouds = [part.vertices for part in parts if isinstance(part, trimesh.PointCloud)]
        if not clouds:
            raise InvalidInputError("holds neither a mesh nor a point set")
        return np.vstack(clouds), None
    offsets = np.cumsum([0] + [len(part.vertices) for part in meshes])
    faces = [part.faces + offset for part, offset in zip(meshes, offsets, strict=False)]
    return np.vstack([part.vertices for part in meshes]), np.vstack(faces)


def write(mesh: TriangleMesh, path: Path) -> None:
    """Write a scene of one mesh; coordinates are rounded to float32, the format knows no other."""
    import trimesh

    scene: Any = trimesh.Scene(trimesh.Trimesh(mesh.points, mesh.faces, process=False))
    if path.suffix.lower() == ".glb":
        path.write_bytes(scene.export(file_type="glb", include_normals=False))
    else:
        options = {"include_normals": False, "merge_buffers": True, "embed_buffers": True}
        path.write_bytes(scene.export(file_type="gltf", **options)["model.gltf"])
