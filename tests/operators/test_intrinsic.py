"""`intrinsic_delaunay`: triangulations, their gradient and divergence, and their boundary."""

import copy
from functools import cache

import igl
import numpy as np
import pytest
from conftest import ball as random_directions
from conftest import joined, moebius, moved, refused
from scipy import sparse
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from spectra_kit import (
    Dense,
    PointCloud,
    TriangleMesh,
    cotan_laplacian,
    delaunay_laplacian,
    eigensolve,
    robust_laplacian,
)
from spectra_kit.geometry import permuted, sphere
from spectra_kit.operators import IntrinsicTriangulation, intrinsic_delaunay
from spectra_kit.operators._edge_flips import side_lengths

RNG = np.random.default_rng


def ball(seed: int = 0) -> TriangleMesh:
    """An ellipsoid without symmetries, so that no two triangles share a circle."""
    mesh = sphere(subdivisions=2).geometry
    points = mesh.points * [1, 1.3, 1.7] + 0.02 * RNG(seed).standard_normal((mesh.n, 3))
    return mesh.with_points(points)


def plate(n: int = 400, stretch: float = 12.0) -> TriangleMesh:
    """A flat mesh of slivers: a Delaunay triangulation, stretched."""
    points = RNG(0).random((n, 2))
    faces = Delaunay(points).simplices
    return TriangleMesh(np.c_[points * [stretch, 1], np.zeros(n)], faces)


def flat_free(mesh: TriangleMesh) -> TriangleMesh:
    """The mesh without the slivers of its hull, which only mollification could save."""
    return mesh.without_degenerate_faces(relative_area=1e-3).without_unreferenced()


def with_any_winding(mesh: TriangleMesh) -> TriangleMesh:
    turned = RNG(1).random(len(mesh.faces)) < 0.5
    return TriangleMesh(mesh.points, np.where(turned[:, None], mesh.faces[:, ::-1], mesh.faces))


def three_sheets() -> TriangleMesh:
    """Three half-planes that meet in a line."""
    x, y = (c.ravel() for c in np.meshgrid(np.arange(8.0), np.arange(10.0), indexing="ij"))
    x = x + 0.2 * RNG(0).random(80) * (x > 0)
    faces = Delaunay(np.c_[x, y]).simplices
    corners = [np.c_[x * np.cos(turn), y + 0.01 * x, x * np.sin(turn)] for turn in (0.0, 2.0, 4.5)]
    points = np.concatenate(corners)
    return flat_free(
        TriangleMesh(points, np.concatenate([faces + 80 * k for k in range(3)]))
    ).with_merged_vertices()


def with_copies(mesh: TriangleMesh) -> TriangleMesh:
    return TriangleMesh(mesh.points, np.vstack([mesh.faces, mesh.faces[:50, ::-1]]))


def two_parts() -> TriangleMesh:
    return joined(ball(), moved(flat_free(plate(100, 2.0)), 9, 0, 0))


GEOMETRIES = {
    "ball": ball,
    "ball of any winding": lambda: with_any_winding(ball()),
    "plate of slivers": lambda: flat_free(plate()),
    "moebius strip": moebius,
    "two parts": two_parts,
    "three sheets": three_sheets,
    "copies": lambda: with_copies(ball()),
    "one triangle": lambda: TriangleMesh(np.eye(3), [[0, 1, 2]]),
    "pillow": lambda: TriangleMesh([[0, 0, 0], [1, 0, 0], [0.5, 0.1, 0]], [[0, 1, 2], [0, 2, 1]]),
    "ball as a cloud": lambda: ball().as_cloud(),
    "plate as a cloud": lambda: plate(300, 1.0).as_cloud(),
}
MESHES, MANIFOLD = list(GEOMETRIES)[:9], list(GEOMETRIES)[:5]


@cache
def made(name: str) -> TriangleMesh | PointCloud:
    return GEOMETRIES[name]()


@cache  # not when this file is read: kernels would be compiled in every process that collects it
def triangulated(name: str = "ball") -> IntrinsicTriangulation:
    return intrinsic_delaunay(made(name))


# ----------------------------------------------------------------------------- calculus


@pytest.mark.parametrize("name", GEOMETRIES)
def test_divergence_is_the_adjoint_of_the_gradient_and_both_make_the_laplacian(name: str) -> None:
    triangulation = triangulated(name)
    L, v = triangulation.laplacian.stiffness, RNG(0).standard_normal(triangulation.n)
    for u in (v, triangulation.points[:, 0]):
        found = triangulation.divergence(triangulation.gradient(u))
        assert np.abs(found - L @ u).max() <= 1e-12 * abs(L).max() * np.abs(u).max()
    X = RNG(1).standard_normal((len(triangulation.corners), 2))
    rises = (triangulation.gradient(v) * X).sum(axis=1)
    expected = triangulation.share * (triangulation.face_areas * rises).sum()
    assert v @ triangulation.divergence(X) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("name", GEOMETRIES)
def test_laplacian_is_that_of_the_triangles_and_an_m_matrix(name: str) -> None:
    # Cotangents by another path: squared lengths over areas, entry by entry.
    triangulation = triangulated(name)
    a, b, c = (np.roll(triangulation.lengths, -k, axis=1) for k in range(3))
    areas, n = triangulation.face_areas[:, None], triangulation.n
    weights = triangulation.share * (b**2 + c**2 - a**2) / (8 * areas)
    i, j = triangulation.corners, np.roll(triangulation.corners, -1, axis=1)
    half = sparse.coo_array((weights.ravel(), (i.ravel(), j.ravel())), shape=(n, n)).toarray()
    full = half + half.T
    np.fill_diagonal(full, 0)
    L = triangulation.laplacian.stiffness.toarray()
    size = np.abs(L).max()
    assert np.abs(L - (np.diag(full.sum(axis=1)) - full)).max() <= 1e-9 * size
    assert np.array_equal(L, L.T)
    assert (L - np.diag(np.diag(L))).max() <= 1e-9 * size
    assert np.abs(L.sum(axis=1)).max() <= 1e-12 * size
    assert triangulation.laplacian.kernel_dimension == triangulation.laplacian.n_components
    thirds = np.repeat(triangulation.share * triangulation.face_areas / 3, 3)
    assert triangulation.laplacian.mass == pytest.approx(
        np.bincount(i.ravel(), thirds, n), rel=1e-8
    )


def test_linear_functions_on_a_plate_of_slivers_have_their_gradient() -> None:
    mesh = plate(2000)
    triangulation = intrinsic_delaunay(mesh, mollify_factor=1e-12)
    direction = np.array([0.3, -2.0, 0.0])
    lengths = np.linalg.norm(triangulation.gradient(mesh.points @ direction), axis=1)
    # A flip at the boundary folds a triangle over; inside, the plate stays flat.
    inside = np.abs(mesh.points - [6, 0.5, 0])[triangulation.corners].max(axis=1)
    inside = (inside < [5, 0.3, 1]).all(axis=1)
    assert inside.sum() > 1000
    assert lengths[inside] == pytest.approx(np.linalg.norm(direction), rel=1e-9)


@pytest.mark.parametrize("mollify", [1e-5, 1e-3])
def test_a_needle_is_thickened_at_its_base_and_not_at_its_tip(mollify: float) -> None:
    small = 1e-4  # a triangle of this size shares the tip of a needle of length 1
    points = np.array([[0, 0], [1, 1e-9], [1, -1e-9], [-small, 0], [-small / 2, small]])
    triangles = np.array([[0, 2, 1], [0, 3, 4]], dtype=np.int32)
    sides = side_lengths(np.c_[points, np.zeros(5)], triangles, mollify)
    corners = points[triangles]
    inputs = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    np.testing.assert_array_equal(sides[1], inputs[1])
    slack = sides.sum(axis=1) - 2 * sides.max(axis=1)
    assert slack[0] >= 0.999 * mollify * inputs[0].mean()


# ----------------------------------------------------------------------------- measures


@pytest.mark.parametrize("name", MESHES)
def test_area_boundary_and_spectrum_are_those_of_the_mesh(name: str) -> None:
    mesh, triangulation = made(name), triangulated(name)
    assert triangulation.area == pytest.approx(mesh.area, rel=1e-9)
    assert triangulation.laplacian.area == pytest.approx(mesh.area, rel=1e-9)
    assert triangulation.boundary.tolist() == mesh.boundary_vertices.tolist()
    library = robust_laplacian(mesh)
    k = min(12, mesh.n - 1)
    ours, theirs = (
        eigensolve(L, k, Dense()).eigenvalues for L in (triangulation.laplacian, library)
    )
    # At non-manifold edges the library glues others.
    loose = {"three sheets": 5e-3, "copies": 1e-3}.get(name, 1e-6)
    assert ours == pytest.approx(theirs, rel=loose, abs=1e-9 * theirs[-1])
    if name in MANIFOLD:  # where the Delaunay triangulation is unique
        difference = triangulation.laplacian.stiffness - library.stiffness
        assert abs(difference).max() < 1e-8 * abs(library.stiffness).max()
        assert triangulation.laplacian.mass == pytest.approx(library.mass, rel=1e-8)


def test_each_triangle_once_where_the_mesh_is_closed_and_of_one_winding() -> None:
    once, twice = triangulated(), triangulated("ball of any winding")
    assert (once.share, twice.share) == (1.0, 0.5)
    assert len(twice.corners) == 2 * len(once.corners) == 2 * len(ball().faces)
    assert abs(once.laplacian.stiffness - twice.laplacian.stiffness).max() < 1e-12
    assert once.spacings == pytest.approx(twice.spacings, rel=1e-12)


def test_boundary_of_clouds() -> None:
    x, y = np.indices((12, 15)).reshape(2, -1)
    border = np.flatnonzero((x == 0) | (x == 11) | (y == 0) | (y == 14))
    grid = PointCloud(np.c_[x, y, np.zeros(len(x))])
    assert intrinsic_delaunay(grid).boundary.tolist() == border.tolist()
    assert len(intrinsic_delaunay(PointCloud(random_directions(3000))).boundary) == 0


def test_boundary_of_a_random_disc() -> None:
    n = 3000
    r, angle = np.sqrt(RNG(0).random(n)), 2 * np.pi * RNG(1).random(n)
    cloud = PointCloud(np.c_[r * np.cos(angle), r * np.sin(angle), 0.3 * r**2])
    boundary = intrinsic_delaunay(cloud).boundary
    spacing = (np.pi / n) ** 0.5
    assert (1 - r[boundary]).max() < 2 * spacing
    assert np.isin(np.flatnonzero(1 - r < 0.1 * spacing), boundary).mean() > 0.8
    gaps = np.diff(np.sort(angle[boundary]))
    assert gaps.max() < 10 * spacing


# ----------------------------------------------------------------------------- invariances


def test_equal_to_libigl_and_to_cotangents_on_a_delaunay_mesh() -> None:
    mesh, round_one = ball(), sphere(subdivisions=3).geometry
    library = -igl.intrinsic_delaunay_cotmatrix(np.array(mesh.points), np.array(mesh.faces))[0]
    ours = delaunay_laplacian(mesh).stiffness
    assert abs(ours - sparse.csr_array(library)).max() < 1e-10 * abs(ours).max()
    ours, cotangents = (f(round_one).stiffness for f in (delaunay_laplacian, cotan_laplacian))
    assert abs(ours - cotangents).max() < 1e-12 * abs(ours).max()


@pytest.mark.parametrize(
    ("name", "scale"), [("ball", 1e6), ("moebius strip", 1e-120), ("plate as a cloud", 1e6)]
)
def test_units(name: str, scale: float) -> None:
    geometry, base = made(name), triangulated(name)
    other = intrinsic_delaunay(geometry.with_points(scale * geometry.points))
    size = abs(base.laplacian.stiffness).max()
    assert abs(other.laplacian.stiffness - base.laplacian.stiffness).max() < 1e-6 * size
    assert other.laplacian.area == pytest.approx(scale**2 * base.laplacian.area, rel=1e-9)
    assert other.area == pytest.approx(scale**2 * base.area, rel=1e-9)
    assert other.spacings == pytest.approx(scale * base.spacings, rel=1e-6)
    assert other.boundary.tolist() == base.boundary.tolist()
    u = RNG(0).standard_normal(base.n)
    slopes = [np.sort(np.linalg.norm(t.gradient(u), axis=1)) for t in (base, other)]
    assert slopes[1] * scale == pytest.approx(slopes[0], rel=1e-3)


@pytest.mark.parametrize("name", ["ball", "moebius strip", "three sheets", "ball as a cloud"])
def test_order_of_vertices_and_faces_and_moves(name: str) -> None:
    base, (geometry, order) = triangulated(name), permuted(made(name), seed=0)
    turn = Rotation.from_rotvec([0.3, -1, 2]).as_matrix()
    other = intrinsic_delaunay(geometry.with_points(geometry.points @ turn.T + [3, -7, 11]))
    expected = base.laplacian.stiffness[order][:, order]
    assert abs(other.laplacian.stiffness - expected).max() < 1e-7 * abs(expected).max()
    assert other.laplacian.mass == pytest.approx(base.laplacian.mass[order], rel=1e-7)
    assert np.sort(order[other.boundary]).tolist() == base.boundary.tolist()


def test_copies_of_all_triangles_double_the_surface() -> None:
    # The second is obtuse at its boundary: glued to its copy there, that edge would be flipped.
    points = [[0, 0, 0], [4, 0, 0], [2, 0.5, 0], [2, 4, 0]]
    for mesh in (ball(), TriangleMesh(points, [[0, 1, 2], [0, 2, 3], [2, 1, 3]])):
        doubled = TriangleMesh(mesh.points, np.vstack([mesh.faces, mesh.faces]))
        one, two = delaunay_laplacian(mesh), delaunay_laplacian(doubled)
        assert abs(two.stiffness - 2 * one.stiffness).max() < 1e-12 * abs(one.stiffness).max()
        assert two.mass == pytest.approx(2 * one.mass)


def test_flips_cross_a_sharp_fold() -> None:
    # Three rows of points, a long edge along the middle one; then the right side folded over.
    n = 20
    y = 2.0 * np.arange(n)[:, None] + [0.9, 0.0, 0.8]
    flat = np.stack([np.broadcast_to([-0.3, 0.0, 0.3], (n, 3)), y, 0 * y], 2).reshape(-1, 3)
    rows = np.arange(3 * n).reshape(n, 3)
    a, b, c, d = rows[:-1, :-1], rows[:-1, 1:], rows[1:, 1:], rows[1:, :-1]
    faces = np.concatenate([np.stack([a, b, d], 2), np.stack([b, c, d], 2)]).reshape(-1, 3)
    folded = flat.copy()
    folded[2::3, 0], folded[2::3, 2] = -0.3 * np.cos(0.2), 0.3 * np.sin(0.2)
    one, other = (delaunay_laplacian(TriangleMesh(p, faces)) for p in (flat, folded))
    assert abs(one.stiffness - other.stiffness).max() < 1e-9
    assert one.stiffness[rows[5, 0], rows[5, 2]] < -0.1  # an edge from left to right


# ----------------------------------------------------------------------------- degenerate input


@pytest.mark.filterwarnings("ignore::spectra_kit.errors.SplitSurfaceWarning")  # points near edges
def test_rows_of_slivers_take_many_flips() -> None:
    n = 500
    line = np.c_[np.linspace(0, 1, n), np.zeros((n, 2))]
    fan = np.c_[np.arange(n - 1), np.arange(1, n), np.full(n - 1, n)]
    laplacian = delaunay_laplacian(TriangleMesh(np.vstack([line, [0.5, 1e-3, 0]]), fan))
    x = laplacian.points[:, 0]  # as on a thin strip, its energy is the area
    assert x @ (laplacian.stiffness @ x) == pytest.approx(laplacian.area, rel=0.01)


def test_a_flat_triangle_is_lengthened() -> None:
    mesh = TriangleMesh([[0, 0, 0], [1, 0, 0], [2, 0, 0], [1, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    found = delaunay_laplacian(mesh).stiffness.toarray()
    # Flipped: two right angles at vertex 1, and no edge from 0 to 2.
    expected = np.array([[0.5, -0.5, 0, 0], [-0.5, 2, -0.5, -1], [0, -0.5, 0.5, 0], [0, -1, 0, 1]])
    assert found == pytest.approx(expected, abs=0.02)


# ----------------------------------------------------------------------------- the object


def test_fields_are_read_only_and_in_the_units_of_the_geometry() -> None:
    mesh, triangulation = made("ball"), triangulated()
    assert triangulation.points.tolist() == mesh.points.tolist()
    assert triangulation.corners.dtype == np.int32
    for array in (triangulation.corners, triangulation.lengths, triangulation.boundary):
        assert not array.flags.writeable
    ends = np.roll(triangulation.corners, -1, 1)
    straight = np.linalg.norm(mesh.points[triangulation.corners] - mesh.points[ends], axis=2)
    assert (triangulation.lengths >= straight - 1e-12).all()  # intrinsic edges go along the surface
    assert triangulation.operator == "delaunay_laplacian(mesh, mollify_factor=1e-05)"
    capped = intrinsic_delaunay(mesh.as_cloud(), n_neighbors=200)
    assert capped.operator == "delaunay_laplacian(mollify_factor=1e-05, n_neighbors=161)"
    assert capped.seconds > 0
    assert repr(triangulation) == "IntrinsicTriangulation(320 triangles on 162 points)"
    other = copy.deepcopy(triangulation)
    u = RNG(0).standard_normal(other.n)
    assert np.array_equal(other.gradient(u), triangulation.gradient(u))


def rebuilt(**changes) -> IntrinsicTriangulation:
    fields = ("corners", "lengths", "share", "boundary", "laplacian")
    return IntrinsicTriangulation(
        **{name: getattr(triangulated(), name) for name in fields} | changes
    )


FLAT = TriangleMesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]])


@pytest.mark.parametrize(
    ("make", "argument", "expected"),
    [
        (lambda: intrinsic_delaunay(ball(), mollify_factor=-1), "mollify_factor", "be positive"),
        (lambda: intrinsic_delaunay(ball(), mollify_factor=9), "mollify_factor", "be at most 1"),
        (
            lambda: intrinsic_delaunay(FLAT, mollify_factor=1e-20),
            "mollify_factor",
            "lengthen the sides of degenerate triangles, got 3 weights",  # one for each edge
        ),
        (lambda: triangulated().gradient(np.zeros(5)), "values", "have shape (162,), got (5,)"),
        (lambda: triangulated().gradient(np.full(162, np.nan)), "values", "be finite"),
        (lambda: triangulated().divergence(np.zeros((5, 3))), "vectors", "have shape (320, 2)"),
        (lambda: rebuilt(corners=triangulated().corners + 1), "corners", "be in [0, 162)"),
        (lambda: rebuilt(lengths=triangulated().lengths[1:]), "lengths", "have the shape (f, 3)"),
        (lambda: rebuilt(lengths=0 * triangulated().lengths), "lengths", "be positive, got 960"),
        (lambda: rebuilt(share=0), "share", "be positive"),
        (lambda: rebuilt(boundary=[700]), "boundary", "be in [0, 162), got 700"),
    ],
)
def test_bad_input(make, argument, expected) -> None:
    refused(argument, expected, make)
