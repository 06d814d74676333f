"""glTF as programs write it, by the rules of the format: arrays, views, accessors, chunks."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np

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
        tree = json.dumps(self.tree | {"buffers": [{"byteLength": len(self.data)}]}).encode()
        tree += b" " * (-len(tree) % 4)
        data = self.data + bytes(-len(self.data) % 4 + padding)
        body = b""
        for kind, chunk in [(0x4E4F534A, tree), (0x004E4942, data), *chunks]:
            body += np.array([len(chunk), kind], "<u4").tobytes() + chunk
        return b"glTF" + np.array([2, 12 + len(body)], "<u4").tobytes() + body
