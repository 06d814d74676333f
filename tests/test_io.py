"""Files: the order of vertices survives, numbers survive, and half a file is never half read."""

import os
import resource

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
    with pytest.raises(InvalidInputError, match='`kind` must be "mesh", "cloud" or None'):
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
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 0\n", r"`faces` must be in \[0, 3\), got -1"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nf 1 2\n", "a face must have at least 3 corners"),
        ("a.off", "ply\n", "must start with the keyword OFF, got 'ply'"),
        ("a.off", "# only a comment\n", "must start with the keyword OFF, got ''"),
        ("a.off", "OFF\nBINARY\n", "must announce its numbers of vertices and faces"),
        ("a.off", "OFF\n", "must announce its numbers of vertices and faces"),
        ("a.off", "OFF\n3 1 0\n0 0 0\n", "announces 3 vertices and 1 face, followed by 1 line;"),
        ("a.off", "OFF\n1 1 0\n0 0 0\n3 0 0\n", "line 4 is broken: '3 0 0'"),
        ("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n", r"must be in \[0, 3\), got 3"),
        ("a.off", "OFF\n3 1 0\n0 0 0\n1 0 inf\n0 1 0\n3 0 1 2\n", "must be finite"),
        ("a.xyz", "1 2\n3 4\n", "line 1 is broken: '1 2'; expected 3 numbers"),
        ("a.xyz", "1 2 3 4\n5 6 7\n", "line 2 is broken: '5 6 7'; expected 4 numbers"),
        ("a.xyz", "H 1 2 3\n", "line 1 is broken"),
        ("a.xyz", "# nothing\n", "must have shape"),
        ("a.stl", "solid a\nendsolid a\n", "holds no triangle"),
        ("a.stl", "solid a\n" + FACET.format("0 0 0"), "do not add up"),
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
        ("a.ply", PLY + VERTEX + FACE + BODY + "-1\n", "at least 3 corners, got one with 0"),
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
            "stores triangle strips",
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
