"""glTF: scenes in their places, and files that do not fit together."""

import base64
import json

import numpy as np
import pytest
import trimesh

from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import PointCloud, read, sphere, write

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
FAN = [[0, 1, 2], [0, 2, 3]]


@pytest.fixture(scope="module")
def mesh():
    ball = sphere(subdivisions=1).geometry
    return ball.with_points(ball.points * np.sqrt(3) + 1 / 7)


def test_scene_is_merged_with_its_transforms(tmp_path):
    box = trimesh.creation.box()
    scene = trimesh.Scene()
    scene.add_geometry(box, transform=trimesh.transformations.translation_matrix([10, 0, 0]))
    scene.add_geometry(box, transform=np.diag([2.0, 3.0, 4.0, 1.0]))
    scene.export(tmp_path / "two.glb")
    merged = read(tmp_path / "two.glb")
    assert (merged.n, len(merged.faces)) == (2 * len(box.vertices), 2 * len(box.faces))
    np.testing.assert_allclose(merged.area, 6.0 + 2 * (6 + 8 + 12), rtol=1e-6)
    np.testing.assert_allclose(merged.points.max(axis=0), [10.5, 1.5, 2.0])


def test_scene_of_points_alone_is_a_cloud(tmp_path):
    points = np.arange(12.0).reshape(4, 3)
    trimesh.Scene(trimesh.PointCloud(points)).export(tmp_path / "points.glb")
    cloud = read(tmp_path / "points.glb")
    assert isinstance(cloud, PointCloud)
    np.testing.assert_array_equal(cloud.points, points)


def test_gltf_without_geometry_or_without_its_buffer(tmp_path):
    trimesh.Scene(trimesh.load_path(SQUARE)).export(tmp_path / "curve.glb")
    with pytest.raises(InvalidInputError, match="holds neither a mesh nor a point set"):
        read(tmp_path / "curve.glb")
    files = trimesh.Scene(trimesh.Trimesh(SQUARE, FAN)).export(file_type="gltf")
    (tmp_path / "b.gltf").write_bytes(files["model.gltf"])
    with pytest.raises(InvalidInputError, match="not a whole glTF file"):
        read(tmp_path / "b.gltf")
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    np.testing.assert_array_equal(read(tmp_path / "model.gltf").points, SQUARE)


def glb_with(mesh, path, change):
    """Write `mesh` as glb, with a changed JSON chunk."""
    write(mesh, path)
    data = path.read_bytes()
    size = int.from_bytes(data[12:16], "little")
    tree = json.loads(data[20 : 20 + size])
    change(tree)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + size :]
    length = (20 + len(text) + len(rest)).to_bytes(4, "little")
    path.write_bytes(
        data[:8] + length + len(text).to_bytes(4, "little") + data[16:20] + text + rest
    )


def set_in(*keys, value):
    def change(tree):
        for key in keys[:-1]:
            tree = tree[key]
        tree[keys[-1]] = value

    return change


def renamed(key, *to):
    """Damage the name of a property, or leave it out."""

    def change(tree):
        assert key in tree
        value = tree.pop(key)
        tree.update(dict.fromkeys(to, value))

    return change


def deepen(tree):
    tree["nodes"] = [{"children": [i + 1]} for i in range(2_000)] + [{"mesh": 0}]
    tree["scenes"], tree["scene"] = [{"nodes": [0]}], 0


def compress(tree):
    """What an encoder of Draco leaves: accessors without bytes, and the extension."""
    name = "KHR_draco_mesh_compression"
    tree["extensionsUsed"] = tree["extensionsRequired"] = [name]
    for accessor in tree["accessors"]:
        del accessor["bufferView"]


def compress_quietly(tree):
    compress(tree)
    del tree["extensionsRequired"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (compress, r"requires KHR_draco_mesh_compression, .* trimesh\.load_scene\(path\)"),
        (
            set_in("extensionsRequired", value=["EXT_meshopt_compression"]),
            r"requires EXT_meshopt_compression, .*; npx @gltf-transform/cli copy FILE plain\.glb",
        ),
        (
            set_in("extensionsRequired", value=["EXT_of_somebody"]),
            "requires EXT_of_somebody, which is not read; export it without",
        ),
        (compress_quietly, "must be an array, got a compressed one"),
        (set_in("extensionsRequired", value=[3]), "not a whole glTF file"),
        (set_in("asset", "version", value="1.0"), "the version must be 2, got '1.0'"),
        (set_in("accessors", 0, "count", value=-3), "must be whole numbers from 0, got -3"),
        (set_in("accessors", 0, "count", value=60), "numbers that fill their view"),
        (set_in("accessors", 0, "count", value=0), "must describe SCALAR numbers"),
        (set_in("accessors", 0, "byteOffset", value=10**30), "must describe SCALAR numbers"),
        (set_in("accessors", 0, "byteOffset", value=-4), "must be whole numbers from 0, got -4"),
        (set_in("accessors", 1, "type", value="VEC2"), "must describe VEC3 numbers"),
        (set_in("accessors", 1, "sparse", value={"count": 1}), "not a whole glTF file"),
        (set_in("accessors", 1, "sparse", value={"cound": 1}), "'cound' is no property"),
        (set_in("nodes", 0, "extensions", value={"EXT_mesh_gpu_instancing": {}}), "uses EXT_mesh"),
        (set_in("bufferViews", 1, "byteStride", value=1), "must describe VEC3 numbers"),
        (set_in("bufferViews", 1, "byteLength", value=10**30), "must describe VEC3 numbers"),
        (set_in("buffers", 0, "byteLength", value=10**9), "must have 1000000000 bytes, got"),
        (set_in("scene", value=7), "there is no 7 among 1"),
        (set_in("nodes", 0, "children", value=[0]), "node 0 stands in the scene twice"),
        (set_in("nodes", 0, "matrix", value=[1.0] * 16), "the last row of a matrix must be"),
        (set_in("nodes", 0, "rotation", value=[0, 0, 0, 0]), "not a whole glTF file"),
        (renamed("scenes", "sceles"), "'sceles' is no property of glTF here"),
        (renamed("scene", "scine"), "'scine' is no property of glTF here"),
        (renamed("meshes", "meches"), "'meches' is no property of glTF here"),
        (renamed("scenes"), "there is no 0 among 0"),
        (set_in("extensionsRequire", value=["EXT_of_somebody"]), "'extensionsRequire' is no"),
        (set_in("nodes", 0, "mesl", value=0), "'mesl' is no property of glTF here"),
        (set_in("accessors", 0, "byteOffsft", value=0), "'byteOffsft' is no property"),
        (set_in("meshes", 0, "primitives", 0, "indicds", value=0), "'indicds' is no property"),
        (set_in("meshes", 0, "primitives", 0, "mode", value=9), "in mode 9 make no triangles"),
    ],
)
def test_gltf_that_does_not_fit_together(mesh, tmp_path, change, message):
    glb_with(mesh, tmp_path / "a.glb", change)
    with pytest.raises(InvalidInputError, match=message):
        read(tmp_path / "a.glb")


def test_gltf_of_any_depth_and_with_extensions_of_its_looks(mesh, tmp_path):
    glb_with(mesh, tmp_path / "a.glb", deepen)
    single = mesh.with_points(mesh.points.astype(np.float32))
    np.testing.assert_array_equal(read(tmp_path / "a.glb").points, single.points)
    glb_with(mesh, tmp_path / "b.glb", set_in("extensionsRequired", value=["KHR_texture_basisu"]))
    np.testing.assert_array_equal(read(tmp_path / "b.glb").points, single.points)
    (tmp_path / "c.gltf").write_text('{"nodes": ' + "[" * 10**5)
    with pytest.raises(InvalidInputError, match="not a whole glTF file"):
        read(tmp_path / "c.gltf")


@pytest.mark.parametrize(
    ("mode", "corners", "faces"),
    [
        (4, [0, 1, 2, 0, 2, 3], FAN),
        (5, [0, 1, 3, 2], [[0, 1, 3], [3, 1, 2]]),
        (5, [0, 1, 3, 3, 1, 1, 1, 2, 3], [[0, 1, 3], [1, 2, 3]]),
        (6, [0, 1, 2, 3], FAN),
    ],
)
def test_gltf_strips_fans_mirrors_and_quantized_places(tmp_path, mode, corners, faces):
    """All show the unit square from above, its corners stored as bytes of 0 and 127."""
    positions = np.zeros((4, 4), np.int8)
    positions[:, :3] = 127 * SQUARE
    data = positions.tobytes() + np.array(corners, np.uint16).tobytes()
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    points = {"bufferView": 0, "componentType": 5120, "normalized": True, "count": 4}
    indices = {"bufferView": 1, "componentType": 5123, "count": len(corners), "type": "SCALAR"}
    tree = {
        "buffers": [{"byteLength": len(data), "uri": uri}],
        "bufferViews": [
            {"buffer": 0, "byteLength": 16, "byteStride": 4},
            {"buffer": 0, "byteOffset": 16, "byteLength": 2 * len(corners)},
        ],
        "accessors": [points | {"type": "VEC3"}, indices],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "mode": mode}]}],
        # One in place, one mirrored and turned over by half a turn around y, twice as large.
        "nodes": [
            {"children": [1, 2], "translation": [0, 0, 5]},
            {"mesh": 0},
            {"mesh": 0, "rotation": [0, 1, 0, 0], "scale": [2, 2, -2]},
        ],
        "scenes": [{"nodes": [0]}],
    }
    (tmp_path / "a.gltf").write_text(json.dumps(tree))
    mesh = read(tmp_path / "a.gltf")
    expected = [*(SQUARE + [0, 0, 5]), *(SQUARE * [-2, 2, 1] + [0, 0, 5])]
    np.testing.assert_allclose(mesh.points, expected, atol=1e-12)
    np.testing.assert_array_equal(np.sort(mesh.faces[: len(faces)]), np.sort(faces))
    np.testing.assert_allclose(mesh.area, 1 + 4)
    # A mirror turns the surface over, and the turned faces turn it back.
    normals = np.cross(*(np.diff(mesh.points[mesh.faces], axis=1).transpose(1, 0, 2)))[:, 2]
    np.testing.assert_allclose(normals, [1, 1, 4, 4])


def test_indices_of_one_part_do_not_reach_into_the_next(tmp_path):
    boxes = trimesh.Scene([trimesh.creation.box(), trimesh.creation.box()])
    boxes.export(tmp_path / "two.glb")
    assert read(tmp_path / "two.glb").n == 16
    data = (tmp_path / "two.glb").read_bytes()
    size = int.from_bytes(data[12:16], "little")
    start = 20 + size + 8  # of the buffer, which begins with the first part's indices
    tree = json.loads(data[20 : 20 + size])
    indices = tree["accessors"][tree["meshes"][0]["primitives"][0]["indices"]]
    assert (indices["componentType"], indices["bufferView"]) == (5125, 0)
    (tmp_path / "two.glb").write_bytes(data[:start] + b"\x08" + data[start + 1 :])
    with pytest.raises(InvalidInputError, match=r"`indices` must be in \[0, 8\), got 8"):
        read(tmp_path / "two.glb")
