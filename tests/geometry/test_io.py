"""Files: the order of vertices survives, numbers survive, and half a file is never half read."""

import os
import resource
import sys
from collections import Counter

import numpy as np
import pytest
import trimesh

from spectra_kit.errors import OutOfMemoryError
from spectra_kit.geometry import PointCloud, TriangleMesh, read, sphere, write
from spectra_kit.geometry.formats import numpy_arrays
from spectra_kit.geometry.io import READERS

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


# --- what is written comes back, and trimesh agrees ----------------------------------------------


@pytest.mark.parametrize("suffix", [*EXACT, *SINGLE, ".OBJ"])
@pytest.mark.parametrize("scale", [1.0, 1e-300, 1e300])
def test_mesh_round_trip_is_exact(mesh, tmp_path, suffix, scale):
    if suffix in SINGLE:
        scaled, expected = mesh, mesh.with_points(mesh.points.astype(np.float32))
    else:
        scaled = expected = mesh.with_points(mesh.points * scale)
    write(scaled, tmp_path / f"mesh{suffix}")
    assert_same(read(tmp_path / f"mesh{suffix}"), expected)
    if scale == 1 and suffix != ".npz":
        other = trimesh.load_scene(tmp_path / f"mesh{suffix}", process=False, maintain_order=True)
        np.testing.assert_allclose(other.to_mesh().vertices, mesh.points, rtol=1e-6)
        np.testing.assert_array_equal(other.to_mesh().faces, mesh.faces)


@pytest.mark.parametrize("suffix", CLOUD)
def test_cloud_round_trip_is_exact(mesh, tmp_path, suffix):
    write(mesh.as_cloud(), tmp_path / f"cloud{suffix}")
    copy = read(tmp_path / f"cloud{suffix}")
    assert isinstance(copy, PointCloud)
    np.testing.assert_array_equal(copy.points, mesh.points)


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


@pytest.mark.parametrize("kind", ["ours", "stl", "stl_ascii"])
def test_stl_keeps_triangles_and_joins_corners(mesh, tmp_path, kind):
    other = trimesh.Trimesh(mesh.points, mesh.faces, process=False)
    if kind == "ours":
        write(mesh, tmp_path / "mesh.stl")
    else:
        other.export(tmp_path / "mesh.stl", file_type=kind)
    copy = read(tmp_path / "mesh.stl")
    assert copy.n == len(mesh.referenced_vertices)
    np.testing.assert_allclose(copy.points[copy.faces], mesh.points[mesh.faces], rtol=1e-6)


# --- what other programs write ------------------------------------------------------------------

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
FAN = [[0, 1, 2], [0, 2, 3]]


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


def test_npz_with_short_names_and_small_types(tmp_path):
    np.savez_compressed(
        tmp_path / "a.npz", V=SQUARE.astype(np.float16), F=np.array(FAN, np.uint16), other=3
    )
    assert_same(read(tmp_path / "a.npz"), TriangleMesh(SQUARE, FAN))


def test_a_mistake_of_the_reader_is_not_told_as_a_damaged_file(tmp_path, monkeypatch):
    np.savez(tmp_path / "a.npz", V=SQUARE, F=FAN)
    monkeypatch.setattr(numpy_arrays, "_array", lambda file, size: file.no_such_attribute)
    with pytest.raises(AttributeError, match="no_such_attribute"):
        read(tmp_path / "a.npz")


def test_stl_joins_positive_and_negative_zero(tmp_path):
    facets = [[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], [[-0.0, 0, -0.0], [0, 1, 0], [-1, 0, 0]]]
    loose = TriangleMesh(np.reshape(facets, (-1, 3)), [[0, 1, 2], [3, 4, 5]])
    write(loose, tmp_path / "a.stl")
    mesh = read(tmp_path / "a.stl")
    assert mesh.n == 4
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [0, 2, 3]])


# --- interrupted writes -------------------------------------------------------------------------


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


PLY = (
    "ply\nformat ascii 1.0\ncomment the end_header line follows\nelement vertex 3\n"
    "property float x\nproperty float y\nproperty float z\nelement face 1\n"
    "property list uchar int vertex_indices\nend_header\n"
)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("comment.ply", PLY + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"),
        ("rows on one line.ply", PLY + "\n0 0 0 1 0 0 0 1 0\n3 0 1 2"),
        ("lines that go on.obj", "v 0 0 \\\n0\nv 1 0 0\nv 0 1 0\nf 1 \\\n 2 3\n"),
        ("unseen separator.off", "OFF\n3 1 0\n0 0 0 # from\u2028 4 5 6\n1 0 0\n0 1 0\n3 0 1 2"),
    ],
)
def test_odd_but_whole(tmp_path, name, text):
    (tmp_path / name).write_text(text, encoding="utf-8")
    assert_same(read(tmp_path / name), TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]))


def test_reading_text_of_stl_takes_work_in_proportion_to_it(tmp_path):
    """The calls that the interpreter makes are counted, not timed."""
    facet = "facet normal 0 0 0\nouter loop" + 3 * "\nvertex %r %r %r" + "\nendloop\nendfacet\n"
    calls = {}
    for count in (100, 400):
        corners = np.random.default_rng(0).normal(size=(count, 9))
        facets = "".join(facet % tuple(row) for row in corners.tolist())
        (tmp_path / "a.stl").write_text(f"SOLID of noise\n{facets}  EndSolid of noise\n")
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


def test_want_of_memory_names_the_file(tmp_path, monkeypatch):
    np.save(tmp_path / "big.npy", SQUARE)
    monkeypatch.setitem(READERS, ".npy", lambda path: np.empty(2**50))
    with pytest.raises(OutOfMemoryError, match=r"big.npy: reading these 224 bytes needs more"):
        read(tmp_path / "big.npy")
