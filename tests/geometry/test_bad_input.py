"""What no operator can use is refused at the door, with the argument and the next step named."""

import numpy as np
import pytest
import torch

from spectra_kit import geometry
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import PointCloud, TriangleMesh, sphere

POINTS = [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]


def facts(error):
    return error.argument, error.expected, str(error.got), error.advice


TRANSPOSED = "did you pass its transpose?"


@pytest.mark.parametrize("make", [PointCloud, lambda points: TriangleMesh(points, [[0, 0, 0]])])
@pytest.mark.parametrize(
    ("points", "expected", "got", "advice"),
    [
        (
            [[0, 0, 1], [-np.inf, 0, np.inf]],
            "be finite",
            "2 NaN or infinite values, the first at (1, 0)",
            "{} leaves such points out, and tells which",
        ),
        (np.empty((0, 3)), "hold at least one point", "shape (0, 3)", ""),
        ([], "have shape (n, 3)", "(0,)", ""),
        (
            np.zeros((5, 2)),
            "have shape (n, 3)",
            "(5, 2)",
            "of planar ones, numpy.column_stack([points, numpy.zeros(len(points))]) makes these",
        ),
        (
            np.zeros((5, 6)),
            "have shape (n, 3)",
            "(5, 6)",
            "if normals or colours follow the coordinates, points[:, :3] leaves them out",
        ),
        (np.zeros((3, 50)), "have shape (n, 3)", "(3, 50)", TRANSPOSED),
        (np.zeros((2, 5, 3)), "have shape (n, 3)", "(2, 5, 3)", ""),
        (
            np.zeros((9, 8, 7)),
            "have shape (n, 3)",
            "(9, 8, 7)",
            "of an image of labels, geometry.from_labels(points) makes a surface of each",
        ),
        (np.zeros((4, 3), dtype=complex), "hold real numbers", "dtype complex128", ""),
        ([["a", "b", "c"]], "hold real numbers", "dtype <U1", ""),
        (
            torch.zeros(4, 3, requires_grad=True),
            "hold real numbers",
            "a Tensor, which must be detached first",
            "",
        ),
        (
            torch.zeros(4, 3, device="meta"),
            "hold real numbers",
            "a Tensor on 'meta', which must be brought to the host first (.cpu())",
            "",
        ),
    ],
)
def test_bad_points(make, points, expected, got, advice):
    with pytest.raises(InvalidInputError) as caught:
        make(points)
    assert facts(caught.value) == ("points", expected, got, advice)


@pytest.mark.parametrize(
    ("faces", "expected", "got", "advice"),
    [
        ([[0, 1, 4]], "be in [0, 4)", "4", ""),
        ([[0, 1, -1]], "be in [0, 4)", "-1", ""),
        ([[1, 2, 3], [2, 3, 4]], "be in [0, 4)", "4", "indices count from 0"),
        (np.array([[0, 1, 2**63]], dtype=np.uint64), "be in [0, 4)", f"{2**63}", ""),
        (
            np.empty((0, 3), dtype=int),
            "hold at least one triangle",
            "shape (0, 3)",
            "use PointCloud for bare points",
        ),
        (
            np.zeros((2, 4), dtype=int),
            "have shape (f, 3)",
            "(2, 4)",
            "quads are taken as pyvista.PolyData.from_regular_faces(points, faces), tetrahedra as"
            " pyvista.UnstructuredGrid({pyvista.CellType.TETRA: faces}, points).extract_surface()",
        ),
        (
            np.zeros((2, 6), dtype=int),
            "have shape (f, 3)",
            "(2, 6)",
            "polygons are taken as pyvista.PolyData.from_regular_faces(points, faces)",
        ),
        (np.zeros((3, 120), dtype=int), "have shape (f, 3)", "(3, 120)", TRANSPOSED),
        ([[0.0, 1.0, 2.0]], "hold integers", "dtype float64", "count from 0"),
    ],
)
def test_bad_faces(faces, expected, got, advice):
    with pytest.raises(InvalidInputError) as caught:
        TriangleMesh(POINTS, faces)
    assert facts(caught.value) == ("faces", expected, got, advice)


@pytest.mark.parametrize("dtype", [np.int32, np.uint8, np.uint64, ">i4"])
def test_any_integer_type_is_welcome(dtype):
    mesh = TriangleMesh(np.asfortranarray(POINTS, dtype=np.float32), np.array([[0, 1, 2]], dtype))
    assert (mesh.faces.dtype, mesh.points.dtype) == (np.int64, np.float64)
    assert mesh.points.flags.c_contiguous


BALL = sphere(subdivisions=1).geometry
CLOUD = PointCloud(BALL.points)
FLAT = TriangleMesh([[0, 0, 0], [1, 1, 1], [2, 2, 2]], [[0, 1, 2]])
ONE = PointCloud([[1, 2, 3], [1, 2, 3]])


@pytest.mark.parametrize(
    ("call", "argument", "expected"),
    [
        (lambda: geometry.sphere(subdivisions=10), "subdivisions", "be in [0, 9]"),
        (lambda: geometry.sphere(k=0), "k", "be at least 1"),
        (lambda: geometry.rectangle(n=9, width=99.0), "width", "be within n = 9 times `height`"),
        (lambda: geometry.disk(k=10_001), "k", "be in [1, 10000]"),
        (lambda: geometry.torus(minor=1.0), "minor", "be smaller than `major` = 1.0"),
        (lambda: geometry.mirrored(BALL, axis=3), "axis", "be in [0, 2]"),
        (lambda: geometry.sample(FLAT, 9, seed=0), "mesh", "have area to be sampled"),
        (lambda: geometry.sample(BALL, 0, seed=0), "n", f"be in [1, {2**48}]"),
        (
            lambda: geometry.sample_with_origin(BALL, 9, seed=0).interpolate(np.ones(3)),
            "values",
            "have one row for each vertex of the sampled mesh",
        ),
        (lambda: geometry.repair(FLAT), "geometry", "have a face with area"),
        (
            lambda: geometry.repair(BALL).restore(np.ones(3)),
            "values",
            "have 42 rows, one for each point of the repaired geometry",
        ),
        (lambda: geometry.normalize(ONE), "geometry", "have an extent to be normalised"),
        (lambda: geometry.Normalization.unit_area(FLAT), "mesh", "have area"),
        (lambda: geometry.estimate_normals(ONE), "cloud", "have at least 3 points"),
        (lambda: geometry.estimate_normals(CLOUD, n_neighbors=1), "n_neighbors", "be at least 2"),
        (
            lambda: geometry.orient_normals(CLOUD, np.ones((9, 3))),
            "normals",
            "have shape (42, 3) like the points",
        ),
        (lambda: geometry.orient_normals(CLOUD, np.ones((42, 3))), "normals", "be unit vectors"),
        (lambda: BALL.degenerate_faces(1.0), "relative_area", "be in [0, 1)"),
        (lambda: BALL.with_points(np.eye(3)), "faces", "be in [0, 3)"),
        (lambda: FLAT.without_degenerate_faces(), "faces", "hold at least one triangle"),
    ],
)
def test_what_functions_must_be_given(call, argument, expected):
    with pytest.raises(InvalidInputError) as caught:
        call()
    assert (caught.value.argument, caught.value.expected) == (argument, expected)
