"""Dirty input: each solver finds the same right distances, or says what is wrong and what to do."""

import numpy as np
import pytest
from conftest import creature, joined, moved, refused
from geodesic_truths import angles, relative_error, soup, straight

from spectra_kit.errors import (
    ConvergenceError,
    DoubtfulDistanceWarning,
    InvalidInputError,
    SplitSurfaceWarning,
)
from spectra_kit.geodesics import Direct, HeatGeodesics, Iterative, exact_distances
from spectra_kit.geometry import PointCloud, TriangleMesh, rectangle, sphere
from spectra_kit.operators import intrinsic_delaunay

SOLVERS = [Direct(), Iterative(), Iterative(coarse="none", drop=None, relaxation=0.0)]
BALL = sphere(subdivisions=3).geometry
SHEET = rectangle(n=600).geometry
BODIES = {"ball": BALL, "sheet": SHEET, "animal": creature(1500, seed=0)}
SOURCE = 5


def distances(geometry, sources=SOURCE, *, apart=1e-7):
    """Measure by each solver, and return what they agree on."""
    triangulation = intrinsic_delaunay(geometry)  # what each would make of it
    fields = [HeatGeodesics(triangulation, solver=s).distance(sources).distance for s in SOLVERS]
    reached = np.isfinite(fields[0])
    assert (fields[0] >= 0).all()  # so not NaN either
    for field in fields[1:]:
        np.testing.assert_array_equal(np.isfinite(field), reached)
        assert np.abs(field[reached] - fields[0][reached]).max() <= apart * fields[0][reached].max()
    return fields[0]


def plus(mesh, points, faces):
    return TriangleMesh(
        np.vstack([mesh.points, np.reshape(points, (-1, 3))]), np.vstack([mesh.faces, faces])
    )


# --- faces that should not be there ---------------------------------------------------------------


def on_edges(mesh, rng, tip):
    """Twenty more faces on edges, with a corner of their own at ``tip(one end, other end)``."""
    edges = rng.choice(mesh.unique_edges[0], 20, replace=False)
    a, b = mesh.points[edges].transpose(1, 0, 2)
    return plus(mesh, tip(a, b), np.column_stack([edges, mesh.n + np.arange(20)]))


def with_caps(mesh, rng):
    return on_edges(mesh, rng, lambda a, b: a + rng.random((20, 1)) * (b - a))


def with_needles(mesh, rng):
    return on_edges(mesh, rng, lambda a, b: a)


def with_fins(mesh, rng):
    return on_edges(mesh, rng, lambda a, b: 1.5 * a + 0.1)


def with_shrunk_faces(mesh, rng):
    """Some faces are points, and those around them needles."""
    points = mesh.points.copy()
    for a, b, c in rng.choice(mesh.faces, 5, replace=False):
        points[[b, c]] = points[a]
    return mesh.with_points(points)


def with_duplicates(mesh, rng):
    again = rng.choice(mesh.faces, 20, replace=False)
    return plus(mesh, [], np.vstack([again[:10], again[10:, ::-1], again[:5]]))


def with_mixed_winding(mesh, rng):
    turned = rng.random(len(mesh.faces)) < 0.3
    return TriangleMesh(mesh.points, np.where(turned[:, None], mesh.faces[:, ::-1], mesh.faces))


def with_holes(mesh, rng):
    kept = mesh.faces[rng.random(len(mesh.faces)) < 0.8]
    return TriangleMesh(mesh.points, kept).without_unreferenced()


DIRT = [
    with_caps, with_needles, with_fins, with_shrunk_faces, with_duplicates, with_mixed_winding,
    with_holes,
]  # fmt: skip


@pytest.mark.filterwarnings("ignore:2 boundary edges lie on others")  # two fins that meet
@pytest.mark.parametrize("make", DIRT, ids=lambda make: make.__name__)
def test_dirty_meshes_have_right_distances(make) -> None:
    mesh = make((BALL, SHEET)[DIRT.index(make) % 2], np.random.default_rng(0))
    assert relative_error(distances(mesh), exact_distances(mesh, SOURCE)) < 0.06


def test_triangle_soup_is_as_many_components_as_triangles() -> None:
    loose = soup(BALL)
    with pytest.warns(SplitSurfaceWarning, match=r"falls into 1,280 parts, and has 1 if"):
        distance = distances(loose)
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(distance)), [3, 4, 5])
    merged = loose.with_merged_vertices()
    source = int(np.argmin(np.linalg.norm(merged.points - BALL.points[SOURCE], axis=1)))
    assert np.abs(np.sort(distances(merged, source)) - np.sort(distances(BALL))).max() < 1e-6


def test_fragments_are_reached_or_not() -> None:
    kept = np.random.default_rng(1).random(len(SHEET.faces)) < 0.3
    mesh = TriangleMesh(SHEET.points, SHEET.faces[kept]).without_unreferenced()
    assert mesh.component_labels.max() >= 3
    sources = [SOURCE, 200, 300]
    distance, label = distances(mesh, sources), mesh.component_labels
    np.testing.assert_array_equal(np.isfinite(distance), np.isin(label, label[sources]))
    assert not distance[sources].any()


def test_bodies_that_touch_in_a_vertex() -> None:
    """Heat comes through; far from the vertex, distances add up."""
    east, west = (int(f(BALL.points[:, 0])) for f in (np.argmax, np.argmin))
    faces = BALL.faces + BALL.n
    faces[BALL.faces == west] = east
    shift = BALL.points[east] - BALL.points[west]
    mesh = plus(BALL, BALL.points + shift, faces).without_unreferenced()
    distance = distances(mesh)
    assert relative_error(distance, exact_distances(mesh, SOURCE)) < 0.06


# --- extreme numbers ------------------------------------------------------------------------------


@pytest.mark.parametrize(("factor", "offset"), [(1e-30, 0.0), (1e30, 1e6)])
def test_any_unit_and_any_place(factor, offset) -> None:
    for geometry in (BALL, BALL.as_cloud()):
        moved = geometry.with_points((geometry.points + offset) * factor)
        assert np.abs(distances(moved) / factor - distances(geometry)).max() < 1e-6


@pytest.mark.parametrize("axes", [(1e4, 1, 1), (1, 1, 1e-5)])
def test_long_or_flat_bodies(axes) -> None:
    mesh = BALL.with_points(BALL.points * axes)
    assert relative_error(distances(mesh), exact_distances(mesh, SOURCE)) < 0.05


@pytest.mark.parametrize(("body", "length"), [("sheet", 1e2), ("animal", 1e4)])
def test_a_spike_far_longer_than_the_edges(body, length) -> None:
    mesh = BODIES[body]
    points, tip = mesh.points.copy(), mesh.n // 2
    points[tip, 2] += length * np.linalg.norm(np.subtract(*points[mesh.faces[0, :2]]))
    spiky = mesh.with_points(points)
    there, back = distances(spiky), distances(spiky, tip)
    assert relative_error(back, exact_distances(spiky, tip)) < 0.03
    # A few long edges say nothing of the time that the body needs: on it, little changes.
    truth = exact_distances(spiky, SOURCE)
    away = truth > 0
    assert np.median(np.abs(there - truth)[away] / truth[away]) < 0.04
    assert there[tip] == pytest.approx(truth[tip], rel=0.03)
    assert there[tip] == pytest.approx(back[SOURCE], rel=0.03)


@pytest.mark.parametrize("size", [1e-6, 1e6])
def test_each_part_has_distances_as_if_it_were_alone(size) -> None:
    both = joined(SHEET, moved(SHEET, 9, 9, 9, scale=size))
    alone = distances(SHEET)
    together = distances(both, [SOURCE, SHEET.n + SOURCE])
    rounding = 1e-7 if size > 1 else 1e-6  # of the coordinates, beside the 9
    assert np.abs(together[: SHEET.n] - alone).max() < 1e-7 * alone.max()
    assert np.abs(together[SHEET.n :] / size - alone).max() < rounding * alone.max()
    field = HeatGeodesics(both, solver=Direct()).distance(SOURCE)
    assert np.isinf(field.distance[SHEET.n :]).all()
    assert (field.heat.method, field.heat.iterations) == ("Cholesky", 0)


@pytest.mark.parametrize("boundary", ["neumann", "dirichlet", "average"])
def test_a_part_is_solved_as_with_the_others_wherever_its_points_are(boundary) -> None:
    both = joined(SHEET, moved(SHEET, 9, 9, 9, scale=3))
    place = np.random.default_rng(0).permutation(both.n)
    points = np.empty_like(both.points)
    points[place] = both.points
    mixed = HeatGeodesics(TriangleMesh(points, place[both.faces]), boundary=boundary)
    inner = np.linalg.norm(SHEET.points - SHEET.points.mean(axis=0), axis=1).argmin()
    one, other = place[inner], place[SHEET.n + inner]
    together = mixed.distance([one, other])
    for source, own in ((one, place[: SHEET.n]), (other, place[SHEET.n :])):
        alone = mixed.distance(source)
        assert np.isfinite(alone.distance[own]).all()
        assert np.isinf(np.delete(alone.distance, own)).all()
        assert (np.delete(alone.heat.values, own) == 0).all()
        reach = together.distance[own].max()
        assert np.abs(alone.distance - together.distance)[own].max() < 1e-9 * reach


@pytest.mark.parametrize("unit", [1e100, 1e-100])
def test_weights_of_any_size_in_any_unit(unit) -> None:
    body = BALL.with_points(unit * BALL.points)
    found = HeatGeodesics(body).distance([SOURCE, 300], weights=[unit**3, unit**3])
    assert np.abs(found.distance / unit - distances(BALL, [SOURCE, 300])).max() < 1e-7


def test_details_that_the_step_blurs_are_warned_of() -> None:
    fine = 1e-3 * BALL.points  # joined to edges a thousand times as long, too many for outliers
    far = np.random.default_rng(0).choice(BALL.n, 200, replace=False)
    fine[far] *= 1e3
    with pytest.warns(DoubtfulDistanceWarning, match=r"nearer to a source .* blurred.*lower"):
        HeatGeodesics(BALL.with_points(fine)).distance(int(np.setdiff1d(range(BALL.n), far)[0]))


@pytest.mark.parametrize("solver", SOLVERS)
def test_rounding_that_spoils_the_answer_is_said(solver) -> None:
    needles = SHEET.with_points(SHEET.points * [1e5, 1, 1])
    with pytest.raises((InvalidInputError, ConvergenceError), match=r"residual|rounding"):
        HeatGeodesics(needles, solver=solver).distance(SOURCE)


# --- point clouds ---------------------------------------------------------------------------------


def cloud_with(points):
    return PointCloud(np.vstack([BALL.points, points]))


def test_a_cloud_with_outliers_noise_or_points_that_nearly_coincide() -> None:
    rng = np.random.default_rng(0)
    out = rng.standard_normal((20, 3))
    out *= 3 / np.linalg.norm(out, axis=1, keepdims=True)
    noisy = BALL.as_cloud().with_points(BALL.points * (1 + 0.05 * rng.standard_normal((BALL.n, 1))))
    twins = BALL.points[:5] * (1 + 1e-15)
    for cloud, error in ((cloud_with(out), 0.07), (noisy, 0.09), (cloud_with(twins), 0.03)):
        found = distances(cloud)[: BALL.n]
        assert relative_error(found, angles(BALL.points, SOURCE)) < error


@pytest.mark.filterwarnings("ignore:the cloud falls into 2 parts")  # they may be one
@pytest.mark.parametrize("gap", [0.5, 1e-4])
def test_a_cloud_of_two_sheets(gap) -> None:
    """Farther apart than the points of each they are two components, nearer they are one sheet."""
    flat = straight(SHEET.points, SOURCE)
    distance = distances(PointCloud(np.vstack([SHEET.points, SHEET.points + [0, 0, gap]])))
    assert relative_error(distance[: SHEET.n], flat) < 0.05
    if gap == 0.5:
        assert np.isinf(distance[SHEET.n :]).all()
    else:
        assert relative_error(distance[SHEET.n :], flat) < 0.05


def test_a_planar_grid_where_everything_ties() -> None:
    points = np.c_[np.indices((25, 20)).reshape(2, -1).T, np.zeros(500, dtype=int)]
    assert relative_error(distances(PointCloud(points), 0), straight(points, 0)) < 0.04


@pytest.mark.parametrize("scale", [1e-3, 1e-6])
def test_a_dense_cluster(scale) -> None:
    """Spacings differ by orders of magnitude, and so does the heat from point to point."""
    cluster = BALL.points[SOURCE] + scale * np.random.default_rng(0).standard_normal((300, 3))
    with pytest.warns(DoubtfulDistanceWarning, match="301 of 942 points are nearer to a source"):
        distance = distances(cloud_with(cluster), apart=1e-6)  # its masses are near rounding
    assert relative_error(distance[: BALL.n], angles(BALL.points, SOURCE)) < 0.03


# --- what is refused, and what is kept ------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "argument", "expected"),
    [
        (lambda: plus(BALL, [9, 9, 9], BALL.faces[:1]), "mesh", "have a face at every vertex"),
        (lambda: plus(BALL, [], [[0, 0, 1]]), "mesh", "have three corners to a face"),
        (lambda: BALL.with_points(np.zeros((BALL.n, 3))), "geometry", "have an extent between"),
        (lambda: BALL.with_points(1e-160 * BALL.points), "geometry", "have an extent between"),
        (lambda: BALL.with_points(1e160 * BALL.points), "geometry", "have an extent between"),
        (lambda: cloud_with(BALL.points[:1]), "geometry", "have distinct points"),
        (lambda: PointCloud(np.eye(3)), "geometry", "have at least 4 points"),
    ],
)
def test_geometries_that_are_refused(make, argument, expected) -> None:
    refused(argument, expected, HeatGeodesics, make())


@pytest.mark.parametrize("geometry", [BODIES["animal"], BALL.as_cloud()], ids=repr)
def test_an_interrupted_solve_keeps_what_it_has(geometry) -> None:
    geodesics = HeatGeodesics(geometry, solver=Iterative(max_iterations=1))
    with pytest.raises(ConvergenceError, match="partial") as caught:
        geodesics.distance(SOURCE)
    partial = caught.value.partial
    assert partial.poisson.iterations == 1
    assert not partial.poisson.converged
    assert np.isfinite(partial.distance).all()
    assert partial.distance[SOURCE] == 0
    assert partial.heat.backward_error <= 1e-10
