"""Files: the order of vertices survives, numbers survive, and half a file is never half read."""

import base64
import json
import os
import re
import resource
import subprocess
import sys
import zipfile
from collections import Counter

import numpy as np
import pytest
import trimesh

from spectra_kit._files import atomic_path
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import PointCloud, TriangleMesh, read, sphere, write

EXACT = [".obj", ".off", ".ply", ".npz"]
SINGLE = [".glb", ".gltf"]
CLOUD = [".ply", ".xyz", ".npy", ".npz"]


@pytest.fixture(scope="module")
def mesh():
    """A sphere with shuffled vertices, two of them unused, and coordinates no decimal ends."""
    ball = sphere(subdivisions=1).geometry
    rng = np.random.default_rng(0)
    points = np.vstack([ball.points * np.sqrt(3) + 1 / 7, rng.normal(size=(2, 3))])
    new_place = rng.permutation(len(points))
    shuffled = np.empty_like(points)
    shuffled[new_place] = points
    return TriangleMesh(shuffled, new_place[ball.faces])


def assert_same(left, right):
    np.testing.assert_array_equal(left.points, right.points)
    np.testing.assert_array_equal(left.faces, right.faces)


# --- what is written comes back -----------------------------------------------------------------


@pytest.mark.parametrize("suffix", [*EXACT, ".OBJ", ".NPZ"])
def test_mesh_round_trip_is_exact(mesh, tmp_path, suffix):
    write(mesh, tmp_path / f"mesh{suffix}")
    assert_same(read(tmp_path / f"mesh{suffix}"), mesh)


@pytest.mark.parametrize("suffix", [*SINGLE, ".GLB"])
def test_gltf_round_trip_is_exact_in_single_precision(mesh, tmp_path, suffix):
    write(mesh, tmp_path / f"mesh{suffix}")
    assert_same(read(tmp_path / f"mesh{suffix}"), mesh.with_points(mesh.points.astype(np.float32)))


def test_stl_round_trip_keeps_triangles_and_joins_corners(mesh, tmp_path):
    write(mesh, tmp_path / "mesh.stl")
    copy = read(tmp_path / "mesh.stl")
    assert copy.n == len(mesh.referenced_vertices)
    np.testing.assert_array_equal(
        copy.points[copy.faces], mesh.points[mesh.faces].astype(np.float32)
    )


@pytest.mark.parametrize("suffix", CLOUD)
def test_cloud_round_trip_is_exact(mesh, tmp_path, suffix):
    write(mesh.as_cloud(), tmp_path / f"cloud{suffix}")
    copy = read(tmp_path / f"cloud{suffix}")
    assert isinstance(copy, PointCloud)
    np.testing.assert_array_equal(copy.points, mesh.points)


@pytest.mark.parametrize("suffix", EXACT)
@pytest.mark.parametrize("scale", [1e-300, 1e-3, 1e6, 1e300])
def test_any_size_survives(mesh, tmp_path, suffix, scale):
    scaled = mesh.with_points(mesh.points * scale)
    write(scaled, tmp_path / f"mesh{suffix}")
    assert_same(read(tmp_path / f"mesh{suffix}"), scaled)


# --- agreement with trimesh, both ways ----------------------------------------------------------


@pytest.mark.parametrize("suffix", [".obj", ".off", ".ply", ".glb"])
def test_trimesh_reads_what_we_write(mesh, tmp_path, suffix):
    write(mesh, tmp_path / f"mesh{suffix}")
    other = trimesh.load_scene(
        tmp_path / f"mesh{suffix}", process=False, maintain_order=True
    ).to_mesh()
    np.testing.assert_allclose(other.vertices, mesh.points, rtol=1e-6)
    np.testing.assert_array_equal(other.faces, mesh.faces)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("mesh.obj", {"digits": 17}),
        ("mesh.off", {"digits": 17}),
        ("mesh.ply", {}),
        ("mesh.ply", {"encoding": "ascii"}),
        ("mesh.glb", {}),
    ],
)
def test_we_read_what_trimesh_writes(mesh, tmp_path, name, options):
    other = trimesh.Trimesh(mesh.points, mesh.faces, process=False)
    other.export(tmp_path / name, **options)
    copy = read(tmp_path / name)
    np.testing.assert_allclose(copy.points, mesh.points, rtol=1e-6)
    np.testing.assert_array_equal(copy.faces, mesh.faces)


@pytest.mark.parametrize("kind", ["stl", "stl_ascii"])
def test_we_read_the_triangles_of_trimesh_stl(mesh, tmp_path, kind):
    other = trimesh.Trimesh(mesh.points, mesh.faces, process=False)
    other.export(tmp_path / "mesh.stl", file_type=kind)
    copy = read(tmp_path / "mesh.stl")
    assert copy.n == len(mesh.referenced_vertices)
    np.testing.assert_allclose(copy.points[copy.faces], mesh.points[mesh.faces], rtol=1e-6)


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


# --- what other programs write ------------------------------------------------------------------

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
FAN = [[0, 1, 2], [0, 2, 3]]


def test_obj_with_texture_normals_groups_and_relative_indices(tmp_path):
    text = """# comment
mtllib none.mtl
o first
v 0 0 0 0.5 0.5 0.5
v 1 0 0
v 1 1 0
vt 0 0
vt 1 0
vt 0 1
vn 0 0 1
usemtl red
f 1/1/1 2/2/1 3/3/1 # seam
o second
v 0 1 0
v 9 9 9
usemtl blue
f 1//1 3//1 -2//1
s off
"""
    (tmp_path / "square.obj").write_text(text)
    mesh = read(tmp_path / "square.obj")
    np.testing.assert_array_equal(mesh.points, [*SQUARE, [9, 9, 9]])
    np.testing.assert_array_equal(mesh.faces, FAN)


PENTAGON = "0 0 0\n2 0 0\n3 1 0\n1 3 0\n-1 1 0\n5 5 5\n"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        (
            "p.obj",
            "".join(f"v {row}\n" for row in PENTAGON.splitlines()) + "f 1 2 6\nf 1 2 3 4 5\n",
        ),
        ("p.off", f"OFF\n6 2 0\n{PENTAGON}3 0 1 5\n5 0 1 2 3 4\n"),
        ("p.off", f"COFF6 2 0 # glued\n\n{PENTAGON}3 0 1 5 255 0 0\n5 0 1 2 3 4\n"),
        (
            "p.ply",
            "ply\nformat ascii 1.0\ncomment by hand\nelement vertex 6\nproperty float x\n"
            "property float y\nproperty float z\nelement face 2\n"
            f"property list uchar int vertex_index\nend_header\n{PENTAGON}3 0 1 5\n5 0 1 2 3 4\n",
        ),
    ],
)
def test_polygons_become_fans(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    mesh = read(tmp_path / name)
    assert mesh.n == 6
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 5], [0, 1, 2], [0, 2, 3], [0, 3, 4]])


@pytest.mark.parametrize("order", ["little", "big"])
def test_binary_ply_with_mixed_polygons_and_other_properties(tmp_path, order):
    mark = {"little": "<", "big": ">"}[order]
    header = (
        f"ply\nformat binary_{order}_endian 1.0\nelement vertex 5\nproperty uchar red\n"
        "property double x\nproperty float y\nproperty short z\nelement face 2\n"
        "property list uchar uint vertex_indices\nproperty float quality\nelement edge 1\n"
        "property int a\nend_header\n"
    ).encode()
    vertices = np.zeros(
        5, dtype=[("r", "u1"), ("x", mark + "f8"), ("y", mark + "f4"), ("z", mark + "i2")]
    )
    vertices["x"], vertices["y"], vertices["z"] = [0, 1, 1, 0, 5], [0, 0, 1, 1, 5], [0, 0, 0, 0, 5]
    quad = b"\x04" + np.array([0, 1, 2, 3], mark + "u4").tobytes() + bytes(4)
    triangle = b"\x03" + np.array([0, 1, 4], mark + "u4").tobytes() + bytes(4)
    (tmp_path / "m.ply").write_bytes(header + vertices.tobytes() + quad + triangle + bytes(4))
    mesh = read(tmp_path / "m.ply")
    np.testing.assert_array_equal(mesh.points, [*SQUARE, [5, 5, 5]])
    np.testing.assert_array_equal(mesh.faces, [*FAN, [0, 1, 4]])


def test_xyz_columns_after_the_third_are_ignored(tmp_path):
    (tmp_path / "a.xyz").write_text("# x y z nx ny nz\n1, 2, 3, 0, 0, 1\n\n4,5,6,0,0,1")
    np.testing.assert_array_equal(read(tmp_path / "a.xyz").points, [[1, 2, 3], [4, 5, 6]])


def test_npz_with_short_names_and_small_types(tmp_path):
    np.savez_compressed(
        tmp_path / "a.npz", V=SQUARE.astype(np.float16), F=np.array(FAN, np.uint16), other=3
    )
    assert_same(read(tmp_path / "a.npz"), TriangleMesh(SQUARE, FAN))


def test_stl_joins_positive_and_negative_zero(tmp_path):
    facets = [[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], [[-0.0, 0, -0.0], [0, 1, 0], [-1, 0, 0]]]
    loose = TriangleMesh(np.reshape(facets, (-1, 3)), [[0, 1, 2], [3, 4, 5]])
    write(loose, tmp_path / "a.stl")
    mesh = read(tmp_path / "a.stl")
    assert mesh.n == 4
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [0, 2, 3]])


def test_kind_chooses_or_refuses(mesh, tmp_path):
    write(mesh, tmp_path / "mesh.ply")
    cloud = read(tmp_path / "mesh.ply", kind="cloud")
    assert isinstance(cloud, PointCloud)
    np.testing.assert_array_equal(cloud.points, mesh.points)
    assert isinstance(read(tmp_path / "mesh.ply", kind="mesh"), TriangleMesh)
    (tmp_path / "points.off").write_text("OFF\n1 0 0\n1 2 3\n")
    assert isinstance(read(tmp_path / "points.off"), PointCloud)


# --- files cut short ----------------------------------------------------------------------------


def files_to_cut(mesh, folder):
    for suffix in [*EXACT, *SINGLE, ".stl"]:
        write(mesh, folder / f"mesh{suffix}")
    for suffix in CLOUD:
        write(mesh.as_cloud(), folder / f"cloud{suffix}")
    other = trimesh.Trimesh(mesh.points, mesh.faces, process=False)
    other.export(folder / "ascii.ply", encoding="ascii")
    other.export(folder / "ascii.stl", file_type="stl_ascii")


@pytest.mark.parametrize(
    "name",
    [*(f"mesh{suffix}" for suffix in [*EXACT, *SINGLE, ".stl"]), *(f"cloud{s}" for s in CLOUD)]
    + ["ascii.ply", "ascii.stl"],
)
def test_cut_files_are_refused(mesh, tmp_path, name):
    files_to_cut(mesh, tmp_path)
    path = tmp_path / name
    whole = path.read_bytes()
    announces_length = path.suffix not in (".obj", ".xyz")
    # The last number of a text may lose digits unnoticed; up to there every cut shows.
    for size in np.linspace(1, len(whole) - 5, 40).astype(int):
        path.write_bytes(whole[:size])
        if announces_length or not whole[:size].strip():
            with pytest.raises(InvalidInputError, match=f"{name}: "):
                read(path)
            continue
        try:  # OBJ and XYZ cannot know their length, but must never break differently
            read(path)
        except InvalidInputError as error:
            assert str(path) in str(error)  # noqa: PT017


def test_obj_cut_inside_a_line_is_refused(mesh, tmp_path):
    write(mesh, tmp_path / "mesh.obj")
    text = (tmp_path / "mesh.obj").read_text()
    (tmp_path / "mesh.obj").write_text(text[: text.rindex(" ")])
    with pytest.raises(InvalidInputError, match="at least 3 corners, got one with 2"):
        read(tmp_path / "mesh.obj")


def test_damaged_bytes_never_raise_anything_else(mesh, tmp_path):
    files_to_cut(mesh, tmp_path)
    rng = np.random.default_rng(0)
    for path in sorted(tmp_path.iterdir()):
        whole = path.read_bytes()
        for _ in range(30):
            damaged = np.frombuffer(whole, np.uint8).copy()
            damaged[rng.integers(min(len(whole), 400), size=3)] = rng.integers(256, size=3)
            path.write_bytes(damaged.tobytes())
            try:
                assert read(path).n > 0
            except InvalidInputError as error:
                assert str(path) in str(error)  # noqa: PT017


# --- interrupted writes -------------------------------------------------------------------------


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, OSError, ValueError])
def test_interrupted_write_keeps_the_old_file(tmp_path, interruption):
    path = tmp_path / "good.txt"
    path.write_text("good")
    with pytest.raises(interruption), atomic_path(path) as part:  # noqa: PT012
        part.write_text("half")
        raise interruption
    assert path.read_text() == "good"
    assert os.listdir(tmp_path) == ["good.txt"]


@pytest.mark.parametrize("suffix", EXACT)
def test_interrupted_mesh_writer_keeps_the_old_mesh(mesh, tmp_path, suffix):
    """The disk is full after one kilobyte: the operating system stops the writer half way."""
    path = tmp_path / f"mesh{suffix}"
    write(mesh, path)
    old_limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1024, old_limit[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            write(mesh.with_points(2 * mesh.points), path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old_limit)
    assert_same(read(path), mesh)
    assert os.listdir(tmp_path) == [path.name]


def test_write_replaces_and_follows_links(mesh, tmp_path):
    write(PointCloud([[1, 2, 3]]), tmp_path / "real.ply")
    (tmp_path / "link.ply").symlink_to(tmp_path / "real.ply")
    write(mesh, tmp_path / "link.ply")
    assert (tmp_path / "link.ply").is_symlink()
    assert_same(read(tmp_path / "real.ply"), mesh)


# --- refusals -----------------------------------------------------------------------------------


def test_paths_that_are_no_file(mesh, tmp_path):
    (tmp_path / "folder.ply").mkdir()
    (tmp_path / "empty.ply").touch()
    for name, message in {
        "folder.ply": "this is a folder",
        "missing.ply": "there is no such file",
        "empty.ply": "the file is empty",
        "mesh.step": r"cannot read the format '.step'; known are .glb, .gltf, .npy, .npz, .obj",
        "mesh": "cannot read the format ''",
    }.items():
        with pytest.raises(InvalidInputError, match=message):
            read(tmp_path / name)
    with pytest.raises(InvalidInputError, match="must be a TriangleMesh or PointCloud, got a list"):
        write([mesh], tmp_path / "mesh.ply")
    with pytest.raises(InvalidInputError, match=r"cannot write a TriangleMesh to .* '\.xyz'"):
        write(mesh, tmp_path / "mesh.xyz")
    with pytest.raises(InvalidInputError, match=r"cannot write a PointCloud to .* '\.stl'"):
        write(mesh.as_cloud(), tmp_path / "cloud.stl")
    with pytest.raises(InvalidInputError, match=r"the folder .* does not exist"):
        write(mesh, tmp_path / "nowhere" / "mesh.ply")
    with pytest.raises(InvalidInputError, match="must name a file, got the folder"):
        write(mesh, tmp_path / "folder.ply")
    with pytest.raises(InvalidInputError, match="`kind` must be 'mesh', 'cloud' or None"):
        read(tmp_path / "empty.ply", kind="volume")


VERTEX = "element vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
FACE = "element face 1\nproperty list uchar int vertex_indices\n"
BODY = "end_header\n0 0 0\n1 0 0\n0 1 0\n"
PLY = "ply\nformat ascii 1.0\n"
FACET = "facet normal 0 0 1\nouter loop\nvertex {}\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", "3 vertices but no face line"),
        ("a.obj", "v 0 0\nf 1 1 1\n", "line 1 is broken: 'v 0 0'"),
        ("a.obj", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", r"finite, got 1 .* first at \(0, 2\)"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", r"`faces` must be in \[0, 3\), got 3"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 0\n", "vertices count from 1, and 0 is none"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nf 1 2\n", "a face must have at least 3 corners"),
        ("a.off", "ply\n", "must start with the keyword OFF, got 'ply'"),
        ("a.off", "# only a comment\n", "must start with the keyword OFF, got ''"),
        ("a.off", "OFF\nBINARY\n", "must announce its numbers of vertices and faces"),
        ("a.off", "OFF\n", "must announce its numbers of vertices and faces"),
        ("a.off", "OFF\n3 1 0\n0 0 0\n", "announces 3 vertices and 1 face, followed by 1 line;"),
        ("a.off", "OFF\n1 1 0\n0 0 0\n3 0 0\n", "line 4 is broken: '3 0 0'"),
        ("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n", r"must be in \[0, 3\), got 3"),
        ("a.off", "OFF\n3 1 0\n0 0 0\n1 0 inf\n0 1 0\n3 0 1 2\n", "must be finite"),
        ("a.xyz", "1 2\n3 4\n", "line 1 is broken: '1 2' .*; expected 3 numbers"),
        ("a.xyz", "1 2 3 4\n5 6 7\n", "line 2 is broken: '5 6 7' .*; expected 4 numbers"),
        ("a.xyz", "H 1 2 3\n", "line 1 is broken"),
        ("a.xyz", "# nothing\n", "must have shape"),
        ("a.stl", "solid a\nendsolid a\n", "holds no triangle"),
        ("a.stl", "solid a\n" + FACET.format("0 0 0"), "between a line `solid` and"),
        ("a.stl", "solid a\n" + FACET.format("0 x 0") + "endsolid", "must hold three numbers"),
        ("a.stl", "not an stl", "the file may be cut short or no STL"),
        ("a.npy", "not a npy", r"not a whole npy file .*it begins with b'not a ', not with"),
        ("a.npz", "not a npz", r"not a whole npz file .*it begins with b'no', not with b'PK'"),
        ("a.glb", "not a glb", "not a whole glTF file"),
        ("a.gltf", "{}", "holds neither a mesh nor a point set"),
        ("a.ply", "OFF\n", "must begin with a PLY header"),
        ("a.ply", "ply\n" + VERTEX + BODY, "the format must be one of ascii, binary"),
        ("a.ply", PLY + "element vertex many\n" + BODY, "header line 'element vertex many'"),
        ("a.ply", PLY + VERTEX.replace("3", "-1") + BODY, "cannot hold -1 rows of 'vertex'"),
        ("a.ply", PLY + VERTEX + FACE + BODY + "-1\n", "'vertex_indices' cannot have -1"),
        ("a.ply", PLY + VERTEX.replace("float", "quad") + BODY, "header line 'property quad x'"),
        ("a.ply", PLY + VERTEX.replace(" z", " w") + BODY, "no vertices with x, y and z"),
        ("a.ply", PLY + FACE + "end_header\n3 0 0 0\n", "no vertices with x, y and z"),
        ("a.ply", PLY + VERTEX + BODY + "7\n", "more than its header announces"),
        ("a.ply", PLY + VERTEX + FACE + BODY, "ends before the 1 rows of 'face'"),
        ("a.ply", PLY + VERTEX + BODY + "x\n", "must hold numbers only"),
        ("a.ply", PLY + VERTEX + FACE + BODY + "3 0 1 1.5\n", "must hold whole numbers"),
        (
            "a.ply",
            PLY + VERTEX + FACE.replace("vertex_indices", "corner") + BODY + "3 0 1 2\n",
            "faces must have vertex_indices, got corner",
        ),
        (
            "a.ply",
            PLY + VERTEX + FACE.replace("face", "tristrips") + BODY + "3 0 1 2\n",
            "stores vertex_indices of 'tristrips'",
        ),
    ],
)
def test_wrong_content_is_named(tmp_path, name, content, message):
    (tmp_path / name).write_text(content)
    with pytest.raises(InvalidInputError, match=message) as caught:
        read(tmp_path / name)
    assert str(caught.value).startswith(str(tmp_path / name))
    assert isinstance(caught.value.__cause__, InvalidInputError)


def test_arrays_without_points_are_refused(tmp_path):
    np.savez(tmp_path / "a.npz", corners=SQUARE)
    with pytest.raises(InvalidInputError, match=r"must hold one array of points.*, got corners"):
        read(tmp_path / "a.npz")
    np.savez(tmp_path / "a.npz", points=np.array([{}]))
    with pytest.raises(InvalidInputError, match=r"not a whole npz .* \(it holds Python objects\)$"):
        read(tmp_path / "a.npz")
    np.save(tmp_path / "a.npy", SQUARE)
    (tmp_path / "a.npy").rename(tmp_path / "a.npz")
    with pytest.raises(InvalidInputError, match=r"npz .*it begins with .*, not with b'PK'"):
        read(tmp_path / "a.npz")


def test_cloud_is_no_mesh(tmp_path):
    write(PointCloud(SQUARE), tmp_path / "a.ply")
    with pytest.raises(InvalidInputError, match="points without faces, expected a mesh"):
        read(tmp_path / "a.ply", kind="mesh")


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


# --- real models --------------------------------------------------------------------------------


@pytest.mark.data
def test_real_models_are_read_and_survive_every_format(real_shapes, tmp_path):
    models = sorted(real_shapes.glob("*.npz"))
    for path in models:
        with np.load(path) as archive:
            V, F = archive["V"], archive["F"]
        model = read(path, kind="mesh")
        np.testing.assert_array_equal(model.points, V)
        np.testing.assert_array_equal(model.faces, F)
    small = read(min(models, key=lambda path: path.stat().st_size))
    for suffix in EXACT:
        write(small, tmp_path / f"model{suffix}")
        assert_same(read(tmp_path / f"model{suffix}"), small)
    for suffix in [*SINGLE, ".stl"]:
        write(small, tmp_path / f"model{suffix}")
        copy = read(tmp_path / f"model{suffix}")
        assert copy.component_labels.max() == small.component_labels.max()
        np.testing.assert_allclose(copy.area, small.area, rtol=1e-6)


def test_ply_comment_that_names_the_end_of_the_header(tmp_path):
    path = tmp_path / "c.ply"
    path.write_text(
        "ply\nformat ascii 1.0\ncomment the end_header line follows\nelement vertex 1\n"
        "property float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n"
    )
    assert read(path).points.tolist() == [[1.0, 2.0, 3.0]]


def test_gltf_that_is_no_object(tmp_path):
    path = tmp_path / "list.gltf"
    path.write_text("[]")
    with pytest.raises(InvalidInputError, match="not a whole glTF file"):
        read(path)


def test_npz_names(tmp_path):
    points, faces = np.eye(3), np.array([[0, 1, 2]])
    for first, second in (("points", "F"), ("V", "faces"), ("vertices", "faces"), ("verts", "F")):
        np.savez(tmp_path / "a.npz", **{first: points, second: faces})
        assert read(tmp_path / "a.npz", kind="mesh").n == 3
    np.savez(tmp_path / "b.npz", points=points, V=2 * points)
    with pytest.raises(InvalidInputError, match="must hold one array of points"):
        read(tmp_path / "b.npz")


def test_obj_lines_may_go_on(tmp_path):
    path = tmp_path / "long.obj"
    path.write_text("v 0 0 \\\n0\nv 1 0 0\nv 0 1 0\nf 1 \\\n 2 3\n")
    mesh = read(path)
    assert mesh.points.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    assert mesh.faces.tolist() == [[0, 1, 2]]


# --- damage that a format can show ----------------------------------------------------------------


TRIANGLE_OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.obj", TRIANGLE_OBJ + f"f 1 2 {10**20}\n", "line 4 is broken: .* more than 64 bits"),
        ("a.obj", TRIANGLE_OBJ + "f 1 2 1_0\n", "line 4 is broken: .*'1_0' is no integer"),
        ("a.obj", "v 1_0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "line 1 .*'1_0' is no number"),
        ("a.obj", "v \uff11 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "line 1 is broken: .* is no number"),
        ("a.obj", "v 0 0.1 23 0.5\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "weight .* must be 1, not 0.5"),
        ("a.obj", "v 0 0 0 1 1\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "perhaps 4, 6 or 7, not 5"),
        ("a.obj", TRIANGLE_OBJ + "v 1 1 0\nf 1/2 3 4 1\n", "different numbers of slashes"),
        ("a.obj", TRIANGLE_OBJ + "f 1 2 3\nb 1 2 3\n", "line 5 must begin with a keyword of OBJ"),
        ("a.obj", TRIANGLE_OBJ + "f 1 2 3\nf 1 2 \\", "ends in a backslash"),
        ("a.off", "OFF\n5 -2 0\n0 0 0\n1 0 0\n0 1 0\n", "announces 5 vertices and -2 faces"),
        ("a.off", f"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 {10**20}\n", "more than 64 bits"),
        ("a.off", "OFF\n3 1_0 0\n", "must announce its numbers"),
        ("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0 0\n0 1 0\n3 0 1 2\n", "4 columns where .* be 3"),
        (
            "a.off",
            "OFF\n4 2 0\n0 0 0\n1 0 0\n0 1 0\n1 1 0\n3 0 1 2\n3 1 0 2 3\n",
            "or 1 in all, got 0 or 1",
        ),
        ("a.xyz", "1,5 2,5 3,5\n1,5 2,5 3,5\n", "line 1 is broken: .* with decimal points"),
        ("a.xyz", "1 2 3\n1,5 2 3\n", "line 2 is broken: .*float: '1,5'"),
        ("a.xyz", "1,2,3\n1_0,2,3\n", "line 2 is broken: .*'1_0' is no number"),
        ("a.stl", "solid a\n" + FACET.format("0 0") + "endsolid", "facet 0, counted from 0, must"),
        ("a.stl", "solid a\n" + FACET.format("0 0 0 0") + "endsolid", "facet 0, .* cut short"),
        ("a.stl", "solid a\n" + FACET.format("1_0 0 0") + "endsolid", "must hold three numbers"),
        ("a.stl", "solid a\n" + FACET.format("0 0 0") + "endsolid\n" + FACET, "between a line"),
        (
            "a.stl",  # six vertices of two numbers are as many numbers as four of three
            "solid a\n" + 2 * FACET.format("0 0").replace(" 0\n", "\n") + "endsolid",
            "facet 0, counted from 0, must be 'facet normal",
        ),
        ("a.ply", PLY + VERTEX + FACE + BODY + "inf 0 1 2\n", "cannot have inf entries"),
        ("a.ply", PLY + VERTEX + FACE + BODY + "nan 0 1 2\n", "cannot have nan entries"),
        ("a.ply", PLY + VERTEX + FACE + BODY + "3.5 0 1 2\n", "cannot have 3.5 entries"),
        ("a.ply", PLY + VERTEX + FACE + BODY + "3 0 1 1e300\n", "must hold whole numbers"),
        ("a.ply", PLY + VERTEX + BODY.replace("1", "1_0"), "must hold numbers only"),
        ("a.ply", PLY + VERTEX.replace(" y", " x") + BODY, "name each thing once, got x, x, z"),
        ("a.ply", PLY + VERTEX + VERTEX + BODY, "name each thing once, got vertex, vertex"),
        ("a.ply", PLY + VERTEX.replace(" x", " x y") + BODY, "header line 'property float x y'"),
        ("a.ply", PLY + VERTEX + "propertx float w\n" + BODY, "header line 'propertx float w'"),
        (
            "a.ply",
            PLY + VERTEX + FACE.replace("uchar", "float") + BODY,
            "line 'property list float",
        ),
        (
            "a.ply",
            PLY + VERTEX.replace("property float x", "property list uchar float x") + BODY,
            "'x' must be a number, got a list",
        ),
        (
            "a.ply",
            PLY + VERTEX + FACE.replace("list uchar int", "int") + BODY + "3\n",
            "'vertex_indices' must be a list, got a number",
        ),
        (
            "a.ply",
            PLY + VERTEX + "element face 1\n" + BODY,
            "vertex_indices, got nothing",
        ),
        (
            "a.ply",  # a corner torn in two: the rows still add up, with two faces of four
            PLY
            + VERTEX.replace("3", "15")
            + FACE.replace("1", "2")
            + BODY.replace("0 1 0", "0 1 0\n" + "1 1 1\n" * 12)[:-1]
            + "\n3 0 12 1\n4\n3 4 13 12\n",
            "a row must end where its line ends",
        ),
        (
            "a.ply",
            PLY + VERTEX + FACE.replace("face", "fbce") + BODY + "3 0 1 2\n",
            "stores vertex_indices of 'fbce'",
        ),
    ],
)
def test_damage_of_text_is_seen(tmp_path, name, content, message):
    (tmp_path / name).write_text(content, encoding="utf-8")
    with pytest.raises(InvalidInputError, match=message):
        read(tmp_path / name)


def test_rows_of_ply_may_share_a_line(tmp_path):
    (tmp_path / "a.ply").write_text(
        PLY + VERTEX + FACE + "end_header\n\n0 0 0 1 0 0 0 1 0\n3 0 1 2"
    )
    assert_same(
        read(tmp_path / "a.ply"), TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    )


def test_separators_that_no_editor_shows_do_not_end_a_comment(tmp_path):
    (tmp_path / "a.xyz").write_text("1 2 3 # from\u2028 4 5 6\n", encoding="utf-8")
    assert read(tmp_path / "a.xyz").points.tolist() == [[1, 2, 3]]


def with_byte(path, old, new):
    """Replace the first `old` of a file by `new`, of the same length."""
    data = path.read_bytes()
    assert old in data
    path.write_bytes(data.replace(old, new, 1))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"(1280, 3)", b"(1080, 3)"),
        (b"'<f8'", b"'<i4'"),
        (b"'<i8'", b"'<i4'"),
        (b"(642, 3)", b"(242, 3)"),
    ],
)
@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_header_of_an_array_that_announces_less_than_is_stored(tmp_path, save, old, new):
    """The checksum of a member is compared once all of it is read."""
    path, mesh = tmp_path / "a.npz", sphere(subdivisions=3).geometry
    write(mesh, path)
    if save is np.savez:
        with_byte(path, old, new)
    else:
        arrays = {"points": mesh.points, "faces": mesh.faces}
        save(path, **arrays)
        with zipfile.ZipFile(path) as archive:
            members = {name: archive.read(name).replace(old, new) for name in archive.namelist()}
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in members.items():
                archive.writestr(name, data)
    with pytest.raises(InvalidInputError, match=r"not a whole npz file .*(CRC-32|announces shape)"):
        read(path)


def test_npy_that_announces_less_or_more_than_it_holds(tmp_path):
    path = tmp_path / "a.npy"
    for shape in (b"(3, 3)", b"(5, 3)", b"(99999999999999999, 3)"):
        np.save(path, SQUARE)
        with_byte(path, b"(4, 3), }" + b" " * (len(shape) - 6), shape + b", }")
        with pytest.raises(InvalidInputError, match=r"its header announces shape \(.* 96 bytes"):
            read(path)


@pytest.mark.parametrize(
    ("method", "place", "message"),
    [
        ("ZIP_STORED", 6, "encrypted"),
        ("ZIP_LZMA", 60, "not a whole npz"),
        ("ZIP_BZIP2", 60, "not a whole npz"),
        ("ZIP_DEFLATED", 60, "not a whole npz"),
    ],
)
def test_archives_that_cannot_be_unpacked(tmp_path, method, place, message):
    path = tmp_path / "a.npz"
    np.save(tmp_path / "points.npy", np.random.default_rng(0).normal(size=(50, 3)))
    with zipfile.ZipFile(path, "w", getattr(zipfile, method)) as archive:
        archive.write(tmp_path / "points.npy", "points.npy")
    assert read(path).n == 50
    data = bytearray(path.read_bytes())
    data[place] ^= 1
    if method == "ZIP_STORED":  # the bit is in the table at the end too
        data[data.index(b"PK\1\2") + 8] = 1
    path.write_bytes(data)
    with pytest.raises(InvalidInputError, match=message):
        read(path)


def test_array_whose_name_is_damaged_is_not_left_out(mesh, tmp_path):
    write(mesh, tmp_path / "a.npz")
    data = (tmp_path / "a.npz").read_bytes()
    at = data.rindex(b"faces.npy")
    (tmp_path / "a.npz").write_bytes(data[:at] + b"g" + data[at + 1 :])
    with pytest.raises(InvalidInputError, match=r"File name in directory 'gaces.npy'"):
        read(tmp_path / "a.npz")


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
        (compress, "requires KHR_draco_mesh_compression, which is not read"),
        (compress_quietly, "must be a plain array, got a sparse or compressed one"),
        (
            set_in("extensionsRequired", value=["EXT_meshopt_compression"]),
            "EXT_meshopt_compression",
        ),
        (set_in("extensionsRequired", value=[3]), "not a whole glTF file"),
        (set_in("asset", "version", value="1.0"), "the version must be 2, got '1.0'"),
        (set_in("accessors", 0, "count", value=-3), "must be whole numbers from 0, got -3"),
        (set_in("accessors", 0, "count", value=60), "numbers that fill their view"),
        (set_in("accessors", 0, "count", value=0), "must describe SCALAR numbers"),
        (set_in("accessors", 0, "count", value=10**30), "up to byte 4"),
        (set_in("accessors", 1, "count", value=43), "must describe VEC3 numbers that fill"),
        (set_in("accessors", 0, "byteOffset", value=10**30), "must describe SCALAR numbers"),
        (set_in("accessors", 0, "byteOffset", value=-4), "must be whole numbers from 0, got -4"),
        (set_in("accessors", 1, "type", value="VEC2"), "must describe VEC3 numbers"),
        (set_in("accessors", 1, "sparse", value={"count": 1}), "got a sparse or compressed one"),
        (set_in("bufferViews", 1, "byteStride", value=1), "must describe VEC3 numbers"),
        (
            set_in("bufferViews", 1, "byteStride", value=-12),
            "must be whole numbers from 0, got -12",
        ),
        (set_in("bufferViews", 1, "byteStride", value=10**30), "must describe VEC3 numbers"),
        (set_in("bufferViews", 1, "byteLength", value=10**30), "must describe VEC3 numbers"),
        (set_in("bufferViews", 0, "buffer", value=-1), "must be whole numbers from 0, got -1"),
        (set_in("buffers", 0, "byteLength", value=10**9), "must have 1000000000 bytes, got"),
        (set_in("scene", value=7), "there is no 7 among 1"),
        (set_in("nodes", 0, "children", value=[0]), "node 0 stands in the scene twice"),
        (set_in("nodes", 0, "matrix", value=[1.0] * 16), "the last row of a matrix must be"),
        (set_in("nodes", 0, "rotation", value=[0, 0, 0, 0]), "not a whole glTF file"),
        (set_in("nodes", 0, "scale", value=[1, 2]), "not a whole glTF file"),
        (set_in("nodes", 0, "mesl", value=0), "'mesl' is no property of glTF here"),
        (set_in("accessors", 0, "byteOffsft", value=0), "'byteOffsft' is no property"),
        (set_in("bufferViews", 0, "byteStridf", value=4), "'byteStridf' is no property"),
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
    assert_same(read(tmp_path / "a.glb"), single)
    glb_with(mesh, tmp_path / "b.glb", set_in("extensionsRequired", value=["KHR_texture_basisu"]))
    assert_same(read(tmp_path / "b.glb"), single)
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
    tree = {
        "buffers": [
            {
                "byteLength": len(data),
                "uri": "data:application/octet-stream;base64," + base64.b64encode(data).decode(),
            }
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": 16, "byteStride": 4},
            {"buffer": 0, "byteOffset": 16, "byteLength": 2 * len(corners)},
        ],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5120,
                "normalized": True,
                "count": 4,
                "type": "VEC3",
            },
            {"bufferView": 1, "componentType": 5123, "count": len(corners), "type": "SCALAR"},
        ],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "mode": mode}]},
        ],
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


def ascii_stl(count, path):
    """Write noise as text, a facet a line; return the corners."""
    corners = np.random.default_rng(0).normal(size=(count, 9))
    facet = "facet normal 0 0 0\nouter loop" + 3 * "\nvertex %r %r %r" + "\nendloop\nendfacet"
    text = "\n".join(facet % tuple(row) for row in corners.tolist())
    path.write_text(f"SOLID of noise\n{text}\n  EndSolid of noise\n")
    return corners


def test_reading_text_of_stl_takes_work_in_proportion_to_it(tmp_path):
    """The calls that the interpreter makes are counted, not timed."""
    calls = {}
    for count in (100, 400):
        corners = ascii_stl(count, tmp_path / "a.stl")
        read(tmp_path / "a.stl")  # imports and compiles
        profile = Counter()
        sys.setprofile(lambda _frame, event, _, seen=profile: seen.update([event]))
        try:
            mesh = read(tmp_path / "a.stl")
        finally:
            sys.setprofile(None)
        np.testing.assert_array_equal(mesh.points[mesh.faces].reshape(-1, 9), corners)
        calls[count] = profile.total()
    assert calls[400] < 5 * calls[100]


def test_want_of_memory_names_the_file(tmp_path):
    script = (
        "import resource, sys\n"
        "import spectra_kit.geometry as g, spectra_kit.errors as e\n"
        "resource.setrlimit(resource.RLIMIT_AS, (2**31, 2**31))\n"
        "try: g.read(sys.argv[1])\n"
        "except e.OutOfMemoryError as error: print(error)\n"
    )
    with (tmp_path / "big.npy").open("wb") as file:
        np.lib.format.write_array_header_1_0(
            file, {"descr": "<f8", "fortran_order": False, "shape": (2**28, 3)}
        )
        file.truncate(file.tell() + 2**28 * 24)  # 6 GB of zeros that take no place on the disk
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path / "big.npy")],
        capture_output=True,
        text=True,
        check=True,
    )
    assert re.search(
        r"big.npy: reading these 6,442,.* needs more memory than there is", done.stdout
    )
