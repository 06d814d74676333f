"""A sphere whose counts, volume and lowest modes are known, and glTF by the rules of the format."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista
import trimesh

import spectra_kit
from spectra_kit import Dense, as_geometry, cotan_laplacian, eigensolve
from spectra_kit.geometry import TriangleMesh, sphere

BALL = sphere(subdivisions=1).geometry
V, F = np.array(BALL.points), np.array(BALL.faces)
VOLUME = np.linalg.det(V[F]).sum() / 6  # positive where the surface faces outwards
RATE = eigensolve(cotan_laplacian(BALL), 2, Dense()).eigenvalues[1]


def is_ball(thing: Any, *, copies: int = 1, rtol: float = 1e-5) -> None:
    """Assert that this is the sphere, or several of it in their places."""
    mesh = as_geometry(thing)
    assert isinstance(mesh, TriangleMesh)
    assert (mesh.n, len(mesh.faces)) == (copies * BALL.n, copies * len(F))
    np.testing.assert_allclose(mesh.area, copies * BALL.area, rtol=rtol)
    np.testing.assert_allclose(
        np.linalg.det(mesh.points[mesh.faces]).sum() / 6, copies * VOLUME, rtol=rtol
    )
    modes = eigensolve(cotan_laplacian(mesh), copies + 1, Dense())
    np.testing.assert_allclose(modes.eigenvalues, [*[0] * copies, RATE], rtol=rtol, atol=1e-9)


CODES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}


class Gltf:
    """A file in the making: one buffer, and the tree that describes it."""

    def __init__(self) -> None:
        self.data = b""
        self.tree: dict[str, Any] = {
            "asset": {"version": "2.0"},
            "bufferViews": [],
            "accessors": [],
            "meshes": [],
        }

    def view(self, data: bytes, **more: Any) -> int:
        """Append bytes, at a multiple of four."""
        self.data += bytes(-len(self.data) % 4)
        place = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)}
        self.data += data
        return self.put("bufferViews", place | more)

    def put(self, kind: str, thing: dict[str, Any]) -> int:
        """Append to one of the lists of the tree, and return the place there."""
        self.tree.setdefault(kind, []).append(thing)
        return len(self.tree[kind]) - 1

    def array(self, values: Any, kind: str, padding: int = 0, **more: Any) -> int:
        """Append an array as a view and an accessor of its own."""
        array = np.asarray(values, kind)
        form = {"count": len(array), "type": "SCALAR" if array.ndim == 1 else "VEC3"}
        view = {"bufferView": self.view(array.tobytes() + bytes(padding))}
        return self.put("accessors", view | form | {"componentType": CODES[kind]} | more)

    def mesh(self, points: int, indices: int | None = None, **more: Any) -> int:
        """Append a mesh of one primitive."""
        primitive = {"attributes": {"POSITION": points}} | more
        if indices is not None:
            primitive["indices"] = indices
        return self.put("meshes", {"primitives": [primitive]})

    def surface(self, mesh: Any, points: str = "f4", corners: str = "u2", **more: Any) -> int:
        """Append a mesh of triangles."""
        indices = self.array(mesh.faces.ravel(), corners)
        return self.mesh(self.array(mesh.points, points), indices, **more)

    def show(self, *nodes: dict[str, Any]) -> Gltf:
        """Make one scene of nodes that are all roots."""
        self.tree["nodes"] = list(nodes)
        self.tree["scenes"], self.tree["scene"] = [{"nodes": list(range(len(nodes)))}], 0
        return self

    def text(self, uri: str | None = None) -> bytes:
        """Return the tree, with its buffer inside or in a file beside it."""
        inside = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
        buffer = {"byteLength": len(self.data), "uri": uri or inside}
        return json.dumps(self.tree | {"buffers": [buffer]}).encode()

    def beside(self, path: Path, uri: str, file: Path) -> Path:
        """Write it with its buffer in `file`, called `uri`."""
        path.parent.mkdir(parents=True, exist_ok=True)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(self.data)
        path.write_bytes(self.text(uri))
        return path

    def glb(self, *chunks: tuple[int, bytes], padding: int = 0) -> bytes:
        """Return it as chunks, with others behind its own."""
        tree = json.dumps({"buffers": [{"byteLength": len(self.data)}]} | self.tree).encode()
        tree += b" " * (-len(tree) % 4)
        data = self.data + bytes(-len(self.data) % 4 + padding)
        body = b""
        for kind, chunk in [(0x4E4F534A, tree), (0x004E4942, data), *chunks]:
            body += np.array([len(chunk), kind], "<u4").tobytes() + chunk
        return b"glTF" + np.array([2, 12 + len(body)], "<u4").tobytes() + body


def plain(**options: Any) -> Gltf:
    """Return a file of the sphere."""
    file = Gltf()
    return file.show({"mesh": file.surface(BALL, **options)})


def follow(error: object, pattern: str, **names: Any) -> Any:
    """Do what an error says, as it is written there."""
    known = {"numpy": np, "trimesh": trimesh, "pyvista": pyvista, "spectra_kit": spectra_kit}
    return eval(re.search(pattern, str(error))[1], known | names)


def polydata() -> Any:
    """Return the sphere as PyVista has it."""
    return pyvista.PolyData.from_regular_faces(V, F)


def write_gifti(path: Path) -> None:
    """Write the sphere as nibabel does."""
    nibabel = pytest.importorskip("nibabel")
    parts = (V.astype("f4"), "NIFTI_INTENT_POINTSET"), (F.astype("i4"), "NIFTI_INTENT_TRIANGLE")
    arrays = [nibabel.gifti.GiftiDataArray(array, intent=intent) for array, intent in parts]
    nibabel.save(nibabel.gifti.GiftiImage(darrays=arrays), path)
