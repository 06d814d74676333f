"""Files of neuro-imaging, finite elements and scanners, as their libraries write and read them."""

import builtins
import gzip
import os
import sys

import numpy as np
import pytest
import pyvista
import trimesh
from others import BALL, F, V, is_ball, polydata, write_gifti

from spectra_kit import as_geometry
from spectra_kit.datasets import Plan, SpectrumStore, compute_all, find_inputs
from spectra_kit.errors import (
    IgnoredContentWarning,
    InvalidFileError,
    InvalidInputError,
    MissingDependencyError,
)
from spectra_kit.geometry import PointCloud, TriangleMesh, read, write

SQUARES = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0]], float)
QUADS = np.array([[0, 1, 2, 3], [1, 4, 5, 2]])
TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)


def by_meshio(path, cells=(("triangle", F),), points=V, **options):
    meshio = pytest.importorskip("meshio")
    meshio.write(path, meshio.Mesh(points, list(cells)), **options)


def by_freesurfer(path):
    pytest.importorskip("nibabel").freesurfer.write_geometry(str(path), V, F)


def with_volume(path):
    info = {"head": np.array([2, 0, 20]), "valid": "1", "filename": "a.mgz"}
    info |= {key: np.eye(3)[i] for i, key in enumerate(("xras", "yras", "zras"))}
    info |= {"volume": np.array([9, 9, 9]), "voxelsize": np.ones(3), "cras": np.zeros(3)}
    pytest.importorskip("nibabel").freesurfer.write_geometry(str(path), V, F, volume_info=info)


def by_vtk(path, **options):
    surface = polydata()
    if path.suffix == ".vtu" or "grid" in path.name:
        surface = surface.cast_to_unstructured_grid()
    surface.save(path, **options)


FILES = [
    ("lh.pial", by_freesurfer, 1e-7),
    ("lh.white", with_volume, 1e-7),
    ("lh.sphere.reg", by_freesurfer, 1e-7),  # known by their content
    ("rh.orig.nofix", with_volume, 1e-7),
    ("lh.pial.surf.gii", write_gifti, 1e-7),
    ("a.vtp", by_vtk, 0),
    ("text.vtp", lambda path: by_vtk(path, binary=False), 1e-6),
    ("a.vtk", by_vtk, 0),
    ("text.vtk", lambda path: by_vtk(path, binary=False), 1e-6),
    ("grid.vtk", by_vtk, 0),
    ("a.vtu", by_vtk, 0),
    ("by meshio.vtk", by_meshio, 0),
    ("by meshio.vtu", by_meshio, 0),
    ("a.msh", lambda path: by_meshio(path, file_format="gmsh"), 0),
    ("text.msh", lambda path: by_meshio(path, file_format="gmsh", binary=False), 1e-12),
    ("old.msh", lambda path: by_meshio(path, file_format="gmsh22"), 0),
    ("a.mesh", by_meshio, 1e-12),
]


@pytest.mark.parametrize("is_packed", [False, True], ids=["plain", "gz"])
@pytest.mark.parametrize(("name", "make", "atol"), FILES, ids=[name for name, *_ in FILES])
def test_what_their_libraries_write_is_read(tmp_path, name, make, atol, is_packed):
    path = tmp_path / name
    make(path)
    if is_packed:
        (tmp_path / f"{name}.gz").write_bytes(gzip.compress(path.read_bytes()))
        path.unlink()
        path = tmp_path / f"{name}.gz"
    mesh = read(path)
    np.testing.assert_allclose(mesh.points, V, rtol=0, atol=atol)
    np.testing.assert_array_equal(mesh.faces, F)
    assert [one.path for one in find_inputs([tmp_path])] == [path]
    assert read(path, kind="cloud").n == mesh.n


VALUES = {"u": V[:, 0], "curl": V[:, ::-1], "part": np.arange(len(V)) % 3}


def back_gifti(path):
    image = pytest.importorskip("nibabel").load(path)
    data = {array.meta["Name"]: array.data for array in image.darrays if array.intent == 2005}
    data["curl"] = np.column_stack([data.pop(f"curl_{i}") for i in range(3)])
    return image, data


def back_ply(path):
    mesh = trimesh.load_mesh(path, process=False)
    rows = mesh.metadata["_ply_raw"]["vertex"]["data"]
    data = {name: rows[name].ravel() for name in ("u", "part")}
    return mesh, data | {"curl": np.column_stack([rows[f"curl_{i}"].ravel() for i in range(3)])}


def back_vtk(path):
    surface = pyvista.read(path)
    return surface, surface.point_data


@pytest.mark.parametrize(
    ("suffix", "back", "rtol"),
    [
        (".gii", back_gifti, 1e-6),
        (".ply", back_ply, 0),
        (".vtk", back_vtk, 0),
        (".vtp", back_vtk, 0),
    ],
)
def test_results_come_back_by_their_libraries(tmp_path, suffix, back, rtol):
    path = tmp_path / f"a{suffix}"
    write(BALL, path, point_data=VALUES)
    thing, data = back(path)
    is_ball(thing)
    for name, values in VALUES.items():
        np.testing.assert_allclose(data[name], values, rtol=rtol)
    np.testing.assert_allclose(read(path).points, V, rtol=rtol)
    np.testing.assert_array_equal(read(path).faces, F)
    write(BALL, path)  # without
    is_ball(path)


@pytest.mark.parametrize("suffix", [".ply", ".vtk", ".vtp"])
def test_clouds_with_values(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    values = np.where(V[:, 2] > 0, V[:, 2], np.nan)
    write(BALL.as_cloud(), path, point_data={"height": values})
    got = read(path)
    assert isinstance(got, PointCloud)
    np.testing.assert_array_equal(got.points, V)
    if suffix != ".ply":
        np.testing.assert_array_equal(pyvista.read(path)["height"], values)


@pytest.mark.parametrize(
    ("name", "data", "problem"),
    [
        ("a.obj", {"u": V[:, 0]}, r"left out in \.obj files.*write one of \.gii, \.ply, \.vtk"),
        ("a.ply", {"u": V[:5, 0]}, r"a row for each of 42 points, got shape \(5,\)"),
        ("a.vtp", {"u": ["a"] * 42}, "arrays of real numbers"),
        ("a.ply", {"two words": V[:, 0]}, "words other than x, y, z, got 'two words'"),
        ("a.ply", {"x": V[:, 0]}, "words other than x, y, z, got 'x'"),
        ("a.vtp", {"": V[:, 0]}, "name its arrays"),
    ],
)
def test_values_that_no_file_can_hold(tmp_path, name, data, problem):
    with pytest.raises(InvalidInputError, match=problem):
        write(BALL, tmp_path / name, point_data=data)
    assert not list(tmp_path.iterdir())


# --- cells that are no triangles ------------------------------------------------------------------


@pytest.mark.parametrize("name", ["a.vtk", "a.vtp", "a.vtu", "a.msh", "a.mesh"])
def test_quads_are_cut(tmp_path, name):
    if name == "a.vtp":
        pyvista.PolyData.from_regular_faces(SQUARES, QUADS).save(tmp_path / name)
    else:
        kind = {"file_format": "gmsh"} if name == "a.msh" else {}
        by_meshio(tmp_path / name, [("quad", QUADS)], SQUARES, **kind)
    mesh = read(tmp_path / name)
    assert (mesh.n, len(mesh.faces), mesh.area) == (6, 4, 2)


def test_strips_and_mixed_polygons(tmp_path):
    pyvista.PolyData(SQUARES, strips=[6, 0, 3, 1, 2, 4, 5]).save(tmp_path / "a.vtp")
    mesh = read(tmp_path / "a.vtp")
    corners = mesh.points[mesh.faces]
    upwards = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    np.testing.assert_array_equal(upwards, -1)
    mixed = pyvista.PolyData(SQUARES, faces=[3, 0, 1, 2, 3, 0, 2, 3, 4, 1, 4, 5, 2])
    mixed.save(tmp_path / "b.vtk")
    mesh = read(tmp_path / "b.vtk")
    assert (len(mesh.faces), mesh.area) == (4, 2)


@pytest.mark.parametrize("name", ["a.vtk", "a.vtu", "a.msh", "a.mesh"])
def test_volumes_are_refused_and_say_how(tmp_path, name):
    path = tmp_path / name
    kind = {"file_format": "gmsh"} if name == "a.msh" else {}
    by_meshio(path, [("tetra", [[0, 1, 2, 3]])], TETRAHEDRON, **kind)
    with pytest.raises(InvalidFileError, match=r"no surface or cloud.* its surface is .*extract"):
        read(path)


@pytest.mark.parametrize("name", ["a.msh", "a.mesh"])
def test_faces_of_a_volume_are_taken(tmp_path, name):
    path = tmp_path / name
    kind = {"file_format": "gmsh22"} if name == "a.msh" else {}
    cells = [("tetra", [[0, 1, 2, 3]]), ("triangle", [[0, 1, 2]])]
    by_meshio(path, cells, TETRAHEDRON, **kind)
    with pytest.warns(IgnoredContentWarning, match=f"{name}: passed over 1 tetra cell beside"):
        assert read(path).area == 0.5


def test_a_grid_of_curves_and_points(tmp_path):
    by_meshio(tmp_path / "a.vtu", [("line", [[0, 1], [1, 2]])], SQUARES)
    with pytest.raises(InvalidFileError, match="an array, make a cloud"):
        read(tmp_path / "a.vtu")
    by_meshio(tmp_path / "b.vtu", [("vertex", np.arange(6)[:, None])], SQUARES)
    np.testing.assert_array_equal(read(tmp_path / "b.vtu").points, SQUARES)
    by_meshio(tmp_path / "c.vtu", [("line", [[0, 1]]), ("quad", QUADS)], SQUARES)
    with pytest.warns(IgnoredContentWarning, match=r"c\.vtu: passed over 1 line beside"):
        assert read(tmp_path / "c.vtu").area == 2


# --- clouds ---------------------------------------------------------------------------------------


def pcd(form, names="x y z rgb", sizes="4 4 4 4", kinds="F F F F", counts="1 1 1 1"):
    return (
        f"# .PCD v0.7\nVERSION 0.7\nFIELDS {names}\nSIZE {sizes}\nTYPE {kinds}\nCOUNT {counts}\n"
        f"WIDTH 42\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 42\nDATA {form}\n"
    ).encode()


def table(form, mark=" ", head=""):
    rows = (form.format(*map(repr, row)).replace(" ", mark) for row in V.tolist())
    return (head + "\n".join(rows) + "\n").encode()


PADDED = np.zeros(len(V), np.dtype([("n", "<f4", 3), ("at", "<f8", 3), ("label", "<u2")]))
PADDED["at"] = V
NORMALS = pcd("binary", "normal x y z label", "4 8 8 8 2", "F F F F U", "3 1 1 1 1")
CLOUDS = [
    ("a.txt", table("{} {} {}")),
    ("normals.txt", table("{} {} {} 0 0 1")),
    ("a.pts", table("{} {} {} 7 255 0 0", head="42\n")),
    ("a.asc", table("{} {} {}", ",")),
    ("a.csv", table("{} {} {}", ",", "x,y,z\n")),
    ("of pandas.csv", table("7 {} {} {} wall", ",", ",x,y,z,class\n")),
    ("of paraview.csv", table("1 {} {} {}", ",", '"u","Points:0","Points:1","Points:2"\n')),
    ("units.csv", table("9 {} {} {}", ";", "id;X [mm];Y [mm];Z (mm)\n")),
    ("of numpy.txt", table("9 {} {} {}", " ", "# id x y z\n")),
    ("remark.txt", table("{} {} {}", " ", "# z is up, y and x are not\n")),
    ("of cloudcompare.txt", table("{} {} {} 1", " ", "//X Y Z Intensity\n")),
    ("text.pcd", pcd("ascii") + table("{} {} {} 1e3")),
    ("binary.pcd", pcd("binary") + np.c_[V, V[:, 0]].astype("<f4").tobytes()),
    ("mixed.pcd", NORMALS + PADDED.tobytes()),
]


@pytest.mark.parametrize(("name", "data"), CLOUDS, ids=[name for name, _ in CLOUDS])
def test_clouds_with_headers(tmp_path, name, data):
    path = tmp_path / name
    path.write_bytes(data)
    got = read(path)
    assert isinstance(got, PointCloud)
    np.testing.assert_allclose(got.points, V, rtol=0, atol=1e-7 if name == "binary.pcd" else 0)
    (tmp_path / f"{name}.gz").write_bytes(gzip.compress(data))
    np.testing.assert_array_equal(read(tmp_path / f"{name}.gz").points, got.points)


def test_msh_of_ansys_is_named_with_two_ways_out(tmp_path):
    by_meshio(tmp_path / "a.msh")  # by its name meshio makes it one of ANSYS
    with pytest.raises(InvalidFileError, match="a mesh of ANSYS, expected one of Gmsh") as caught:
        read(tmp_path / "a.msh")
    meshio = pytest.importorskip("meshio")
    assert "hand over meshio.read(path), or " in str(caught.value)
    mesh = meshio.read(tmp_path / "a.msh")
    is_ball(mesh)
    assert 'meshio.write(path, mesh, file_format="gmsh")' in str(caught.value)
    meshio.write(tmp_path / "b.msh", mesh, file_format="gmsh")
    is_ball(read(tmp_path / "b.msh"))


def test_empty_cells_are_no_columns_less(tmp_path):
    (tmp_path / "a.csv").write_bytes(table("{},,{},{}"))
    with pytest.raises(InvalidFileError, match="line 1 is broken"):
        read(tmp_path / "a.csv")
    (tmp_path / "b.csv").write_bytes(table("{},{},{},", head="x,y,z,\n"))
    np.testing.assert_array_equal(read(tmp_path / "b.csv").points, V)


def test_packed_points_of_pcd_say_how(tmp_path):
    (tmp_path / "a.pcd").write_bytes(pcd("binary_compressed") + bytes(99))
    with pytest.raises(
        InvalidFileError, match=r"packed .*open3d\.io\.read_point_cloud\(path\), or"
    ):
        read(tmp_path / "a.pcd")


# --- objects --------------------------------------------------------------------------------------


class Tensor:
    """What PhysicsNeMo's meshes hold."""

    def __init__(self, array):
        self.array = np.asarray(array)

    def __getattr__(self, name):
        return (lambda: self.array) if name == "numpy" else (lambda: self)


def of_toolkit(name, **parts):
    return type("Mesh", (), {"__module__": f"{name}.mesh"} | parts)()


def test_meshes_of_libraries_that_are_not_here():
    none = np.empty((0, 3), int)
    physics = of_toolkit("physicsnemo", points=Tensor(V), cells=Tensor(F))
    is_ball(physics)
    assert as_geometry(of_toolkit("physicsnemo", points=Tensor(V), cells=Tensor(none))).n == len(V)
    solid = of_toolkit("physicsnemo", points=Tensor(TETRAHEDRON), cells=Tensor([[0, 1, 2, 3]]))
    with pytest.raises(InvalidInputError, match=r"its surface is get_boundary_mesh\(\)"):
        as_geometry(solid)
    edges = of_toolkit("physicsnemo", points=Tensor(V), cells=Tensor(F[:, :2]))
    with pytest.raises(InvalidInputError, match="its points, an array, make a cloud"):
        as_geometry(edges)
    is_ball(of_toolkit("open3d", vertices=V, triangles=F))
    assert as_geometry(of_toolkit("open3d", points=V)).n == len(V)


# --- what is not there, or goes on ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "make", "extra"),
    [("a.surf.gii", write_gifti, "brain"), ("a.mesh", by_meshio, "meshio")],
)
def test_without_their_library_the_extra_is_named(tmp_path, monkeypatch, name, make, extra):
    make(tmp_path / name)
    library = {"brain": "nibabel", "meshio": "meshio"}[extra]
    whole = builtins.__import__

    def lacking(module, *others, **more):
        if module.partition(".")[0] == library:
            raise ImportError(module)
        return whole(module, *others, **more)

    for module in [one for one in sys.modules if one.partition(".")[0] == library]:
        monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setattr(builtins, "__import__", lacking)
    with pytest.raises(MissingDependencyError, match=rf"pip install 'spectra_kit\[{extra}\]'"):
        read(tmp_path / name)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes with names")
def test_what_is_looked_into_is_a_file(tmp_path):
    os.mkfifo(tmp_path / "lh.pipe")
    (tmp_path / "lh.gone").symlink_to(tmp_path / "nowhere")
    (tmp_path / "lh.folder").mkdir()
    by_freesurfer(tmp_path / "lh.any")
    assert [one.path.name for one in find_inputs([tmp_path])] == ["lh.any"]


def test_a_batch_takes_them(tmp_path):
    for name, make, _ in FILES:
        make(tmp_path / name)
    inputs = find_inputs([tmp_path])
    assert len(inputs) == len(FILES)
    report = compute_all(inputs, SpectrumStore(tmp_path / "store"), Plan(k=4))
    assert not report.failed
    values = [np.array(done.record.eigenvalues[1:]) for _, done in report.completed]
    np.testing.assert_allclose(values, [values[0]] * len(FILES), rtol=1e-5)


def test_one_triangle_in_every_format(tmp_path):
    one = TriangleMesh(SQUARES[:3], [[0, 1, 2]])
    for suffix in (".gii", ".vtk", ".vtp"):
        write(one, tmp_path / f"a{suffix}")
        assert read(tmp_path / f"a{suffix}").area == 0.5


def with_matrix(path, matrix):
    nibabel = pytest.importorskip("nibabel")
    frame = nibabel.gifti.GiftiCoordSystem(xform=matrix)
    points = nibabel.gifti.GiftiDataArray(V.astype("f4"), "NIFTI_INTENT_POINTSET", coordsys=frame)
    faces = nibabel.gifti.GiftiDataArray(F.astype("i4"), "NIFTI_INTENT_TRIANGLE")
    nibabel.save(nibabel.gifti.GiftiImage(darrays=[points, faces]), path)


def test_matrices_of_gifti_that_change_lengths_are_told(tmp_path):
    """Turned, mirrored and moved, a surface has the same modes; scaled or sheared it has not."""
    path, matrix = tmp_path / "a.surf.gii", np.eye(4)
    matrix[:3, :3] = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    matrix[:3, 3] = 5, -12, 8
    for rigid in (np.eye(4), matrix, matrix.round(5), np.diag([-1.0, 1, 1, 1])):
        with_matrix(path, rigid)
        is_ball(path)
    shear = np.eye(4)
    shear[0, 1] = 0.1
    for other in (np.diag([1000.0, 1000, 1000, 1]), shear):
        with_matrix(path, other)
        told = r"a\.surf\.gii: passed over a matrix .* points @ matrix"
        with pytest.warns(IgnoredContentWarning, match=told):
            is_ball(path)
