"""Files cut short, torn or damaged: each is refused by name, with what is wrong and where."""

import zipfile

import numpy as np
import pytest

from spectra_kit.errors import InvalidFileError, InvalidInputError
from spectra_kit.geometry import PointCloud, TriangleMesh, read, sphere, write

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
CORNERS = "vertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
FACET = f"facet normal 0 0 1\nouter loop\n{CORNERS}endloop\nendfacet"
# A triangle, or three points, in each format of text.
GOOD = {
    "obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    "off": "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
    "ply": "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
    "stl": f"solid a\n{FACET}\nendsolid a\n",
    "xyz": "0 0 0\n1 0 0\n0 1 0\n",
}
EVERYTHING = object()
LISTS = "property list uchar int vertex_indices"


@pytest.mark.parametrize("kind", GOOD)
def test_what_is_damaged_below_can_be_read(tmp_path, kind):
    (tmp_path / f"a.{kind}").write_text(GOOD[kind])
    assert read(tmp_path / f"a.{kind}").points.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]


@pytest.mark.parametrize(
    ("kind", "old", "new", "problem"),
    [
        ("obj", "f 1 2 3\n", "vt 0 0\n", "holds 3 vertices and texture, but no face line; .*kind="),
        ("obj", "v 0 0 0\n", "v 0 0\n", "line 1 is broken: 'v 0 0'"),
        ("obj", "v 0 0 0\n", "v 0 0 nan\n", r"finite, got 1 .* first at \(0, 2\)"),
        ("obj", "v 0 0 0\n", "v 1_0 0 0\n", "line 1 .*'1_0' is no number"),
        ("obj", "v 0 0 0\n", "v \uff11 0 0\n", "line 1 is broken: .* is no number"),
        ("obj", "v 0 0 0\n", "v 0 0.1 23 0.5\n", "weight .* must be 1, not 0.5"),
        ("obj", "v 0 0 0\n", "v 0 0 0 1 1\n", "perhaps 4, 6 or 7, not 5"),
        ("obj", "f 1 2 3", "f 1 2 4", r"`faces` must be in \[0, 3\), got 3"),
        ("obj", "f 1 2 3", "f 1 2 0", "vertices count from 1, and 0 is none"),
        ("obj", "f 1 2 3", "f 1 2 3\nf 385714285", r"`faces` must be in \[0, 3\), got 385714284"),
        ("obj", GOOD["obj"], "v 0.14 -1", "line 1 is broken: 'v 0.14 -1'.* may be cut short"),
        ("obj", "f 1 2 3", "f 1 2", "a face must have at least 3 corners, got one with 2"),
        ("obj", "f 1 2 3", f"f 1 2 {10**20}", "line 4 is broken: .* more than 64 bits"),
        ("obj", "f 1 2 3", "f 1 2 1_0", "line 4 is broken: .*'1_0' is no integer"),
        ("obj", "f 1 2 3", "f 1 2 3\nb 1 2 3", "line 5 .*must begin with a keyword of OBJ"),
        ("obj", "f 1 2 3", "f 1 2 3\nf01 2 3", "line 5 .*must begin with a keyword of OBJ"),
        ("obj", "f 1 2 3", "f 1 2 3\nt 1 2 3", "line 5 .*must begin with a keyword of OBJ"),
        ("obj", "f 1 2 3\n", "f 1 2 3\nf 1 2 \\", "ends in a backslash"),
        ("off", "OFF", "ply", "must start with the keyword OFF, got 'ply'"),
        ("off", EVERYTHING, "# a comment\n", "must start with the keyword OFF, got ''"),
        ("off", EVERYTHING, "OFF\n", "must announce its numbers of vertices and faces"),
        ("off", "3 1 0", "BINARY", "must announce its numbers of vertices and faces"),
        ("off", "3 1 0", "3 1_0 0", "must announce its numbers of vertices and faces"),
        ("off", "3 1 0", "4 1 0", "announces 4 vertices and 1 face, followed by 4 lines;"),
        ("off", "3 1 0", "2 1 0", "announces 2 vertices and 1 face, followed by 4 lines;"),
        ("off", "3 1 0", "6 -2 0", "announces 6 vertices and -2 faces"),
        ("off", "3 0 1 2", "3 0 1", "line 6 is broken: '3 0 1'"),
        ("off", "3 0 1 2", "3 0 1 3", r"must be in \[0, 3\), got 3"),
        ("off", "3 0 1 2", f"3 0 1 {10**20}", "more than 64 bits"),
        ("off", "3 0 1 2", "3 0 1 2 9 9", "or 1 in all, got 2"),
        ("off", "1 0 0", "1 0 inf", "must be finite"),
        ("off", "1 0 0", "1 0 0 0", "4 columns where .* be 3"),
        ("xyz", EVERYTHING, "# nothing\n", "must have shape"),
        ("xyz", EVERYTHING, "1 2\n3 4\n", "line 1 is broken: '1 2' .*; expected 3 numbers"),
        ("xyz", "0 0 0", "0 0 0 0", "line 2 is broken: '1 0 0' .*; expected 4 numbers"),
        ("xyz", "0 0 0", "H 0 0", "line 1 is broken"),
        ("xyz", EVERYTHING, "1,5 2,5 3,5\n", "line 1 is broken: .* with decimal points"),
        ("xyz", "1 0 0", "1,5 2 3", "line 2 is broken: .*float: '1,5'"),
        ("xyz", EVERYTHING, "1 2 3 a,b\n4 5 6 a,b\n", "line 1 is broken: .*2 columns where"),
        ("xyz", EVERYTHING, "1,2,3\n1_0,2,3\n", "line 2 is broken: .*'1_0' is no number"),
        ("stl", FACET, "", "holds no triangle"),
        ("stl", EVERYTHING, "not an stl", "the file may be cut short or no STL"),
        ("stl", "endsolid a", "", "no last line `endsolid`, and its surface has a boundary"),
        ("stl", "endsolid a", "endsolid a\n" + FACET, "between a line `solid` and"),
        ("stl", "0 0 0\n", "0 x 0\n", "must hold three numbers"),
        ("stl", "0 0 0\n", "1_0 0 0\n", "must hold three numbers"),
        ("stl", "0 0 0\n", "0 0\n", "facet 0, counted from 0, must be 'facet normal"),
        ("stl", "0 0 0\n", "0 0 0 0\n", "facet 0, .* cut short"),
        # Six vertices of two numbers are as many numbers as four of three.
        ("stl", FACET, (2 * (FACET + "\n")).replace(" 0\nv", "\nv"), "facet 0, counted from 0"),
        ("ply", "ply\n", "", "must begin with a PLY header"),
        ("ply", "format ascii 1.0\n", "", "the format must be one of ascii, binary"),
        ("ply", "vertex 3", "vertex many", "header line 'element vertex many'"),
        ("ply", "vertex 3", "vertex -1", "cannot hold -1 rows of 'vertex'"),
        ("ply", "vertex 3", "edge 3", "no vertices with x, y and z"),
        ("ply", "float x", "quad x", "header line 'property quad x'"),
        ("ply", "float x", "float x w", "header line 'property float x w'"),
        ("ply", "float x", "list uchar float x", "'x' must be a number, got a list"),
        ("ply", " y\n", " x\n", "name each thing once, got x, x, z"),
        ("ply", " z\n", " w\n", "no vertices with x, y and z"),
        ("ply", f"face 1\n{LISTS}", "vertex 1", "name each thing once, got vertex, vertex"),
        ("ply", "element face", "element strips", "stores vertex_indices of 'strips'"),
        ("ply", LISTS, "propertx float w", "header line 'propertx float w'"),
        ("ply", LISTS, "", "faces must have vertex_indices, got nothing|more than its header"),
        ("ply", LISTS, LISTS.replace("uchar", "float"), "header line 'property list float"),
        ("ply", LISTS, "property int vertex_indices", "must be a list, got a number"),
        ("ply", "vertex_indices", "corner", "faces must have vertex_indices, got corner"),
        ("ply", "3 0 1 2", "-1", "'vertex_indices' cannot have -1"),
        ("ply", "3 0 1 2", "inf 0 1 2", "cannot have inf entries"),
        ("ply", "3 0 1 2", "3.5 0 1 2", "cannot have 3.5 entries"),
        ("ply", "3 0 1 2", "3 0 1 1.5", "must hold whole numbers"),
        ("ply", "3 0 1 2", "3 0 1 1e300", "must hold whole numbers"),
        ("ply", "3 0 1 2", "3 0 1 2 7", "more than its header announces"),
        ("ply", "3 0 1 2", "", "ends before the 1 rows of 'face'"),
        ("ply", "3 0 1 2", "x", "must hold numbers only"),
        ("ply", "1 0 0", "1_0 0 0", "must hold numbers only"),
        ("ply", "0 0 0\n1 0 0", "0 0\n0 1 0 0", "a row must end where its line ends"),
        ("gltf", EVERYTHING, "{}", "holds neither a mesh nor a point set"),
        ("gltf", EVERYTHING, "[]", "not a whole glTF file"),
        ("glb", EVERYTHING, "not a glb", "not a whole glTF file"),
        ("npy", EVERYTHING, "not a npy", r"not a whole npy file .*it begins with b'not a ', not"),
        ("npz", EVERYTHING, "not a npz", r"not a whole npz file .*it begins with b'no', not with"),
    ],
)
def test_damage_is_named(tmp_path, kind, old, new, problem):
    path = tmp_path / f"a.{kind}"
    text = new if old is EVERYTHING else GOOD[kind].replace(old, new, 1)
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InvalidFileError, match=problem) as caught:
        read(path)
    assert caught.value.path == path
    assert str(caught.value) == f"{path}: {caught.value.problem}"


def test_what_a_path_must_be(tmp_path):
    (tmp_path / "folder.ply").mkdir()
    (tmp_path / "empty.ply").touch()
    write(PointCloud(SQUARE), tmp_path / "cloud.ply")
    for name, problem in {
        "folder.ply": "this is a folder",
        "missing.ply": "there is no such file",
        "empty.ply": "the file is empty",
        "mesh.step": r"cannot read the format '.step'; .*; known are .asc, .csv, .gii, .glb",
        "mesh": "cannot read the format ''",
        "cloud.ply": "points without faces, expected a mesh",
    }.items():
        with pytest.raises(InvalidFileError, match=problem):
            read(tmp_path / name, kind="mesh")
    mesh = TriangleMesh(SQUARE, [[0, 1, 2]])
    for thing, name, problem in [
        ([mesh], "mesh.ply", "must be a TriangleMesh or PointCloud, got a list"),
        (mesh, "mesh.xyz", r"cannot write a TriangleMesh to .* '\.xyz'"),
        (mesh.as_cloud(), "cloud.stl", r"cannot write a PointCloud to .* '\.stl'"),
        (mesh, "nowhere/mesh.ply", r"the folder .* does not exist"),
        (mesh, "folder.ply", "must name a file, got the folder"),
    ]:
        with pytest.raises(InvalidInputError, match=problem):
            write(thing, tmp_path / name)
    with pytest.raises(InvalidInputError, match="`kind` must be 'mesh', 'cloud' or None"):
        read(tmp_path / "empty.ply", kind="volume")


# --- arrays and archives --------------------------------------------------------------------------


def with_byte(path, old, new):
    """Replace the first `old` of a file by `new`, of the same length."""
    data = path.read_bytes()
    assert old in data
    path.write_bytes(data.replace(old, new, 1))


def test_arrays_without_points_are_refused(tmp_path):
    path = tmp_path / "a.npz"
    for arrays, problem in [
        ({"corners": SQUARE}, r"must hold one array of points.*, got corners"),
        ({"points": SQUARE, "V": SQUARE}, "must hold one array of points"),
        ({"points": np.array([{}])}, r"not a whole npz .* \(it holds Python objects\)$"),
    ]:
        np.savez(path, **arrays)
        with pytest.raises(InvalidFileError, match=problem):
            read(path)
    np.save(tmp_path / "a.npy", SQUARE)
    (tmp_path / "a.npy").rename(path)
    with pytest.raises(InvalidFileError, match=r"npz .*it begins with .*, not with b'PK'"):
        read(path)


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data.replace(b"vertex 42", b"vertex 43"),  # what is left is 80 rows as well
        lambda data: data[: -7 * 13] + bytes(7),  # zeros where the last seven were
        lambda data: data[: -9 * 13] + bytes(2) + data[-7 * 13 :],
    ],
)
def test_binary_faces_without_corners_are_damage(tmp_path, change):
    path = tmp_path / "a.ply"
    write(sphere(subdivisions=1).geometry, path)
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(InvalidFileError, match=r"holds \d faces without corners, the first"):
        read(path)


@pytest.mark.parametrize(
    ("old", "new"),
    [(b"(1280, 3)", b"(1080, 3)"), (b"'<f8'", b"'<i4'"), (b"(642, 3)", b"(242, 3)")],
)
def test_header_of_an_array_that_announces_less_than_is_stored(tmp_path, old, new):
    """The checksum of a member is compared once all of it is read."""
    path, mesh = tmp_path / "a.npz", sphere(subdivisions=3).geometry
    np.savez(path, points=mesh.points, faces=mesh.faces)
    with_byte(path, old, new)
    with pytest.raises(InvalidFileError, match=r"not a whole npz file .*(CRC-32|announces shape)"):
        read(path)


@pytest.mark.parametrize("shape", [b"(3, 3)", b"(5, 3)", b"(99999999999999999, 3)"])
def test_npy_that_announces_less_or_more_than_it_holds(tmp_path, shape):
    path = tmp_path / "a.npy"
    np.save(path, SQUARE)
    with_byte(path, b"(4, 3), }" + b" " * (len(shape) - 6), shape + b", }")
    with pytest.raises(InvalidFileError, match=r"its header announces shape \(.* 96 bytes"):
        read(path)


def archive_of(path, points, method):
    with zipfile.ZipFile(path, "w", method) as archive, archive.open("points.npy", "w") as file:
        np.save(file, points)


@pytest.mark.parametrize(
    ("method", "place", "problem"),
    [(zipfile.ZIP_STORED, 6, "encrypted"), (zipfile.ZIP_DEFLATED, 60, "not a whole npz")],
)
def test_archives_that_cannot_be_unpacked(tmp_path, method, place, problem):
    path = tmp_path / "a.npz"
    archive_of(path, np.random.default_rng(0).normal(size=(50, 3)), method)
    assert read(path).n == 50
    data = bytearray(path.read_bytes())
    data[place] ^= 1
    if method == zipfile.ZIP_STORED:  # the bit is in the table at the end too
        data[data.index(b"PK\1\2") + 8] = 1
    path.write_bytes(data)
    with pytest.raises(InvalidFileError, match=problem):
        read(path)


@pytest.mark.parametrize("method", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_archives_that_are_packed_as_numpy_packs_none(tmp_path, method):
    path = tmp_path / "a.npz"
    archive_of(path, SQUARE, method)
    with pytest.raises(InvalidFileError, match=r"packed otherwise .* numpy\.savez\(path, "):
        read(path)
    np.savez(path, **np.load(path))
    np.testing.assert_array_equal(read(path).points, SQUARE)


def test_array_whose_name_is_damaged_is_not_left_out(tmp_path):
    write(sphere(subdivisions=1).geometry, tmp_path / "a.npz")
    data = (tmp_path / "a.npz").read_bytes()
    at = data.rindex(b"faces.npy")
    (tmp_path / "a.npz").write_bytes(data[:at] + b"g" + data[at + 1 :])
    with pytest.raises(InvalidFileError, match=r"File name in directory 'gaces.npy'"):
        read(tmp_path / "a.npz")
