"""Files as other programs write them: read as the sphere that they hold, or refused with a way on.

All hold one triangulated unit sphere, whose counts, volume and lowest modes are known.
"""

import bz2
import gzip
import json
import lzma
import re
import shutil
import tracemalloc
import zipfile
from contextlib import nullcontext

import numpy as np
import pytest
import pyvista
import torch
import trimesh
from gltf_files import Gltf

import spectra_kit
from spectra_kit import Dense, as_geometry, cotan_laplacian, eigensolve
from spectra_kit.datasets import find_inputs
from spectra_kit.errors import IgnoredContentWarning, InvalidFileError, InvalidInputError
from spectra_kit.geometry import TriangleMesh, read, sphere, write
from spectra_kit.geometry.formats import _room
from spectra_kit.geometry.io import MESH_WRITERS

BALL = sphere(subdivisions=1).geometry
V, F = np.array(BALL.points), np.array(BALL.faces)
VOLUME = np.linalg.det(V[F]).sum() / 6  # positive where the surface faces outwards
RATE = eigensolve(cotan_laplacian(BALL), 2, Dense()).eigenvalues[1]


def is_ball(thing, *, copies=1, rtol=1e-5):
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


def test_the_sphere_is_one():
    assert abs(RATE / 2 - 1) < 0.05  # l (l + 1) of l = 1
    assert abs(VOLUME / (4 / 3 * np.pi) - 1) < 0.15


# --- glTF -----------------------------------------------------------------------------------------


def plain():
    file = Gltf()
    return file.show({"mesh": file.surface(BALL)})


def small_indices():
    file = Gltf()
    return file.show({"mesh": file.surface(BALL, corners="u1")})


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
    changed = V.copy()
    changed[some] = 0
    form = {"componentType": 5126, "count": len(V), "type": "VEC3"}
    rows = {"bufferView": file.view(some.astype("u2").tobytes()), "componentType": 5123}
    values = {"bufferView": file.view(V[some].astype("f4").tobytes())}
    form["sparse"] = {"count": len(some), "indices": rows, "values": values}
    if base:
        form["bufferView"] = file.view(changed.astype("f4").tobytes())
    points = file.put("accessors", form)
    return file.show({"mesh": file.mesh(points, file.array(F.ravel(), "u2"))})


def mirrored():
    file = plain()
    file.tree["nodes"][0] |= {"scale": [1, -1, 1]}
    return file


def nested():
    """A quarter turn, a mirror and its like again, of which nothing remains."""
    file = plain()
    turn = {"rotation": [0, 0, np.sqrt(0.5), np.sqrt(0.5)], "translation": [5, 0, 0]}
    back = {"matrix": np.diag([-2.0, 2, 2, 1]).ravel().tolist(), "children": [2]}
    leaf = {"mesh": 0, "scale": [-0.5, 0.5, 0.5]}
    file.tree["nodes"] = [turn | {"children": [1]}, back, leaf]
    return file


def rounded_matrix():
    """A product of float32 that is not quite one in its corner."""
    file = plain()
    file.tree["nodes"][0]["matrix"] = [*np.eye(4).ravel()[:15].tolist(), 0.99999994]
    return file


def default_scene():
    file = plain()
    file.tree["nodes"].append({"mesh": file.surface(BALL), "translation": [9, 9, 9]})
    file.tree["scenes"], file.tree["scene"] = [{"nodes": [1]}, {"nodes": [0]}], 1
    return file


def without(*keys):
    file = plain()
    for key in keys:
        del file.tree[key]
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


def skinned():
    file = plain()
    file.tree["nodes"][0]["skin"] = 0
    file.tree["skins"] = [{"joints": [0]}]
    return file


def padded_views():
    """Each view at a multiple of 256, as buffers of GPUs are laid out."""
    file = Gltf()
    points = file.array(V, "f4", padding=-len(V) * 12 % 256)
    return file.show({"mesh": file.mesh(points, file.array(F.ravel(), "u2", padding=256))})


def with_own_words():
    file = plain()
    file.tree["nodes"][0]["guid"] = "5e0"
    file.tree["nodes"][0]["extras"] = {"anything": 1}
    return file


def with_word(word):
    """A property of the file that is like another, which is there as well, or none of shapes."""
    file = plain()
    file.tree[word] = []
    return file


def with_looks():
    file = plain()
    names = ["KHR_materials_unlit", "KHR_texture_transform", "KHR_xmp_json_ld"]
    file.tree["extensionsRequired"] = file.tree["extensionsUsed"] = names
    return file


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (plain, ""),
        (small_indices, ""),
        (strip, ""),
        (fans, ""),
        (interleaved, ""),
        (lambda: quantized("i2", 32767, normalized=True), ""),
        (lambda: quantized("u2", 65535, normalized=True), ""),
        (lambda: quantized("i2", 32000, normalized=False), ""),
        (lambda: sparse(base=True), ""),
        (lambda: sparse(base=False), ""),
        (mirrored, ""),
        (nested, ""),
        (rounded_matrix, ""),
        (lambda: without("scene"), ""),
        (lambda: without("scene", "scenes"), ""),
        (lambda: without("scene", "scenes", "nodes"), ""),
        (lambda: with_word("scenery"), "passed over the unknown property 'scenery'"),
        (lambda: with_word("textures"), ""),
        (padded_views, ""),
        (with_looks, ""),
        (default_scene, "1 surface that no node shows"),
        (lambda: beside(mode=0), "1 lone point set"),
        (lambda: beside(mode=3), "1 curve"),
        (morphed, "1 morph target; vertices stand where they rest"),
        (skinned, "1 skin; vertices stand where they rest"),
        (with_own_words, "passed over the unknown property 'guid'"),
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


# --- packed files ---------------------------------------------------------------------------------

PACK = {".gz": gzip.compress, ".bz2": bz2.compress, ".xz": lzma.compress}


@pytest.mark.parametrize("packing", PACK)
@pytest.mark.parametrize("suffix", [*MESH_WRITERS, ".PLY"])
def test_packed_files(tmp_path, suffix, packing):
    write(BALL, tmp_path / f"a{suffix}")
    data = (tmp_path / f"a{suffix}").read_bytes()
    (tmp_path / f"a{suffix}").unlink()
    path = tmp_path / f"a{suffix}{packing}"
    path.write_bytes(PACK[packing](data))
    is_ball(path)
    assert [one.path for one in find_inputs([str(tmp_path)])] == [path]
    path.write_bytes(PACK[packing](data)[:-9])
    with pytest.raises(InvalidFileError, match=r"cannot be unpacked \(.*; the file may be cut"):
        read(path)
    path.write_bytes(PACK[packing](b""))
    with pytest.raises(InvalidFileError, match="what it packs is empty"):
        read(path)


def test_packed_clouds_and_members(tmp_path):
    np.save(tmp_path / "a.npy", V)
    (tmp_path / "a.npy.gz").write_bytes(gzip.compress((tmp_path / "a.npy").read_bytes()))
    np.testing.assert_array_equal(read(tmp_path / "a.npy.gz").points, V)
    lines = "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in V.tolist())
    halves = lines[:500].encode(), lines[500:].encode()
    (tmp_path / "a.xyz.gz").write_bytes(b"".join(map(gzip.compress, halves)))
    np.testing.assert_array_equal(read(tmp_path / "a.xyz.gz").points, V)


def test_packed_files_whose_names_mislead(tmp_path):
    write(BALL, tmp_path / "a.ply")
    (tmp_path / "b.ply.gz").write_bytes((tmp_path / "a.ply").read_bytes())  # a browser unpacked it
    with pytest.raises(InvalidFileError, match=r"is not packed.*; rename it to b\.ply"):
        read(tmp_path / "b.ply.gz")
    is_ball((tmp_path / "b.ply.gz").rename(tmp_path / "b.ply"))
    for name in ("a.gz", "a.tar.gz"):
        with pytest.raises(InvalidFileError, match=f"cannot read the format '{name[1:-3]}"):
            read(tmp_path / name)
    path = plain().beside(tmp_path / "c.gltf", "c.bin", tmp_path / "c.bin")
    (tmp_path / "c.gltf.gz").write_bytes(gzip.compress(path.read_bytes()))
    path.unlink()
    with pytest.raises(InvalidFileError, match=r"copy it there, .* and unpack what is packed"):
        read(tmp_path / "c.gltf.gz")
    path.write_bytes(gzip.decompress((tmp_path / "c.gltf.gz").read_bytes()))
    is_ball(path)


# --- arrays ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "arrays",
    [
        {"V": V, "F": F},
        {"V": np.asfortranarray(V, ">f8"), "F": np.asfortranarray(F, ">u2")},
        {"vertices": V.astype("f4"), "faces": F.astype("u1")},
        {"verts": V, "faces": F.astype("i4"), "normals": V, "colours": np.ones((len(V), 4))},
        {"VERT": V, "TRIV": F},
        {"vert": V, "tri": F.astype("u8")},
        {"v": V, "f": F, "n": V},
        {"points": np.repeat(V, 2, axis=0)[::2], "triangles": F},
    ],
)
@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_npz_by_any_name(tmp_path, arrays, save):
    save(tmp_path / "a.npz", **arrays)
    is_ball(tmp_path / "a.npz")


@pytest.mark.parametrize(
    ("arrays", "problem", "way_on"),
    [
        ({"VERT": V, "TRIV": F + 1}, r"d\[...\] - 1\)", lambda d: (d["VERT"], d["TRIV"] - 1)),
        ({"V": V, "F": F + 1}, "indices count from 0", lambda d: (d["V"], d["F"] - 1)),
        ({"a": V, "b": F}, r"\(d\[...\], d\[...\]\)", lambda d: (d["a"], d["b"])),
        ({"V": V, "points": V, "F": F}, r"d\[...\]\)", lambda d: (d["V"], d["F"])),
        ({"V": V.T, "F": F}, "its transpose", lambda d: (d["V"].T, d["F"])),
        (
            {"VERT": V, "TRIV": F.astype(str)},
            "integers",
            lambda d: (d["VERT"], d["TRIV"].astype(int)),
        ),
    ],
)
def test_npz_that_needs_a_word(tmp_path, arrays, problem, way_on):
    path = tmp_path / "a.npz"
    np.savez(path, **arrays)
    with pytest.raises(InvalidFileError, match=problem):
        read(path)
    is_ball(way_on(np.load(path)))


# --- what is announced ----------------------------------------------------------------------------


@pytest.fixture
def little_room(monkeypatch):
    """Two MiB for any small file, so that hundreds are not needed to pass it."""
    monkeypatch.setattr(_room, "ALWAYS", 1 << 21)


def instances(path, k):
    file = plain()
    path.write_bytes(
        file.show(*({"mesh": 0, "translation": [3 * i, 0, 0]} for i in range(k))).glb()
    )


def one_accessor(path, **accessor):
    file = plain()
    file.tree["accessors"][1] |= accessor
    path.write_bytes(file.glb())


def zeros_but_one(path):
    file = Gltf()
    rows = {"bufferView": file.view(np.array([7], "u2").tobytes()), "componentType": 5123}
    values = {"bufferView": file.view(V[:1].astype("f4").tobytes())}
    form = {"componentType": 5126, "count": 10**9, "type": "VEC3"}
    form["sparse"] = {"count": 1, "indices": rows, "values": values}
    path.write_bytes(file.show({"mesh": file.mesh(file.put("accessors", form))}).glb())


def many_views_of_one_file(path):
    file = plain()
    file.data += bytes(1 << 16)
    file.beside(path, "a.bin", path.with_name("a.bin"))
    tree = json.loads(path.read_text())
    names = (f"{'./' * (i % 50)}a.bin" for i in range(400))
    tree["buffers"] = [{"uri": uri, "byteLength": len(file.data)} for uri in names]
    tree["accessors"][1]["count"] = 10**8
    path.write_text(json.dumps(tree))


def npz_of(path, announced, held, method=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", method) as archive, archive.open("points.npy", "w") as file:
        head = {"descr": "<f8", "fortran_order": False, "shape": announced}
        np.lib.format.write_array_header_1_0(file, head)
        for _ in range(held >> 20):
            file.write(bytes(1 << 20))


@pytest.mark.parametrize(
    ("name", "make", "problem"),
    [
        ("a.glb", lambda path: instances(path, 600), "shows more than"),
        ("a.glb", lambda path: one_accessor(path, count=10**8), "shows more than"),
        ("a.glb", zeros_but_one, "shows more than"),
        ("a.gltf", many_views_of_one_file, "shows more than"),
        ("a.npz", lambda path: npz_of(path, (10, 3), 16 << 20), "unpack to more than"),
        ("a.npz", lambda path: npz_of(path, (1 << 18, 8), 16 << 20), "unpack to more than"),
        ("a.npz", lambda path: npz_of(path, (1 << 40, 3), 1 << 20), "header announces shape"),
        ("a.npz", lambda path: npz_of(path, (10, 3), 16 << 20, zipfile.ZIP_BZIP2), "more than"),
        ("a.npy", lambda path: npy_of(path, (1 << 40, 3)), "header announces shape"),
        (
            "a.ply.gz",
            lambda path: path.write_bytes(gzip.compress(bytes(16 << 20))),
            "unpacks to more",
        ),
        (
            "a.obj.bz2",
            lambda path: path.write_bytes(bz2.compress(bytes(16 << 20))),
            "unpacks to more",
        ),
        (
            "a.off.xz",
            lambda path: path.write_bytes(lzma.compress(bytes(16 << 20), preset=0)),
            "unpacks to more",
        ),
    ],
)
@pytest.mark.usefixtures("little_room")
def test_memory_follows_what_is_there_not_what_is_announced(tmp_path, name, make, problem):
    path = tmp_path / name
    make(path)
    most = _room.room(sum(one.stat().st_size for one in tmp_path.iterdir()))
    tracemalloc.start()
    try:
        with pytest.raises(InvalidFileError, match=problem) as caught:
            read(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert caught.value.path == path
    assert peak < 4 * most


def npy_of(path, announced):
    with path.open("wb") as file:
        head = {"descr": "<f8", "fortran_order": False, "shape": announced}
        np.lib.format.write_array_header_1_0(file, head)
        file.write(V.tobytes())


@pytest.mark.usefixtures("little_room")
def test_ways_on_where_a_file_is_right_to_unfold_so_far(tmp_path):
    instances(tmp_path / "a.glb", 900)
    with pytest.raises(InvalidFileError) as caught:
        read(tmp_path / "a.glb")
    mesh = as_geometry(follow(caught.value, r"hand over (.*)$", path=tmp_path / "a.glb"))
    np.testing.assert_allclose(mesh.area, 900 * BALL.area, rtol=1e-5)
    path = tmp_path / "a.npz"
    np.savez_compressed(path, points=np.zeros((200_000, 3)))
    with pytest.raises(InvalidFileError) as caught:
        read(path)
    follow(caught.value, r"if it is right, (numpy.*) writes it unpacked", path=path)
    assert read(path).n == 200_000
    path = tmp_path / "b.npy.gz"
    path.write_bytes(gzip.compress((tmp_path / "a.npz").read_bytes()[:1] + bytes(3 << 20)))
    with pytest.raises(InvalidFileError, match=r"unpack it yourself and read b\.npy"):
        read(path)


def follow(error, pattern, **names):
    """Do what an error says, as it is written there."""
    known = {"numpy": np, "trimesh": trimesh, "pyvista": pyvista, "spectra_kit": spectra_kit}
    return eval(re.search(pattern, str(error))[1], known | names)


# --- formats of others ----------------------------------------------------------------------------


def write_by_meshio(path, **options):
    meshio = pytest.importorskip("meshio")
    meshio.write(path, meshio.Mesh(V, [("triangle", F)]), **options)


def write_gifti(path):
    nibabel = pytest.importorskip("nibabel")
    parts = (V.astype("f4"), "NIFTI_INTENT_POINTSET"), (F.astype("i4"), "NIFTI_INTENT_TRIANGLE")
    arrays = [nibabel.gifti.GiftiDataArray(array, intent=intent) for array, intent in parts]
    nibabel.save(nibabel.gifti.GiftiImage(darrays=arrays), path)


def write_freesurfer(path):
    pytest.importorskip("nibabel").freesurfer.write_geometry(str(path), V, F)


FOREIGN = [
    ("a.vtp", lambda path: polydata().save(path)),
    ("a.vtk", lambda path: polydata().save(path)),
    ("b.vtk", write_by_meshio),
    ("a.vtu", write_by_meshio),
    ("a.vtm", lambda path: pyvista.MultiBlock([polydata()]).save(path)),
    ("a.msh", lambda path: write_by_meshio(path, file_format="gmsh")),
    ("a.mesh", write_by_meshio),
    ("a.inp", write_by_meshio),
    ("a.surf.gii", write_gifti),
    ("lh.pial", write_freesurfer),
]


@pytest.mark.filterwarnings("ignore:The default value of `algorithm`", "ignore::UserWarning")
@pytest.mark.parametrize(("name", "make"), FOREIGN)
def test_unknown_formats_say_who_reads_them(tmp_path, name, make):
    path = tmp_path / name
    make(path)
    with pytest.raises(InvalidFileError, match="cannot read the format") as caught:
        read(path)
    names = {}
    for library in ("meshio", "nibabel"):
        if f"{library}." in str(caught.value):
            names[library] = pytest.importorskip(library)
    if "nibabel.freesurfer" in str(caught.value):
        import nibabel.freesurfer  # noqa: F401
    is_ball(follow(caught.value, r"; hand over (.*), or convert it", path=path, **names))
    converting = r"convert it once: (spectra_kit.write\(.*\)); known are"
    text = str(caught.value).replace(f"'{path.stem.partition('.')[0]}.ply'", "out")
    text = re.sub(r"'\w+(\.surf)?\.ply'", "out", text)
    follow(text, converting, path=path, out=tmp_path / "out.ply", **names)
    is_ball(tmp_path / "out.ply")


def test_files_of_numbers_say_how(tmp_path):
    np.savetxt(tmp_path / "a.csv", V, delimiter=",", header="x,y,z", comments="")
    with pytest.raises(InvalidFileError) as caught:
        read(tmp_path / "a.csv")
    cloud = as_geometry(follow(caught.value, "hand over (.*), or", path=tmp_path / "a.csv"))
    np.testing.assert_allclose(cloud.points, V)
    np.savetxt(tmp_path / "a.txt", V)
    with pytest.raises(InvalidFileError, match=r"if each line holds a point, rename it to \.xyz"):
        read(tmp_path / "a.txt")
    (tmp_path / "a.txt").rename(tmp_path / "a.xyz")
    np.testing.assert_allclose(read(tmp_path / "a.xyz").points, V)
    import scipy.io

    scipy.io.savemat(tmp_path / "a.mat", {"VERT": V, "TRIV": F + 1})
    with pytest.raises(InvalidFileError) as caught:
        read(tmp_path / "a.mat")
    m = follow(caught.value, r"m = (scipy\S*),", path=tmp_path / "a.mat", scipy=scipy)
    is_ball(follow(caught.value, r"path\), (\(m.*\)) or", m=m))


@pytest.mark.parametrize(
    ("name", "way_on"),
    [
        ("a.fbx", "Blender or MeshLab exports"),
        ("a.STEP", "of which gmsh makes triangles"),
        ("a.nii.gz", r"hand over what skimage\.measure\.marching_cubes"),
        ("a.zip", "unpack it first"),
        ("a.vtp.gz", r"unpack it, then hand over pyvista\.read\(path\)"),
        ("{a}.vtp.gz", r"convert it once: .*'\{a\}.ply'\), of \{a\}.vtp"),
        ("a.unheard", "hand over meshio"),
        ("none", "hand over meshio"),
    ],
)
def test_other_formats_name_a_way_on(tmp_path, name, way_on):
    with pytest.raises(InvalidFileError, match=way_on):
        read(tmp_path / name)


# --- objects --------------------------------------------------------------------------------------


def polydata():
    return pyvista.PolyData.from_regular_faces(V, F)


def with_cells(verts=(), lines=()):
    surface = polydata()
    if len(verts):
        surface.verts = np.array(verts)
    if len(lines):
        surface.lines = np.array(lines)
    return surface


def vtk_surface():
    from vtkmodules.vtkCommonDataModel import vtkPolyData

    plain = vtkPolyData()
    plain.DeepCopy(polydata())
    return plain


def meshio_mesh(*cells, points=V):
    return pytest.importorskip("meshio").Mesh(points, list(cells))


def gifti(tmp_path):
    write_gifti(tmp_path / "a.gii")
    return pytest.importorskip("nibabel").load(tmp_path / "a.gii")


def lapy_mesh():
    return pytest.importorskip("lapy").TriaMesh(V, F)


def pymeshlab_mesh():
    pymeshlab = pytest.importorskip("pymeshlab")
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(V, F))
    return meshes


def graph():
    data = pytest.importorskip("torch_geometric.data")
    return data.Data(pos=torch.tensor(V), face=torch.tensor(F.T.copy()))


class Other:
    """What many libraries have: arrays by these names."""

    vertices, faces = V, F


def read_only():
    arrays = V.copy(), F.copy()
    for array in arrays:
        array.flags.writeable = False
    return arrays


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (polydata, ""),
        (vtk_surface, ""),
        (lambda: trimesh.Trimesh(V, F, process=False), ""),
        (lambda: meshio_mesh(("triangle", F)), ""),
        (lambda: meshio_mesh(("triangle", F[:9]), ("triangle", F[9:])), ""),
        (lambda: meshio_mesh(("polygon", F.tolist())), ""),
        (lapy_mesh, ""),
        (pymeshlab_mesh, ""),
        (graph, ""),
        (Other, ""),
        (lambda: (V, F), ""),
        (lambda: [V, F], ""),
        (lambda: (V.tolist(), F.tolist()), ""),
        (lambda: (np.asfortranarray(V, ">f4"), np.asfortranarray(F, ">i2")), ""),
        (lambda: (np.repeat(V, 2, axis=0)[::2], np.repeat(F, 2, axis=1)[:, ::2]), ""),
        (lambda: (torch.tensor(V), torch.tensor(F)), ""),
        (lambda: (torch.tensor(V, dtype=torch.float32), F), ""),
        (read_only, ""),
        (lambda: with_cells(verts=[1, 0, 1, 5]), "2 vertex cells beside"),
        (lambda: with_cells(lines=[2, 0, 1]), "1 line beside"),
        (lambda: with_cells(verts=[2, 0, 3], lines=[3, 0, 1, 2]), "1 vertex cell, 1 line beside"),
        (lambda: meshio_mesh(("line", F[:, :2]), ("triangle", F)), "80 line cells beside"),
        (lambda: meshio_mesh(("triangle", F), ("vertex", [[3]])), "1 vertex cell beside"),
        (lambda: meshio_mesh(("triangle", F), ("tetra", [[0, 1, 2, 3]])), "1 tetra cell beside"),
        (lambda: (V, F, V, np.ones(len(V))), "what follows the faces: 2 items"),
        (lambda: (V, F.astype("i4"), {"head": [2, 0, 20]}, "created by"), "2 items"),
    ],
)
def test_objects_that_are_a_surface(make, told):
    with pytest.warns(IgnoredContentWarning, match=told) if told else nullcontext():
        is_ball(make())


def test_objects_of_files(tmp_path):
    is_ball(gifti(tmp_path))
    is_ball(gifti(tmp_path).agg_data())


# A square, a house whose roof is bent in, and a triangle: of area 1 + 3 / 2 + 1 / 2.
OUTLINES = [[0, 1, 2, 3], [4, 5, 6, 7, 8], [9, 10, 11]]
CORNERS = np.array(
    [
        *[[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]],
        *[[3, 0, 0], [5, 0, 0], [5, 1, 0], [4, 0.5, 0], [3, 1, 0]],
        *[[6, 0, 0], [7, 0, 0], [6, 1, 0]],
    ]
)
PADDED = [size for row in OUTLINES for size in (len(row), *row)]


@pytest.mark.filterwarnings("ignore:The default value of `algorithm`")
@pytest.mark.parametrize(
    "make",
    [
        lambda: pyvista.PolyData(CORNERS, PADDED),
        lambda: meshio_mesh(
            ("quad", [OUTLINES[0]]),
            ("polygon", [OUTLINES[1]]),
            ("triangle", [OUTLINES[2]]),
            points=CORNERS,
        ),
        lambda: (CORNERS, OUTLINES),
        lambda: (CORNERS, [np.array(row) for row in OUTLINES]),
        lambda: (CORNERS[:, :2], OUTLINES),
        lambda: (CORNERS[:, :2].tolist(), tuple(map(tuple, OUTLINES))),
    ],
)
def test_objects_of_polygons(make):
    mesh = as_geometry(make())
    np.testing.assert_array_equal(mesh.points, CORNERS)
    a, b, c = np.moveaxis(mesh.points[mesh.faces], 1, 0)
    areas = np.cross(b - a, c - a)[:, 2] / 2
    assert (areas > 0).all()
    np.testing.assert_allclose([areas[:2].sum(), areas[2:5].sum(), areas[5]], [1, 1.5, 0.5])


def test_planar_vertices_and_strips():
    flat = as_geometry((CORNERS[:, :2], [[0, 1, 2], [0, 2, 3]]))
    np.testing.assert_array_equal(flat.points, CORNERS)
    np.testing.assert_allclose(flat.area, 1)
    strip = pyvista.PolyData(CORNERS, strips=[4, 0, 1, 3, 2])
    np.testing.assert_allclose(as_geometry(strip).area, 1)
    with pytest.raises(InvalidInputError, match=r"of planar ones, numpy\.column_stack") as caught:
        as_geometry(CORNERS[:, :2])
    points = follow(caught.value, r"ones, (.*) makes", points=CORNERS[:, :2])
    np.testing.assert_array_equal(as_geometry(points).points, CORNERS)


TETRAHEDRA = np.array([[0, 1, 2, 3]])
SIMPLEX = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
SIMPLEX_AREA = (3 + np.sqrt(3)) / 2


def second_order():
    """Triangles of six points, the last three between corners, on the faces of a tetrahedron."""
    corners = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]
    pairs = sorted({tuple(sorted((row[i], row[i - 1]))) for row in corners for i in range(3)})
    points = np.vstack([SIMPLEX, [(SIMPLEX[a] + SIMPLEX[b]) / 2 for a, b in pairs]])
    sides = lambda a, b: 4 + pairs.index((min(a, b), max(a, b)))  # noqa: E731
    cells = [[a, b, c, sides(a, b), sides(b, c), sides(c, a)] for a, b, c in corners]
    return meshio_mesh(("triangle6", cells), points=points)


def solid():
    return pyvista.UnstructuredGrid({pyvista.CellType.TETRA: TETRAHEDRA}, SIMPLEX)


@pytest.mark.filterwarnings("ignore:The default value of `algorithm`")
@pytest.mark.parametrize(
    ("make", "pattern", "area"),
    [
        (solid, r"its surface is (extract_surface\(\))", SIMPLEX_AREA),
        (
            lambda: pyvista.MultiBlock([solid(), solid().translate([5, 0, 0])]),
            r"its surface is (combine\(\)\.extract_surface\(\))",
            2 * SIMPLEX_AREA,
        ),
        (
            lambda: meshio_mesh(("tetra", TETRAHEDRA), points=SIMPLEX),
            r"is (pyvista\.wrap\(mesh\)\.extract_surface\(\))",
            SIMPLEX_AREA,
        ),
        (second_order, r"is (pyvista\.wrap\(mesh\)\.extract_surface\(\))", SIMPLEX_AREA),
        (
            lambda: pytest.importorskip("lapy").TetMesh(SIMPLEX, TETRAHEDRA),
            r"its surface is (boundary_tria\(\))",
            SIMPLEX_AREA,
        ),
        (
            lambda: trimesh.Scene(trimesh.Trimesh(V, F, process=False)),
            r"scene\.(to_mesh\(\)) makes one mesh",
            BALL.area,
        ),
        (lambda: (CORNERS, [[0, 1, 2, 3]]), r"quads are taken as (.*), tetrahedra", 1),
        (
            lambda: (SIMPLEX, TETRAHEDRA),
            r"tetrahedra as (.*\.extract_surface\(\))",
            SIMPLEX_AREA,
        ),
        (lambda: (CORNERS, [[4, 5, 6, 7, 8]]), r"polygons are taken as (.*)", 1.5),
    ],
)
def test_objects_that_are_no_surface_yet_say_how(make, pattern, area):
    thing = make()
    with pytest.raises(InvalidInputError, match=r"must (be|have)") as caught:
        as_geometry(thing)
    names = {"mesh": thing}
    if isinstance(thing, tuple):
        names = {"points": np.asarray(thing[0]), "faces": np.asarray(thing[1])}
    if (call := re.search(pattern, str(caught.value))[1]).startswith("pyvista."):
        made = follow(caught.value, pattern, **names)
    else:
        made = eval(f"thing.{call}")
    np.testing.assert_allclose(as_geometry(made).area, area, rtol=1e-6)


@pytest.mark.parametrize(
    "thing",
    [
        lambda: pyvista.PolyData(V),
        lambda: trimesh.PointCloud(V),
        lambda: meshio_mesh(),
        lambda: meshio_mesh(("vertex", np.arange(len(V))[:, None])),
        lambda: V,
        lambda: V.tolist(),
        lambda: torch.tensor(V),
        lambda: np.asfortranarray(V, ">f8"),
    ],
)
def test_objects_that_are_clouds(thing):
    np.testing.assert_array_equal(as_geometry(thing()).points, V)


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: pyvista.PolyData(V, lines=[2, 0, 1]), "points"),
        (lambda: meshio_mesh(("line", [[0, 1], [1, 2]])), "points"),
        (lambda: trimesh.load_path(V[:5]), "vertices"),
    ],
)
def test_curves_are_no_surface_and_their_points_a_cloud(make, name):
    thing = make()
    with pytest.raises(InvalidInputError, match=f"its {name}, an array, make a cloud"):
        as_geometry(thing)
    assert as_geometry(getattr(thing, name)).n == len(getattr(thing, name))


def test_points_with_normals_say_which_columns_to_keep():
    with pytest.raises(InvalidInputError, match=r"points\[:, :3\] leaves them out") as caught:
        as_geometry(np.hstack([V, V]))
    points = follow(caught.value, r"coordinates, (.*) leaves", points=np.hstack([V, V]))
    np.testing.assert_array_equal(as_geometry(points).points, V)
