"""Files as other programs write them: read as the sphere that they hold, or refused with a way on.

All hold one triangulated unit sphere, whose counts, volume and lowest modes are known.
"""

import bz2
import gzip
import json
import lzma
import re
import tracemalloc
import zipfile
from functools import partial

import numpy as np
import pytest
import pyvista
from others import BALL, RATE, VOLUME, F, Gltf, V, follow, is_ball, plain, polydata

from spectra_kit import as_geometry
from spectra_kit.datasets import find_inputs
from spectra_kit.errors import InvalidFileError
from spectra_kit.geometry import read, write
from spectra_kit.geometry.formats import _room
from spectra_kit.geometry.io import MESH_WRITERS


def test_the_sphere_is_one():
    assert abs(RATE / 2 - 1) < 0.05  # l (l + 1) of l = 1
    assert abs(VOLUME / (4 / 3 * np.pi) - 1) < 0.15


# --- packed files ---------------------------------------------------------------------------------

PACK = {".gz": gzip.compress, ".bz2": bz2.compress, ".xz": partial(lzma.compress, preset=0)}


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
        ({"V": V, "F": F.astype(str)}, "integers", lambda d: (d["V"], d["F"].astype(int))),
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


def instances(path, k=400):
    nodes = ({"mesh": 0, "translation": [3 * i, 0, 0]} for i in range(k))
    path.write_bytes(plain().show(*nodes).glb())


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


def write_array(file, announced, data):
    head = {"descr": "<f8", "fortran_order": False, "shape": announced}
    np.lib.format.write_array_header_1_0(file, head)
    file.write(data)


def npy_of(path, announced):
    with path.open("wb") as file:
        write_array(file, announced, V.tobytes())


def npz_of(path, announced, held, method=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", method) as archive, archive.open("points.npy", "w") as file:
        write_array(file, announced, bytes(held))


def zeros(pack):
    return lambda path: path.write_bytes(pack(bytes(4 << 20)))


@pytest.mark.parametrize(
    ("name", "make", "problem"),
    [
        ("a.glb", instances, "shows more than"),
        ("a.glb", lambda path: one_accessor(path, count=10**8), "shows more than"),
        ("a.glb", zeros_but_one, "shows more than"),
        ("a.gltf", many_views_of_one_file, "shows more than"),
        ("a.npz", lambda path: npz_of(path, (10, 3), 4 << 20), "unpack to more than"),
        ("a.npz", lambda path: npz_of(path, (1 << 16, 8), 4 << 20), "unpack to more than"),
        ("a.npz", lambda path: npz_of(path, (1 << 40, 3), 1 << 20), "header announces shape"),
        ("a.npz", lambda path: npz_of(path, (10, 3), 4 << 20, zipfile.ZIP_BZIP2), "more than"),
        ("a.npy", lambda path: npy_of(path, (1 << 40, 3)), "header announces shape"),
        *[(f"a.ply{packing}", zeros(pack), "unpacks to more") for packing, pack in PACK.items()],
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


@pytest.mark.usefixtures("little_room")
def test_ways_on_where_a_file_is_right_to_unfold_so_far(tmp_path):
    instances(tmp_path / "a.glb")
    with pytest.raises(InvalidFileError) as caught:
        read(tmp_path / "a.glb")
    mesh = as_geometry(follow(caught.value, r"hand over (.*)$", path=tmp_path / "a.glb"))
    np.testing.assert_allclose(mesh.area, 400 * BALL.area, rtol=1e-5)
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


# --- formats of others ----------------------------------------------------------------------------


FOREIGN = [
    ("a.vtm", lambda path: pyvista.MultiBlock([polydata()]).save(path)),
]


@pytest.mark.filterwarnings("ignore:The default value of `algorithm`", "ignore::UserWarning")
@pytest.mark.parametrize(("name", "make"), FOREIGN)
def test_unknown_formats_say_who_reads_them(tmp_path, name, make):
    path = tmp_path / name
    make(path)
    with pytest.raises(InvalidFileError, match="cannot read the format") as caught:
        read(path)
    is_ball(follow(caught.value, r"; hand over (.*), or convert it", path=path))
    converting = r"convert it once: (spectra_kit.write\(.*\)); known are"
    text = re.sub(r"'\w+\.ply'", "out", str(caught.value))
    follow(text, converting, path=path, out=tmp_path / "out.ply")
    is_ball(tmp_path / "out.ply")


def test_files_of_matlab_say_how(tmp_path):
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
        ("a.nii.gz", r"if of labels, geometry\.from_labels\(image\)"),
        ("lh.annot", r"geometry\.read_overlay\(path\)"),
        ("a.zip", "unpack it first"),
        ("a.vts.gz", r"unpack it, then hand over pyvista\.read\(path\)"),
        ("{a}.vts.gz", r"convert it once: .*'\{a\}.ply'\), of \{a\}.vts"),
        ("a.unheard", "hand over meshio"),
        ("none", "hand over meshio"),
    ],
)
def test_other_formats_name_a_way_on(tmp_path, name, way_on):
    with pytest.raises(InvalidFileError, match=way_on):
        read(tmp_path / name)
