"""glTF 2.0 as one file (glb) or as JSON (gltf); written through trimesh.

Read here, not through trimesh (5.2): that gives other vertices where they are sparse or normalised
integers, leaves out fans and what no scene shows, takes a damaged count or a misspelt word for
fewer triangles, and makes whatever is announced.
"""

from __future__ import annotations

import base64
import json
from collections import Counter
from collections.abc import Iterator
from collections.abc import Set as AbstractSet
from difflib import get_close_matches
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_indices, quantity
from spectra_kit._core.warn import warn
from spectra_kit.errors import IgnoredContentWarning, InvalidInputError
from spectra_kit.geometry.formats._arrays import BROKEN, Arrays, bands
from spectra_kit.geometry.formats._room import MULTIPLE, room
from spectra_kit.geometry.shapes import TriangleMesh

JSON, BIN = 0x4E4F534A, 0x004E4942
TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
COLUMNS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
POINTS, LINES, TRIANGLES, STRIP, FAN = 0, (1, 2, 3), 4, 5, 6
# Extensions that a file may require and that leave the geometry as it is, or as read here.
HARMLESS = (
    "KHR_materials_",
    "KHR_texture_",
    "EXT_texture_",
    "KHR_lights_",
    "EXT_lights_",
    "KHR_xmp",
    "KHR_animation_",
    "KHR_mesh_quantization",
)

# What may stand in an object: a word like one of these is that, damaged, which perhaps has a
# default; other words are somebody's own.
COMMON = {"name", "extensions", "extras"}
TREE = {"scene", "scenes", "nodes", "meshes", "extensionsRequired"}  # choose what is shown
AROUND = {"asset", "accessors", "bufferViews", "buffers", "cameras", "animations", "skins"}
AROUND |= {"materials", "textures", "images", "samplers", "extensionsUsed", "extensions", "extras"}
NODE = COMMON | {"camera", "children", "skin", "matrix", "mesh", "weights"}
NODE |= {"rotation", "scale", "translation"}
PRIMITIVE = COMMON | {"attributes", "indices", "material", "mode", "targets"}
ACCESSOR = COMMON | {"bufferView", "byteOffset", "componentType", "normalized", "count", "type"}
ACCESSOR |= {"max", "min", "sparse"}
SPARSE = COMMON | {"count", "indices", "values"}
VIEW = COMMON | {"buffer", "byteOffset", "byteLength", "byteStride", "target"}


def read(path: Path) -> Arrays:
    """Return every mesh of the scene, moved to its place and stacked into one.

    Vertices stay in the order of the file, node after node. Curves, and point sets that stand next
    to meshes, are left out; a scene of point sets alone gives a cloud. All arrays together take
    what `room` says and no more, however often the scene shows one, or whatever is announced.
    """
    passed: Counter[str] = Counter()
    try:
        data = path.read_bytes()
        tree, binary = _split(data, passed)
        _check_readable(tree)
        buffers, beside = _buffers(tree, binary, path)
        arrays = _Accessors(tree, buffers, room(len(data) + beside))
        parts = list(_parts(tree, arrays, passed))
    except InvalidInputError:
        raise
    except (*BROKEN, AttributeError) as error:  # JSON of another form
        raise InvalidInputError(
            f"not a whole glTF file ({type(error).__name__}: {error})"
        ) from error
    meshes = [(points, faces) for points, faces in parts if faces is not None]
    if not parts:
        raise InvalidInputError("holds neither a mesh nor a point set")
    if meshes:
        passed["lone point set"] = len(parts) - len(meshes)
    if told := ", ".join(quantity(n, noun) for noun, n in passed.items() if n):
        rest = "; vertices stand where they rest" if passed["skin"] + passed["morph target"] else ""
        warn(f"passed over {told}{rest}", IgnoredContentWarning)
    if not meshes:
        return np.vstack([points for points, _ in parts]), None
    starts = np.cumsum([0] + [len(points) for points, _ in meshes])
    stacked = [faces + start for (_, faces), start in zip(meshes, starts, strict=False)]
    return np.vstack([points for points, _ in meshes]), np.vstack(stacked)


def _split(data: bytes, passed: Counter[str]) -> tuple[dict[str, Any], memoryview | None]:
    """Return the JSON and, of a glb, the bytes behind it."""
    binary = None
    if data[:4] == b"glTF":
        version, length = _words(data, 4)
        passed["trailing byte"] = len(data[length:].strip(b"\0 \t\r\n"))
        if version != 2 or length > len(data):
            raise InvalidInputError(
                f"a glb must have version 2 and the {length} bytes that it announces, got version"
                f" {version} and {len(data)} bytes; the file may be cut short"
            )
        chunks, start = [], 12
        while start < length:
            size, kind = _words(data, start)
            chunks.append((kind, memoryview(data)[start + 8 : start + 8 + size]))
            start += 8 + size
        kinds = [kind for kind, _ in chunks[:2]]
        if start != length or kinds[:1] != [JSON]:
            raise InvalidInputError("its chunks do not fill the glb; the file may be damaged")
        data, binary = bytes(chunks[0][1]), chunks[1][1] if kinds[1:] == [BIN] else None
    return json.loads(data), binary


def _check_readable(tree: dict[str, Any]) -> None:
    """Refuse another version of the format, and extensions that would change the geometry."""
    version = str(tree.get("asset", {}).get("version", "2.0"))
    _known(tree, TREE - tree.keys(), TREE | AROUND)
    if version.split(".")[0] != "2":
        raise InvalidInputError(f"the version must be 2, got {version[:20]!r}")
    required = tree.get("extensionsRequired", [])
    if unknown := [name for name in required if not name.startswith(HARMLESS)]:
        packed = any("compression" in name for name in unknown)
        raise _beyond(f"requires {', '.join(unknown)}, which is not read", packed=packed)


def _beyond(problem: str, *, packed: bool) -> InvalidInputError:
    """Return what is to be raised of an extension that is not read, with who reads it."""
    return InvalidInputError(
        problem,
        advice="npx @gltf-transform/cli copy FILE plain.glb unpacks it; of Draco, where DracoPy is"
        " installed, so does trimesh: hand over trimesh.load_scene(path).to_mesh()"
        if packed
        else "export it without",
    )


def _words(data: bytes, start: int) -> tuple[int, int]:
    """Return two 32-bit numbers; 0 behind the end, where `_split` finds what is missing."""
    first, second = data[start : start + 4], data[start + 4 : start + 8]
    return int.from_bytes(first, "little"), int.from_bytes(second, "little")


def buffer_files(path: Path) -> list[Path]:
    """Return the files beside a .gltf that hold its arrays, as far as it can be read."""
    try:
        buffers = json.loads(path.read_bytes()).get("buffers", [])
        names = [buffer.get("uri") or "data:" for buffer in buffers]
        files = [_beside(path, name) for name in names if not name.startswith("data:")]
    except (*BROKEN, AttributeError):
        return []  # to read it tells what is wrong
    return [file for file in dict.fromkeys(files) if file is not None]


def _beside(path: Path, uri: str) -> Path | None:
    """Return the file that a buffer names, where it lies in the folder of `path`, or below.

    A file may be a link, as keepers of data make them: what it leads to has a folder as well.
    """
    name = unquote(uri).replace("\\", "/")  # as programs on Windows write it
    folders = [path.parent.resolve(), path.resolve().parent]
    try:
        for file in ((folder / name).resolve() for folder in folders):
            if any(map(file.is_relative_to, folders)) and file.is_file():
                return file
    except (OSError, ValueError, RuntimeError):  # no name of a file, or links in a ring
        pass
    return None


def _buffers(
    tree: dict[str, Any], binary: memoryview | None, path: Path
) -> tuple[list[memoryview], int]:
    """Return the buffers, and how many bytes other files than `path` have."""
    found: list[memoryview] = []
    files: dict[Path, memoryview] = {}
    for buffer in tree.get("buffers", []):
        uri, data = buffer.get("uri"), binary
        if uri is not None and uri.startswith("data:"):
            data = memoryview(base64.b64decode(uri.partition(";base64,")[2], validate=True))
        elif uri is not None:
            file = _beside(path, uri)
            if file is None:
                raise InvalidInputError(
                    f"not a whole glTF file: {uri[:100]!r}, which holds its arrays, is no file of"
                    " its folder; copy it there, name it by its name alone, and unpack what is"
                    " packed"
                )
            if file not in files:  # many buffers may name one
                files[file] = memoryview(file.read_bytes())
            data = files[file]
        elif found:
            data = None  # only the first may be the one inside a glb
        length = _natural(buffer["byteLength"])
        if data is None or len(data) < length:
            raise InvalidInputError(
                f"buffer {len(found)} must have {length} bytes, got"
                f" {'none' if data is None else len(data)}; the file may be cut short"
            )
        found.append(data[:length])
    return found, sum(map(len, files.values()))


def _parts(
    tree: dict[str, Any], arrays: _Accessors, passed: Counter[str]
) -> Iterator[tuple[Floats, Ints | None]]:
    """Yield points and faces (None for a point set) of all that the scene shows, in its place.

    Primitives that share their points, as those of several materials do, are one part.
    """
    meshes = tree.get("meshes", [])
    nodes = tree.get("nodes", [])
    if {"scene", "scenes"} & tree.keys():
        roots = _item(tree.get("scenes", []), tree.get("scene", 0)).get("nodes", [])
    else:  # a library of parts: all of them, or where no node moves them, as they are
        nodes = nodes or [{"mesh": i} for i in range(len(meshes))]
        children = {child for node in nodes for child in node.get("children", [])}
        roots = [i for i in range(len(nodes)) if i not in children]
    waiting = [(root, np.eye(4)) for root in reversed(roots)]
    seen, shown = set(), set()
    while waiting:
        index, above = waiting.pop()
        node = _known(_item(nodes, index), NODE)
        if index in seen:
            raise InvalidInputError(f"node {index} stands in the scene twice; it may be damaged")
        seen.add(index)
        place = above @ _placement(node)
        waiting += [(child, place) for child in reversed(node.get("children", []))]
        if "mesh" not in node:
            continue
        if "EXT_mesh_gpu_instancing" in node.get("extensions", {}):
            problem = f"node {index} uses EXT_mesh_gpu_instancing, which is not read"
            raise _beyond(problem, packed=False)
        passed["skin"] += "skin" in node
        mesh = _item(meshes, node["mesh"])
        shown.add(node["mesh"])
        turned = np.linalg.det(place[:3, :3]) < 0  # a mirror turns a surface inside out
        parts: dict[tuple[int, bool], tuple[Floats, list[Ints]]] = {}
        for primitive in mesh["primitives"]:
            mode = _known(primitive, PRIMITIVE).get("mode", TRIANGLES)
            if mode in LINES:
                passed["curve"] += 1
                continue
            passed["morph target"] += len(primitive.get("targets", []))
            index = primitive["attributes"]["POSITION"]
            key = index, mode == POINTS
            if key not in parts:
                parts[key] = arrays.positions(index), []
            points, surfaces = parts[key]
            if mode != POINTS:
                corners = np.arange(len(points))
                if "indices" in primitive:
                    corners = arrays.indices(primitive["indices"], len(points))
                faces = _triangles(corners, mode)
                surfaces.append(faces[:, ::-1] if turned else faces)
        for points, surfaces in parts.values():
            yield points @ place[:3, :3].T + place[:3, 3], np.vstack(surfaces) if surfaces else None
    passed["surface that no node shows"] = len(meshes) - len(shown)


def _placement(node: dict[str, Any]) -> Floats:
    """Return the matrix that moves a node into its parent: a given one, or T R S."""
    from scipy.spatial.transform import Rotation  # slow to import

    matrix = np.reshape(np.array(node.get("matrix", np.eye(4)), dtype=np.float64), (4, 4)).T
    if not np.allclose(matrix[3], [0, 0, 0, 1], rtol=0, atol=1e-6):  # products of float32
        raise InvalidInputError("the last row of a matrix must be 0 0 0 1; it may be damaged")
    scale = np.reshape(np.array(node.get("scale", [1, 1, 1]), dtype=np.float64), 3)
    moved = np.eye(4)
    moved[:3, :3] = Rotation.from_quat(node.get("rotation", [0, 0, 0, 1])).as_matrix() * scale
    moved[:3, 3] = np.reshape(node.get("translation", [0, 0, 0]), 3)
    return np.asarray(matrix @ moved)


def _triangles(corners: Ints, mode: int) -> Ints:
    """Return faces (f, 3); those of strips keep their orientation."""
    if mode == TRIANGLES and len(corners) % 3 == 0:
        return corners.reshape(-1, 3)
    if mode == FAN:
        first = np.full(max(len(corners) - 2, 0), corners[0])
        return np.column_stack([first, corners[1:-1], corners[2:]])
    if mode == STRIP:
        return bands(corners)
    raise InvalidInputError(f"{len(corners)} corners in mode {mode} make no triangles")


class _Accessors:
    """The arrays of a file, each within what the file says of it, all of them within its room."""

    def __init__(self, tree: dict[str, Any], buffers: list[memoryview], most: int) -> None:
        self.accessors, self.views = tree.get("accessors", []), tree.get("bufferViews", [])
        self.buffers = buffers
        self.most, self.made = most, 0  # bytes
        self.ends: dict[int, int] = {}  # where the last rows of each view end
        for accessor in self.accessors:
            for rows in _layers(_known(accessor, ACCESSOR)):
                index = rows["bufferView"]
                self.ends[index] = max(self.ends.get(index, 0), self._layout(rows)[-1])

    def positions(self, index: int) -> Floats:
        """Return points (n, 3)."""
        values = self._array(index, "VEC3", "fiu")
        points = values.astype(np.float64)
        if self.accessors[index].get("normalized") and values.dtype.kind != "f":
            points = np.maximum(points / np.iinfo(str(values.dtype)).max, -1.0)
        return points

    def indices(self, index: int, n: int) -> Ints:
        """Return indices into `n` points."""
        return check_indices("indices", self._array(index, "SCALAR", "u")[:, 0], n)

    def _layout(self, accessor: dict[str, Any]) -> tuple[np.dtype[np.generic], int, int, int]:
        """Return type and columns, the distance of rows, and where the last one ends."""
        view = _known(_item(self.views, accessor["bufferView"]), VIEW)
        dtype = np.dtype(TYPES[accessor["componentType"]])
        columns = COLUMNS[accessor["type"]]
        stride = _natural(view.get("byteStride", dtype.itemsize * columns))
        start, count = _natural(accessor.get("byteOffset", 0)), _natural(accessor["count"])
        return dtype, columns, stride, start + (count - 1) * stride + dtype.itemsize * columns

    def _array(self, index: int, kind: str, types: str) -> NDArray[np.generic]:
        accessor = _item(self.accessors, index)
        if "bufferView" not in accessor and "sparse" not in accessor:
            problem = f"accessor {index} must be an array, got a compressed one"
            raise _beyond(problem, packed=True)
        self.made += 24 * _natural(accessor["count"])  # a point, or a triangle of three at most
        if self.made > self.most:
            raise InvalidInputError(
                f"shows more than {self.most:,} bytes of points and triangles, which is {MULTIPLE}"
                " times its size or 64 MiB",
                advice="if that is right, "
                + (
                    "export its parts, each once, to files of their own"
                    if any({"sparse", "normalized"} & a.keys() for a in self.accessors)
                    else "hand over trimesh.load_scene(path).to_mesh()"
                ),
            )
        if "sparse" not in accessor:
            return self._rows(index, accessor, kind, types)
        *base, where, values = _layers(accessor)
        array = np.zeros((accessor["count"], COLUMNS[kind]), TYPES[accessor["componentType"]])
        if base:
            array[:] = self._rows(index, base[0], kind, types)
        rows = check_indices("indices", self._rows(index, where, "SCALAR", "u")[:, 0], len(array))
        array[rows] = self._rows(index, values, kind, types)
        return array

    def _rows(
        self, index: int, accessor: dict[str, Any], kind: str, types: str
    ) -> NDArray[np.generic]:
        dtype, columns, stride, end = self._layout(accessor)
        view = self.views[accessor["bufferView"]]
        data = _item(self.buffers, view["buffer"])
        first, length = _natural(view.get("byteOffset", 0)), _natural(view["byteLength"])
        # What no accessor of the view describes may be padding, but no row.
        last = self.ends[accessor["bufferView"]]
        if (
            accessor["type"] != kind
            or dtype.kind not in types
            or not (accessor["count"] and stride >= columns * dtype.itemsize)
            or not end <= length <= len(data) - first
            or (length - last >= max(4, stride) and any(data[first + last : first + length]))
        ):
            raise InvalidInputError(
                f"accessor {index} must describe {kind} numbers that fill their view of {length}"
                f" bytes, got {accessor['count']} of {accessor['type']} {dtype}, up to byte {end};"
                " the file may be damaged"
            )
        offset = first + _natural(accessor.get("byteOffset", 0))
        shape, strides = (accessor["count"], columns), (stride, dtype.itemsize)
        return np.ndarray(shape, dtype, data, offset, strides)


def _layers(accessor: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield what describes rows: the accessor; of a sparse one, where others stand, and those."""
    if "bufferView" in accessor:
        yield accessor
    if "sparse" in accessor:
        sparse = _known(accessor["sparse"], SPARSE)
        count = {"count": sparse["count"]}
        yield count | {"type": "SCALAR"} | _known(sparse["indices"], ACCESSOR)
        kind = {key: accessor[key] for key in ("type", "componentType")}
        yield count | kind | _known(sparse["values"], ACCESSOR)


def _item(items: Any, index: Any) -> Any:
    """Return an entry; Python alone counts negative ones from the end."""
    if _natural(index) >= len(items):
        raise InvalidInputError(f"there is no {index} among {len(items)}; the file may be damaged")
    return items[index]


def _known(
    found: dict[str, Any], keys: set[str], others: AbstractSet[str] = frozenset()
) -> dict[str, Any]:
    """Return an object of the JSON, if no word that is not of the format may be one, damaged.

    That is one of `keys`; `others` are of the format and have no say in what is read.
    """
    for word in found.keys() - keys - others:
        if get_close_matches(word, keys, 1, 0.5):
            raise InvalidInputError(
                f"{word[:40]!r} is no property of glTF here, known are"
                f" {', '.join(sorted(keys))}; the file may be damaged"
            )
        warn(f"passed over the unknown property {word[:40]!r}", IgnoredContentWarning)
    return found


def _natural(value: Any) -> int:
    if type(value) is not int or value < 0:
        raise InvalidInputError(
            f"counts, offsets and indices must be whole numbers from 0, got {value!r:.40}; the"
            " file may be damaged"
        )
    return value


def write(mesh: TriangleMesh, path: Path) -> None:
    """Write a scene of one mesh; coordinates are rounded to float32, the format knows no other."""
    import trimesh  # here, because it is slow to import and nothing else needs it

    scene: Any = trimesh.Scene(trimesh.Trimesh(mesh.points, mesh.faces, process=False))
    if path.suffix.lower() == ".glb":
        path.write_bytes(scene.export(file_type="glb", include_normals=False))
    else:
        options = {"include_normals": False, "merge_buffers": True, "embed_buffers": True}
        path.write_bytes(scene.export(file_type="gltf", **options)["model.gltf"])
