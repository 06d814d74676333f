"""glTF as programs write it, in its place and buffers, and files that do not fit together."""

import json
import shutil
from contextlib import nullcontext

import numpy as np
import pytest
import trimesh
from others import BALL, F, Gltf, V, is_ball, plain

from spectra_kit.errors import IgnoredContentWarning, InvalidFileError, InvalidInputError
from spectra_kit.geometry import PointCloud, read

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)


def changed(*changes, **options):
    """The plain file, with changes of its tree."""

    def make():
        file = plain(**options)
        for change in changes:
            change(file.tree)
        return file

    return make


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


# --- as programs write it -------------------------------------------------------------------------


def strip():
    """Each triangle a strip of its own, joined by corners there twice."""
    file = Gltf()
    following = np.roll(F[:, 0], -1)  # at an even place, from which a strip turns as it began
    rows = [[a, b, c, c, d, d] for (a, b, c), d in zip(F, following, strict=True)]
    points, corners = file.array(V, "f4"), file.array(np.ravel(rows), "u2")
    return file.show({"mesh": file.mesh(points, corners, mode=5)})


def fans():
    """A fan for each triangle, which are as many primitives of one array."""
    file = Gltf()
    points = file.array(V, "f4")
    parts = [
        {"attributes": {"POSITION": points}, "indices": file.array(row, "u2"), "mode": 6}
        for row in F
    ]
    return file.show({"mesh": file.put("meshes", {"primitives": parts})})


def interleaved():
    file = Gltf()
    view = file.view(np.hstack([V, V, np.ones((len(V), 2))]).astype("f4").tobytes(), byteStride=32)
    form = {"bufferView": view, "componentType": 5126, "count": len(V), "type": "VEC3"}
    points, normals = (file.put("accessors", form | {"byteOffset": b}) for b in (0, 12))
    uv = file.put("accessors", form | {"byteOffset": 24, "type": "VEC2"})
    names = {"POSITION": points, "NORMAL": normals, "TEXCOORD_0": uv}
    return file.show({"mesh": file.mesh(points, file.array(F.ravel(), "u2"), attributes=names)})


def quantized(kind, scale, *, normalized):
    """KHR_mesh_quantization: integers in rows of four, and the scale of the node."""
    file = Gltf()
    rows = np.zeros((len(V), 4), kind)
    rows[:, :3] = np.rint((V / 2 + (0.5 if kind[0] == "u" else 0)) * scale)
    view = file.view(rows.tobytes(), byteStride=rows.itemsize * 4)
    code = {"i2": 5122, "u2": 5123}[kind]
    form = {"bufferView": view, "componentType": code, "count": len(V), "type": "VEC3"}
    points = file.put("accessors", form | ({"normalized": True} if normalized else {}))
    file.tree["extensionsRequired"] = file.tree["extensionsUsed"] = ["KHR_mesh_quantization"]
    size = 2.0 if normalized else 2.0 / scale
    moved = {"translation": [-1.0] * 3} if kind[0] == "u" else {}
    mesh = file.mesh(points, file.array(F.ravel(), "u2"))
    return file.show({"mesh": mesh, "scale": [size] * 3} | moved)


def sparse(*, base):
    """Some points in a list of their own, over others, or over zeros."""
    file = Gltf()
    some = np.arange(len(V)) if not base else np.arange(5, 20)
    before = V.copy()
    before[some] = 0
    form = {"componentType": 5126, "count": len(V), "type": "VEC3"}
    rows = {"bufferView": file.view(some.astype("u2").tobytes()), "componentType": 5123}
    values = {"bufferView": file.view(V[some].astype("f4").tobytes())}
    form["sparse"] = {"count": len(some), "indices": rows, "values": values}
    if base:
        form["bufferView"] = file.view(before.astype("f4").tobytes())
    points = file.put("accessors", form)
    return file.show({"mesh": file.mesh(points, file.array(F.ravel(), "u2"))})


def nested():
    """A quarter turn, a mirror and its like again, of which nothing remains."""
    turn = {"rotation": [0, 0, np.sqrt(0.5), np.sqrt(0.5)], "translation": [5, 0, 0]}
    back = {"matrix": np.diag([-2.0, 2, 2, 1]).ravel().tolist(), "children": [2]}
    leaf = {"mesh": 0, "scale": [-0.5, 0.5, 0.5]}
    return changed(set_in("nodes", value=[turn | {"children": [1]}, back, leaf]))()


def deep():
    nodes = [{"children": [i + 1]} for i in range(1_200)]
    return changed(set_in("nodes", value=[*nodes, {"mesh": 0}]))()


def default_scene():
    file = plain()
    file.tree["nodes"].append({"mesh": file.surface(BALL), "translation": [9, 9, 9]})
    file.tree["scenes"], file.tree["scene"] = [{"nodes": [1]}, {"nodes": [0]}], 1
    return file


def beside(**primitive):
    """The sphere, and something else that a node shows."""
    file = plain()
    file.tree["nodes"].append({"mesh": file.mesh(file.array(V, "f4"), **primitive)})
    return file.show(*file.tree["nodes"])


def morphed():
    file = Gltf()
    shift = {"POSITION": file.array(V, "f4")}
    return file.show({"mesh": file.surface(BALL, targets=[shift]), "weights": [0.0]})


def padded_views():
    """Each view at a multiple of 256, as buffers of GPUs are laid out."""
    file = Gltf()
    points = file.array(V, "f4", padding=-len(V) * 12 % 256)
    return file.show({"mesh": file.mesh(points, file.array(F.ravel(), "u2", padding=256))})


ROUNDED = [*np.eye(4).ravel()[:15].tolist(), 0.99999994]  # a product of float32
LOOKS = ["KHR_materials_unlit", "KHR_texture_basisu", "KHR_xmp_json_ld"]
REST = "; vertices stand where they rest"


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (plain, ""),
        (changed(corners="u1"), ""),
        (strip, ""),
        (fans, ""),
        (interleaved, ""),
        (lambda: quantized("i2", 32767, normalized=True), ""),
        (lambda: quantized("u2", 65535, normalized=True), ""),
        (lambda: quantized("i2", 32000, normalized=False), ""),
        (lambda: sparse(base=True), ""),
        (lambda: sparse(base=False), ""),
        (changed(set_in("nodes", 0, "scale", value=[1, -1, 1])), ""),
        (nested, ""),
        (deep, ""),
        (changed(set_in("nodes", 0, "matrix", value=ROUNDED)), ""),
        (changed(renamed("scene")), ""),
        (changed(renamed("scene"), renamed("scenes")), ""),
        (changed(renamed("scene"), renamed("scenes"), renamed("nodes")), ""),
        (changed(set_in("scenery", value=[])), "passed over the unknown property 'scenery'"),
        (changed(set_in("textures", value=[])), ""),
        (padded_views, ""),
        (changed(set_in("extensionsRequired", value=LOOKS)), ""),
        (changed(set_in("nodes", 0, "extras", value={"anything": 1})), ""),
        (default_scene, "1 surface that no node shows"),
        (lambda: beside(mode=0), "1 lone point set"),
        (lambda: beside(mode=3), "1 curve"),
        (morphed, f"1 morph target{REST}"),
        (changed(set_in("nodes", 0, "skin", value=0)), f"1 skin{REST}"),
        (changed(set_in("nodes", 0, "guid", value="")), "passed over the unknown property 'guid'"),
    ],
)
def test_gltf_as_programs_write_it(tmp_path, make, told):
    path, file = tmp_path / "a.glb", make()
    path.write_bytes(file.glb())
    rtol = 1e-3 if make.__name__ == "<lambda>" else 1e-5  # integers of 15 bits
    if not told:
        is_ball(path, rtol=rtol)
    else:
        with pytest.warns(IgnoredContentWarning) as heard:
            is_ball(path, rtol=rtol)
        assert [w.message.told().count(told) for w in heard] == [1]
        assert str(heard[0].message).startswith(f"{path}: ")
    (tmp_path / "b.gltf").write_bytes(b"\xef\xbb\xbf" * (not told) + file.text())
    with pytest.warns(IgnoredContentWarning) if told else nullcontext():
        is_ball(tmp_path / "b.gltf", rtol=rtol)


@pytest.mark.parametrize("corners", [[0, 1, 3, 2], [0, 1, 3, 3, 1, 1, 1, 2, 3]])
def test_strips_in_a_mirror_look_the_way_that_they_say(tmp_path, corners):
    """A square from above, and half turned and mirrored, its corners bytes of 0 and 127."""
    file = Gltf()
    rows = np.pad(127 * SQUARE, ((0, 0), (0, 1))).astype("i1")
    form = {"componentType": 5120, "normalized": True, "count": 4, "type": "VEC3"}
    form["bufferView"] = file.view(rows.tobytes(), byteStride=4)
    points = file.put("accessors", form)
    mesh = file.mesh(points, file.array(corners, "u2"), mode=5)
    turned = {"mesh": mesh, "rotation": [0, 1, 0, 0], "scale": [2, 2, -2]}
    (tmp_path / "a.glb").write_bytes(file.show({"mesh": mesh}, turned).glb())
    found = read(tmp_path / "a.glb")
    np.testing.assert_allclose(found.points, [*SQUARE, *(SQUARE * [-2, 2, 1])], atol=1e-12)
    normals = np.cross(*(np.diff(found.points[found.faces], axis=1).transpose(1, 0, 2)))[:, 2]
    np.testing.assert_allclose(normals, [1, 1, 4, 4])


def test_gltf_without_indices_is_as_loose_as_its_file(tmp_path):
    file = Gltf()
    points = file.array(V[F].reshape(-1, 3), "f4")
    (tmp_path / "a.glb").write_bytes(file.show({"mesh": file.mesh(points)}).glb())
    loose = read(tmp_path / "a.glb")
    assert loose.n == 3 * len(F)
    is_ball(loose.with_merged_vertices())


def test_gltf_that_shows_one_mesh_three_times(tmp_path):
    file = Gltf()
    mesh = file.surface(BALL)
    file.show(*({"mesh": mesh, "translation": [3 * i, 0, 0]} for i in range(3)))
    (tmp_path / "a.glb").write_bytes(file.glb())
    is_ball(tmp_path / "a.glb", copies=3)


def test_glb_with_padding_other_chunks_and_what_follows(tmp_path):
    path = tmp_path / "a.gltf"  # as those call it who take the two for one
    path.write_bytes(plain().glb((0x12345678, b"own data"), padding=64))
    is_ball(path)
    path.write_bytes(plain().glb() + b"<!-- saved -->")
    with pytest.warns(IgnoredContentWarning, match="passed over 14 trailing bytes"):
        is_ball(path)


def test_scenes_of_trimesh(tmp_path):
    box, scene = trimesh.creation.box(), trimesh.Scene()
    scene.add_geometry(box, transform=trimesh.transformations.translation_matrix([10, 0, 0]))
    scene.add_geometry(box, transform=np.diag([2.0, 3.0, 4.0, 1.0]))
    scene.export(tmp_path / "two.glb")
    merged = read(tmp_path / "two.glb")
    assert (merged.n, len(merged.faces)) == (2 * len(box.vertices), 2 * len(box.faces))
    np.testing.assert_allclose(merged.area, 6.0 + 2 * (6 + 8 + 12), rtol=1e-6)
    np.testing.assert_allclose(merged.points.max(axis=0), [10.5, 1.5, 2.0])
    trimesh.Scene(trimesh.PointCloud(SQUARE)).export(tmp_path / "points.glb")
    cloud = read(tmp_path / "points.glb")
    assert isinstance(cloud, PointCloud)
    np.testing.assert_array_equal(cloud.points, SQUARE)
    trimesh.Scene(trimesh.load_path(SQUARE)).export(tmp_path / "curve.glb")
    with pytest.raises(InvalidInputError, match="holds neither a mesh nor a point set"):
        read(tmp_path / "curve.glb")


# --- where its buffers lie ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("uri", "file"),
    [
        ("a.bin", "a.bin"),
        ("./my%20data.bin", "my data.bin"),
        ("buffers/a.bin", "buffers/a.bin"),
        ("buffers\\a.bin", "buffers/a.bin"),
        ("buffers/../a.bin", "a.bin"),
        ("%C3%A4.bin", "ä.bin"),
    ],
)
def test_buffers_in_the_folder_or_below(tmp_path, monkeypatch, uri, file):
    (tmp_path / "in/buffers").mkdir(parents=True)
    path = plain().beside(tmp_path / "in/a.gltf", uri, tmp_path / "in" / file)
    is_ball(path)
    is_ball(tmp_path / "in/buffers/../a.gltf")
    monkeypatch.chdir(tmp_path / "in")
    is_ball("a.gltf")


def test_a_buffer_that_is_not_there_is_named(tmp_path):
    path = plain().beside(tmp_path / "a.gltf", "a.bin", tmp_path / "a.bin")
    (tmp_path / "a.bin").unlink()
    with pytest.raises(InvalidFileError, match=r"'a\.bin', which holds its arrays, is no file"):
        read(path)


@pytest.mark.parametrize(
    "uri",
    [
        "../a.bin",
        "%2e%2e/a.bin",
        "%2E%2E%2Fa.bin",
        "..\\a.bin",
        "x/../../a.bin",
        "link.bin",
        "below/a.bin",
        "{}/a.bin",
        "file://{}/a.bin",
        "file:a.bin",
        "http://localhost/a.bin",
        "a.bin%00",
        "x" * 5_000,
        ".",
    ],
)
def test_buffers_elsewhere_are_refused_and_welcome_as_copies(tmp_path, uri):
    path = tmp_path / "in/a.gltf"
    plain().beside(path, uri.format(tmp_path), tmp_path / "a.bin")
    (tmp_path / "in/link.bin").symlink_to(tmp_path / "a.bin")
    (tmp_path / "in/below").symlink_to(tmp_path)
    with pytest.raises(InvalidFileError, match="not a whole glTF file") as caught:
        read(path)
    assert "copy it there, name it by its name alone" in str(caught.value)
    shutil.copy(tmp_path / "a.bin", tmp_path / "in/copy.bin")
    tree = json.loads(path.read_text())
    tree["buffers"][0]["uri"] = "copy.bin"
    path.write_text(json.dumps(tree))
    is_ball(path)


def test_links_as_keepers_of_data_make_them(tmp_path):
    """The file alone is a link, or it and its buffer are, into one folder or to a store of both."""
    path = plain().beside(tmp_path / "data/a.gltf", "a.bin", tmp_path / "data/a.bin")
    work = tmp_path / "work"
    work.mkdir()
    (work / "a.gltf").symlink_to(path)
    is_ball(work / "a.gltf")
    (work / "a.bin").symlink_to(tmp_path / "data/a.bin")
    is_ball(work / "a.gltf")
    (tmp_path / "blobs").mkdir()
    for name, blob in (("a.gltf", "5e0f"), ("a.bin", "77aa")):
        (tmp_path / "data" / name).rename(tmp_path / "blobs" / blob)
        (work / name).unlink()
        (work / name).symlink_to(f"../blobs/{blob}")
    is_ball(work / "a.gltf")


# --- what does not fit together -------------------------------------------------------------------


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
        (set_in("buffers", value=[{"byteLength": 10**9}]), "must have 1000000000 bytes, got"),
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
def test_gltf_that_does_not_fit_together(tmp_path, change, message):
    (tmp_path / "a.glb").write_bytes(changed(change)().glb())
    with pytest.raises(InvalidInputError, match=message):
        read(tmp_path / "a.glb")


def test_json_without_end(tmp_path):
    (tmp_path / "a.gltf").write_text('{"nodes": ' + "[" * 10**5)
    with pytest.raises(InvalidInputError, match="not a whole glTF file"):
        read(tmp_path / "a.gltf")


def test_indices_of_one_part_do_not_reach_into_the_next(tmp_path):
    file = Gltf()
    file.show({"mesh": file.surface(BALL)}, {"mesh": file.surface(BALL)})
    file.data = bytes([len(V)]) + file.data[1:]  # which begins with the indices of the first
    (tmp_path / "a.glb").write_bytes(file.glb())
    with pytest.raises(InvalidInputError, match=r"`indices` must be in \[0, 42\), got 42"):
        read(tmp_path / "a.glb")
