"""Meshes and clouds: derived quantities, diagnosis, repair, splitting, and unit size and back."""

import tracemalloc

import numpy as np
import pytest
import trimesh
from conftest import joined, moved

from spectra_kit.geometry import (
    Normalization,
    PointCloud,
    TriangleMesh,
    components,
    diagnose,
    disk,
    largest_component,
    normalize,
    rectangle,
    repair,
    sphere,
    torus,
)

TRIANGLE = [[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]


@pytest.fixture(scope="module")
def ball():
    return sphere(subdivisions=2).geometry


@pytest.fixture(scope="module")
def dirty(ball):
    """A sphere with one of each fault, and what a diagnosis should count.

    Appended: a copy of a vertex, which face 0 uses instead of it, an unused vertex, a face with a
    repeated vertex, and face 5 again with another first corner.
    """
    faces = ball.faces.copy()
    points = np.vstack([ball.points, ball.points[faces[0, 0]], [3, 3, 3]])
    copy = ball.n
    extra = [[faces[2, 0], faces[2, 1], faces[2, 1]], np.roll(faces[5], 1)]
    faces[0, 0] = copy
    return TriangleMesh(points, np.vstack([faces, extra]))


def two_balls(ball):
    return joined(ball, moved(ball, 5.0, scale=0.5))


# --- the two types ------------------------------------------------------------------------------


def test_diagnosis_takes_less_memory_than_an_operator():
    """A few arrays as long as that of the corners, which are 48 bytes for each vertex."""
    mesh = sphere(subdivisions=5).geometry
    tracemalloc.start()
    try:
        found = diagnose(mesh)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert found.is_clean
    assert found.euler_characteristic == 2
    assert peak < 700 * mesh.n


def test_arrays_are_read_only_copies():
    points, faces = np.array(TRIANGLE), np.array([[0, 1, 2]])
    mesh, cloud = TriangleMesh(points, faces), PointCloud(points)
    points[:], faces[:] = 9.0, 0
    np.testing.assert_array_equal(mesh.points, TRIANGLE)
    np.testing.assert_array_equal(cloud.points, TRIANGLE)
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2]])
    for array in (mesh.points, mesh.faces, cloud.points):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_derived_values_agree_with_trimesh(ball):
    other = trimesh.Trimesh(ball.points, ball.faces, process=False)
    np.testing.assert_allclose(ball.face_areas, other.area_faces)
    edges, counts = ball.unique_edges
    assert {tuple(edge) for edge in edges} == {tuple(edge) for edge in other.edges_unique}
    assert (counts == 2).all()
    assert diagnose(ball).euler_characteristic == other.euler_number
    assert repr(ball) == "TriangleMesh(162 vertices, 320 faces)"
    assert repr(ball.as_cloud()) == "PointCloud(162 points)"


def test_boundary_is_the_rim():
    flat = disk(rings=5).geometry
    radius = np.linalg.norm(flat.points, axis=1)
    np.testing.assert_array_equal(flat.boundary_vertices, np.flatnonzero(radius > 1 - 1e-9))
    assert len(sphere(subdivisions=1).geometry.boundary_vertices) == 0


def test_cleaning_methods_do_one_thing_each(dirty, ball):
    assert dirty.without_unreferenced().n == ball.n + 1
    assert len(dirty.without_degenerate_faces().faces) == len(dirty.faces) - 1
    assert len(dirty.without_duplicate_faces().faces) == len(dirty.faces) - 1
    merged = dirty.with_merged_vertices()
    assert merged.n == ball.n + 1
    np.testing.assert_array_equal(merged.faces[: len(ball.faces)], ball.faces)
    np.testing.assert_array_equal(merged.points[: ball.n], ball.points)
    rows = PointCloud([[2.0, 1, 0], [0.0, 5, 0], [2, 1, 0], [-0.0, 5, 0], [1, 1, 0]])
    np.testing.assert_array_equal(rows.without_duplicates().points[:, 0], [2, 0, 1])


# --- diagnose -----------------------------------------------------------------------------------


def test_clean_surfaces_are_clean(ball):
    for mesh, chi, rim in [
        (ball, 2, 0),
        (torus(n=200).geometry, 0, 0),
        (disk(rings=4).geometry, 1, 24),
        (two_balls(ball), 4, 0),
    ]:
        found = diagnose(mesh)
        assert found.is_clean
        assert found.euler_characteristic == chi
        assert found.boundary_edges == rim
        assert found.nonmanifold_vertices == 0
    assert diagnose(two_balls(ball)).n_components == 2
    assert diagnose(rectangle(n=50).geometry).dimension == 2


def test_every_fault_is_counted(dirty, ball):
    found = diagnose(dirty)
    assert (found.n_points, found.n_faces) == (ball.n + 2, len(ball.faces) + 2)
    assert found.n_components == 1
    assert found.duplicate_points == 1
    assert found.degenerate_faces == 1
    assert found.duplicate_faces == 1
    assert found.unreferenced_vertices == 1
    assert found.nonmanifold_edges == 4  # three of the repeated face, one of the degenerate one
    assert found.upper == (3.0, 3.0, 3.0)
    assert found.seam_edges == 4  # on both sides of the two that end at the copy
    assert len(found.problems) == 6
    for method in ("with_merged_vertices", "without_degenerate_faces", "without_unreferenced"):
        assert sum(f"mesh.{method}()" in problem.remedies for problem in found.problems) == 1


def test_non_manifold_edge_and_vertex():
    points = [*TRIANGLE, [0, 0, 1], [0, 0, -1], [-1, 0, 0], [0, -1, 0]]
    book = TriangleMesh(points[:5], [[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    assert diagnose(book).nonmanifold_edges == 1
    assert diagnose(book).nonmanifold_vertices == 0
    bow_tie = TriangleMesh(points, [[0, 1, 2], [0, 5, 6]])
    assert diagnose(bow_tie).nonmanifold_edges == 0
    assert diagnose(bow_tie).nonmanifold_vertices == 1
    pinched = "1 vertex joins fans of faces that share no edge: use robust_laplacian"
    assert pinched in map(str, diagnose(bow_tie).problems)


def test_vertex_fans_agree_with_a_walk_around_each_vertex(ball):
    """Drop random faces from a sphere, then count the fans of each vertex by its link."""
    rng = np.random.default_rng(0)
    mesh = TriangleMesh(ball.points, ball.faces[rng.random(len(ball.faces)) < 0.6])
    split = 0
    for vertex in mesh.referenced_vertices:
        ring = mesh.faces[(mesh.faces == vertex).any(axis=1)]
        links = [set(face) - {vertex} for face in ring.tolist()]
        fans: list[set[int]] = []
        for link in links:
            touching = [fan for fan in fans if fan & link]
            fans = [fan for fan in fans if not fan & link] + [link.union(*touching)]
        split += len(fans) > 1
    assert split > 5
    assert diagnose(mesh).nonmanifold_vertices == split


@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_dimension_of_the_hull(offset):
    t = np.linspace(0, 1, 20)[:, None]
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 3))
    for points, dimension in [
        (0 * t * a, 0),
        (t * a, 1),
        (t * a + t**2 * b, 2),
        (rng.normal(size=(20, 3)), 3),
    ]:
        assert diagnose(PointCloud(points + offset)).dimension == dimension
    for points, sentence in (
        ([[1, 2, 3]], "all points coincide: no surface"),
        (t * a, "all points lie on one line: no surface"),
    ):
        (problem,) = diagnose(PointCloud(points)).problems
        assert (str(problem), problem.count) == (sentence, len(points))


def test_cloud_duplicates_are_found():
    found = diagnose(PointCloud([*TRIANGLE, TRIANGLE[1]]))
    (problem,) = found.problems
    assert str(problem) == "1 point lies exactly on an earlier one: cloud.without_duplicates()"
    assert problem.told(str.upper).endswith(": CLOUD.WITHOUT_DUPLICATES()")
    assert np.isnan(found.area)


# --- repair -------------------------------------------------------------------------------------


def test_repair_gives_back_the_clean_mesh_and_tells_where_every_vertex_went(dirty, ball):
    repaired = repair(dirty)
    np.testing.assert_array_equal(repaired.geometry.points, ball.points)
    np.testing.assert_array_equal(repaired.geometry.faces, ball.faces)
    once = ("merged_points", "degenerate_faces", "duplicate_faces", "unreferenced_vertices")
    assert vars(repaired.report) == dict.fromkeys(vars(repaired.report), 0) | dict.fromkeys(once, 1)
    np.testing.assert_array_equal(repaired.geometry.points, dirty.points[repaired.vertex_index])
    back = repaired.restore(repaired.geometry.points)
    np.testing.assert_array_equal(back[:-1], dirty.points[:-1])
    assert np.isnan(back[-1]).all()
    assert repaired.restore(np.ones(repaired.geometry.n), fill=-1.0)[-1] == -1.0


def test_repair_of_a_clean_geometry_changes_nothing(ball):
    for geometry in (ball, ball.as_cloud()):
        repaired = repair(geometry)
        np.testing.assert_array_equal(repaired.geometry.points, ball.points)
        np.testing.assert_array_equal(repaired.vertex_index, np.arange(ball.n))
        assert not any(vars(repaired.report).values())


def test_repair_without_merging_keeps_touching_sheets_apart():
    sheets = TriangleMesh([*TRIANGLE, *TRIANGLE], [[0, 1, 2], [3, 5, 4]])
    assert repair(sheets, merge=False).geometry.n == 6
    merged = repair(sheets)
    assert (merged.geometry.n, merged.report.duplicate_faces) == (3, 1)


# --- components ---------------------------------------------------------------------------------


def test_components_put_together_are_the_mesh(ball):
    rng = np.random.default_rng(0)
    both = two_balls(ball)
    order = rng.permutation(both.n)
    mixed = TriangleMesh(both.points[order], np.argsort(order)[both.faces][rng.permutation(640)])
    parts = components(mixed)
    assert [part.mesh.n for part in parts] == [ball.n, ball.n]
    assert parts[0].face_index[0] == 0
    for part in parts:
        np.testing.assert_array_equal(part.mesh.points, mixed.points[part.vertex_index])
        np.testing.assert_array_equal(
            part.vertex_index[part.mesh.faces], mixed.faces[part.face_index]
        )
        assert diagnose(part.mesh).euler_characteristic == 2
    everything = np.concatenate([part.vertex_index for part in parts])
    np.testing.assert_array_equal(np.sort(everything), np.arange(mixed.n))
    assert largest_component(mixed).mesh.area == pytest.approx(ball.area)


# --- normalisation ------------------------------------------------------------------------------


def test_unit_box_and_back(ball):
    mesh = ball.with_points((ball.points * [1, 2, 3] + [10, 20, 30]) * 1e6)
    unit, normalization = normalize(mesh)
    np.testing.assert_allclose(unit.points.max(axis=0), [1 / 6, 1 / 3, 1 / 2], rtol=1e-13)
    np.testing.assert_allclose(unit.points.min(axis=0), [-1 / 6, -1 / 3, -1 / 2], rtol=1e-13)
    assert normalization.scale == pytest.approx(6e6, rel=1e-13)
    back = normalization.invert(unit)
    np.testing.assert_allclose(back.points, mesh.points, rtol=1e-14)
    cloud = normalization.apply(mesh.as_cloud())
    np.testing.assert_array_equal(cloud.points, unit.points)
    np.testing.assert_array_equal(normalization.apply(mesh.points), unit.points)


def test_unit_area_is_about_the_centroid():
    """A cube of side 3 around (1, 2, 3), small triangles on one side: area 54."""
    box = trimesh.creation.box(extents=[3, 3, 3]).subdivide(face_index=[0])
    mesh = TriangleMesh(box.vertices + [1, 2, 3], box.faces)
    normalization = Normalization.unit_area(mesh)
    np.testing.assert_allclose(normalization.centre, [1, 2, 3], atol=1e-13)
    assert normalization.scale == pytest.approx(np.sqrt(54))
    assert normalization.apply(mesh).area == pytest.approx(1.0)


@pytest.mark.parametrize("exponent", [-1000, -600, 300, 1000])
def test_areas_and_what_has_none_do_not_depend_on_the_unit(exponent: int) -> None:
    ball = sphere(subdivisions=1).geometry
    points = np.vstack([ball.points, 2 * ball.points + 5, [[9, 9, 9]]])
    faces = np.vstack([ball.faces, ball.faces + ball.n, [[0, 1, 2 * ball.n]]])
    points[-1] = points[0]  # a face of no area, beside the others
    mesh = TriangleMesh(points, faces)
    scaled = mesh.with_points(np.ldexp(points, exponent))
    np.testing.assert_array_equal(scaled.degenerate_faces(), mesh.degenerate_faces())
    needle, thin = (
        TriangleMesh(np.ldexp([[0, 0, 0], [1, 0, 0], [0.3, height, 0]], exponent), [[0, 1, 2]])
        for height in (1e-13, 1e-9)
    )
    assert needle.degenerate_faces().all()
    assert not thin.degenerate_faces().any()
    assert thin.degenerate_faces(1e-8).all()
    larger = largest_component(mesh).vertex_index
    np.testing.assert_array_equal(largest_component(scaled).vertex_index, larger)
    if abs(exponent) == 300:
        np.testing.assert_array_equal(scaled.face_areas, np.ldexp(mesh.face_areas, 2 * exponent))
