"""Objects of other libraries: each is the surface or cloud that it holds, or says how to be one."""

import re
from contextlib import nullcontext

import numpy as np
import pytest
import pyvista
import torch
import trimesh
from others import BALL, F, V, follow, is_ball, polydata, write_gifti

from spectra_kit import as_geometry
from spectra_kit.errors import IgnoredContentWarning, InvalidInputError


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
