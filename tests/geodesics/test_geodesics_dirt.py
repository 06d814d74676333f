"""Dirty input: each solver finds the same right distances, or says what is wrong and what to do."""

from functools import cache

import numpy as np
import pytest
from conftest import creature

from spectra_kit.errors import ConvergenceError, DoubtfulDistanceWarning, InvalidInputError
from spectra_kit.geodesics import Direct, HeatGeodesics, Iterative, exact_distances
from spectra_kit.geometry import PointCloud, TriangleMesh, rectangle, sphere
from spectra_kit.operators import intrinsic_delaunay

SOLVERS = [Direct(), Iterative(), Iterative(coarse="none", drop=None, relaxation=0.0)]
BALL = sphere(subdivisions=3).geometry
SHEET = rectangle(n=600).geometry
BODIES = {"ball": BALL, "sheet": SHEET, "animal": creature(1500, seed=0)}
SOURCE = 5


def distances(geometry: TriangleMesh | PointCloud, sources=SOURCE) -> np.ndarray:
    """Measure by each solver, and return what they agree on."""
    triangulation = intrinsic_delaunay(geometry)  # what each would make of it
    fields = [
        HeatGeodesics(triangulation, solver=solver).distance(sources).distance for solver in SOLVERS
    ]
    reached = np.isfinite(fields[0])
    assert (fields[0] >= 0).all()  # so not NaN either
    for field in fields[1:]:
        np.testing.assert_array_equal(np.isfinite(field), reached)
        assert np.abs(field[reached] - fields[0][reached]).max() <= 1e-7 * fields[0][reached].max()
    return fields[0]


def relative_error(distance: np.ndarray, truth: np.ndarray) -> float:
    away = (truth > 0) & np.isfinite(truth)
    np.testing.assert_array_equal(np.isfinite(distance), np.isfinite(truth))
    return float((np.abs(distance[away] - truth[away]) / truth[away]).mean())


def angles(points: np.ndarray) -> np.ndarray:
    """Return the distances on the unit sphere from its point number SOURCE."""
    return np.arccos(np.clip(points @ points[SOURCE], -1, 1))


def plus(mesh: TriangleMesh, points, faces) -> TriangleMesh:
    return TriangleMesh(
        np.vstack([mesh.points, np.reshape(points, (-1, 3))]), np.vstack([mesh.faces, faces])
    )


# --- faces that should not be there ---------------------------------------------------------------


def with_caps(mesh, rng):
    """Faces whose three corners lie on one line, their tips on edges that know nothing of them."""
    edges = rng.choice(mesh.unique_edges[0], 20, replace=False)
    share = rng.random((20, 1))
    tips = share * mesh.points[edges[:, 0]] + (1 - share) * mesh.points[edges[:, 1]]
    return plus(mesh, tips, np.column_stack([edges, mesh.n + np.arange(20)]))


def with_needles(mesh, rng):
    """Faces of two corners at one place."""
    edges = rng.choice(mesh.unique_edges[0], 20, replace=False)
    return plus(mesh, mesh.points[edges[:, 0]], np.column_stack([edges, mesh.n + np.arange(20)]))


def with_fins(mesh, rng):
    """Edges of three faces."""
    edges = rng.choice(mesh.unique_edges[0], 20, replace=False)
    tips = 1.5 * mesh.points[edges[:, 0]] + 0.1
    return plus(mesh, tips, np.column_stack([edges, mesh.n + np.arange(20)]))


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
    return TriangleMesh(
        mesh.points, mesh.faces[rng.random(len(mesh.faces)) < 0.8]
    ).without_unreferenced()


def with_noise(mesh, rng):
    edge = np.linalg.norm(np.diff(mesh.points[mesh.unique_edges[0]], axis=1), axis=2).mean()
    return mesh.with_points(mesh.points + 0.2 * edge * rng.standard_normal((mesh.n, 3)))


DIRT = [
    with_caps, with_needles, with_fins, with_shrunk_faces, with_duplicates, with_mixed_winding,
    with_holes, with_noise,
]  # fmt: skip


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("make", DIRT, ids=lambda make: make.__name__)
def test_dirty_meshes_have_right_distances(make, body, seed) -> None:
    mesh = make(BODIES[body], np.random.default_rng(seed))
    assert relative_error(distances(mesh), exact_distances(mesh, SOURCE)) < 0.06


@pytest.mark.parametrize("seed", [0, 18, 19, 20, 24, 34])  # in which no face turns over
def test_exact_distances_across_faces_without_area_are_straight(seed) -> None:
    """Edges inside a flat sheet shrink to points: it stays a flat sheet."""
    rng = np.random.default_rng(seed)
    inside = ~np.isin(SHEET.unique_edges[0], SHEET.boundary_vertices).any(axis=1)
    points = SHEET.points.copy()
    for a, b in rng.choice(SHEET.unique_edges[0][inside], 20, replace=False):
        points[b] = points[a]
    mesh, source = SHEET.with_points(points), int(rng.integers(SHEET.n))
    straight = np.linalg.norm(points - points[source], axis=1)
    np.testing.assert_allclose(exact_distances(mesh, source), straight, atol=1e-9)


def test_winding_is_of_no_importance() -> None:
    turned = with_mixed_winding(BALL, np.random.default_rng(0))
    assert np.abs(distances(turned) - distances(BALL)).max() < 1e-9


def test_sheets_through_everything() -> None:
    """Random triangles across the body: what the heat method makes of shortcuts is rough."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        extra = np.array([rng.choice(BALL.n, 3, replace=False) for _ in range(30)])
        mesh = plus(BALL, [], extra)
        assert relative_error(distances(mesh), exact_distances(mesh, SOURCE)) < 0.2


def test_a_moebius_strip() -> None:
    n, w = 60, 9
    u, v = np.meshgrid(np.arange(n) * 2 * np.pi / n, np.linspace(-0.3, 0.3, w), indexing="ij")
    r = 1 + v * np.cos(u / 2)
    points = np.stack([r * np.cos(u), r * np.sin(u), v * np.sin(u / 2)], axis=-1).reshape(-1, 3)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n), np.arange(w - 1), indexing="ij"))
    a, b = w * i + j, w * i + j + 1
    last = i == n - 1  # meets the beginning upside down
    c, d = np.where(last, w - 1 - j, a + w), np.where(last, w - 2 - j, b + w)
    strip = TriangleMesh(points, np.vstack([np.column_stack(f) for f in ((a, c, b), (b, c, d))]))
    middle = w // 2
    distance = distances(strip, middle)
    assert relative_error(distance, exact_distances(strip, middle)) < 0.06
    # Around once, each line across is as far as the one that mirrors it.
    across = distance.reshape(n, w)
    np.testing.assert_allclose(across[1:], across[:0:-1, ::-1], rtol=0.05)


def test_triangle_soup_is_as_many_components_as_triangles() -> None:
    soup = TriangleMesh(
        BALL.points[BALL.faces].reshape(-1, 3), np.arange(3 * len(BALL.faces)).reshape(-1, 3)
    )
    distance = distances(soup)
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(distance)), [3, 4, 5])
    merged = soup.with_merged_vertices()
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


@cache
def of_the_ball() -> tuple[np.ndarray, np.ndarray]:
    """Return the distances on the mesh and on the cloud."""
    return distances(BALL), distances(BALL.as_cloud())


@pytest.mark.parametrize("factor", [1e-30, 1e-8, 1e8, 1e30])
@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_any_unit_and_any_place(factor, offset) -> None:
    for geometry, expected in zip((BALL, BALL.as_cloud()), of_the_ball(), strict=True):
        moved = geometry.with_points((geometry.points + offset) * factor)
        assert np.abs(distances(moved) / factor - expected).max() < 1e-6


@pytest.mark.parametrize("axes", [(1e2, 1, 1), (1e4, 1, 1), (1, 1, 1e-2), (1, 1, 1e-5)])
def test_long_or_flat_bodies(axes) -> None:
    mesh = BALL.with_points(BALL.points * axes)
    assert relative_error(distances(mesh), exact_distances(mesh, SOURCE)) < 0.05


@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("length", [1e2, 1e4])
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
@pytest.mark.parametrize("body", BODIES)
def test_each_part_has_distances_as_if_it_were_alone(body, size) -> None:
    mesh = BODIES[body]
    both = plus(mesh, size * mesh.points + 9, mesh.faces + mesh.n)
    alone = distances(mesh)
    together = distances(both, [SOURCE, mesh.n + SOURCE])
    rounding = 1e-7 if size > 1 else 1e-6  # of the coordinates, beside the 9
    assert np.abs(together[: mesh.n] - alone).max() < 1e-7 * alone.max()
    assert np.abs(together[mesh.n :] / size - alone).max() < rounding * alone.max()


def test_details_that_the_step_blurs_are_warned_of() -> None:
    fine = 1e-3 * BALL.points  # joined to edges a thousand times as long, too many for outliers
    rng = np.random.default_rng(0)
    far = rng.choice(BALL.n, 200, replace=False)
    fine[far] *= 1e3
    with pytest.warns(DoubtfulDistanceWarning, match=r"nearer to a source .* blurred.*lower"):
        HeatGeodesics(BALL.with_points(fine)).distance(int(np.setdiff1d(range(BALL.n), far)[0]))


def test_rounding_that_spoils_the_answer_is_said() -> None:
    needles = SHEET.with_points(SHEET.points * [1e5, 1, 1])
    for solver in SOLVERS:
        with pytest.raises((InvalidInputError, ConvergenceError), match=r"residual|rounding"):
            HeatGeodesics(needles, solver=solver).distance(SOURCE)


# --- point clouds ---------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 5, 20])
def test_a_cloud_with_outliers(count) -> None:
    out = np.random.default_rng(0).standard_normal((count, 3))
    out *= 3 / np.linalg.norm(out, axis=1, keepdims=True)
    distance = distances(PointCloud(np.vstack([BALL.points, out])))
    assert relative_error(distance[: BALL.n], angles(BALL.points)) < 0.07


@pytest.mark.parametrize("gap", [0.5, 0.01, 1e-4])
def test_a_cloud_of_two_sheets(gap) -> None:
    """Farther apart than the points of each they are two components, nearer they are one sheet."""
    flat = np.linalg.norm(SHEET.points - SHEET.points[SOURCE], axis=1)
    distance = distances(PointCloud(np.vstack([SHEET.points, SHEET.points + [0, 0, gap]])))
    assert relative_error(distance[: SHEET.n], flat) < 0.05
    if gap == 0.5:
        assert np.isinf(distance[SHEET.n :]).all()
    else:
        assert relative_error(distance[SHEET.n :], flat) < 0.05


@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.int32])
def test_a_planar_grid_where_everything_ties(dtype) -> None:
    x, y = np.meshgrid(np.arange(25), np.arange(20), indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()]).astype(dtype)
    distance = distances(PointCloud(points), 0)
    assert relative_error(distance, np.hypot(*points[:, :2].T)) < 0.04


def test_noisy_clouds_and_clouds_in_two_parts() -> None:
    rng = np.random.default_rng(0)
    noisy = distances(PointCloud(BALL.points * (1 + 0.05 * rng.standard_normal((BALL.n, 1)))))
    assert relative_error(noisy, angles(BALL.points)) < 0.09
    two = distances(PointCloud(np.vstack([BALL.points, BALL.points + [50, 0, 0]])))
    truth = np.concatenate([angles(BALL.points), np.full(BALL.n, np.inf)])
    assert relative_error(two, truth) < 0.03
    nearly_twice = distances(PointCloud(np.vstack([BALL.points, BALL.points[:5] * (1 + 1e-15)])))
    assert relative_error(nearly_twice[: BALL.n], angles(BALL.points)) < 0.03


@pytest.mark.parametrize("scale", [1e-3, 1e-6])
def test_a_dense_cluster(scale) -> None:
    """Spacings differ by orders of magnitude, and so does the heat from point to point."""
    rng = np.random.default_rng(0)
    cluster = BALL.points[SOURCE] + scale * rng.standard_normal((300, 3))
    cloud = PointCloud(np.vstack([BALL.points, cluster]))
    with pytest.warns(DoubtfulDistanceWarning, match="301 of 942 points are nearer to a source"):
        distance = distances(cloud)
    assert relative_error(distance[: BALL.n], angles(BALL.points)) < 0.03


# --- what is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: plus(BALL, [9, 9, 9], BALL.faces[:1]), "without_unreferenced"),
        (lambda: plus(BALL, [], [[0, 0, 1]]), "without_degenerate_faces"),
        (lambda: BALL.with_points(np.zeros((BALL.n, 3))), "must have an extent"),
        (lambda: BALL.with_points(1e-160 * BALL.points), "must have an extent between"),
        (lambda: BALL.with_points(1e160 * BALL.points), "must have an extent between"),
        (lambda: BALL.with_points(np.where(BALL.points > 0.99, np.nan, 0)), "must be finite"),
        (lambda: BALL.with_points(np.where(BALL.points > 0.99, np.inf, 0)), "must be finite"),
        (lambda: PointCloud(np.vstack([BALL.points, BALL.points[:1]])), "without_duplicates"),
        (lambda: PointCloud(BALL.points * [1, 0, 0]), "duplicate point|on one line"),
        (lambda: PointCloud(np.eye(3)), "at least 4 points"),
    ],
)
def test_geometries_that_are_refused(make, message) -> None:
    for solver in SOLVERS:
        with pytest.raises(InvalidInputError, match=message):
            HeatGeodesics(make(), solver=solver)


# --- arrays and sources ---------------------------------------------------------------------------


@pytest.mark.parametrize("solver", SOLVERS[:2], ids=["direct", "iterative"])
def test_the_kind_of_array_does_not_matter(solver) -> None:
    points = np.asarray(BALL.points, dtype=np.float32)
    wanted = HeatGeodesics(TriangleMesh(points, BALL.faces), solver=solver).distance(SOURCE)
    frozen = points.copy()
    frozen.flags.writeable = False
    for coordinates in (points.astype(float), np.asfortranarray(points), frozen, points.tolist()):
        for dtype in (np.int32, np.uint64, np.int16):
            faces = np.asfortranarray(BALL.faces.astype(dtype))
            kept = np.array(coordinates), faces.copy()
            mesh = TriangleMesh(coordinates, faces)
            found = HeatGeodesics(mesh, solver=solver).distance(SOURCE)
            np.testing.assert_array_equal(found.distance, wanted.distance)
            np.testing.assert_array_equal(np.array(coordinates), kept[0])
            np.testing.assert_array_equal(faces, kept[1])


def test_weights_of_any_size_in_any_unit() -> None:
    for unit, weights in ((1e100, [1e300, 1e300]), (1e-100, [1e-300, 1e-300])):
        body = BALL.with_points(unit * BALL.points)
        one = HeatGeodesics(body).distance([SOURCE, 300], weights=weights).distance
        other = HeatGeodesics(BALL).distance([SOURCE, 300]).distance
        assert np.abs(one / unit - other).max() < 1e-7 * other.max()


def test_weights_of_any_size_keep_the_answer_right() -> None:
    away = int(np.argmax(angles(BALL.points)))
    even = distances(BALL, [SOURCE, away])
    for scale in (1e-300, 1e300):
        found = HeatGeodesics(BALL).distance([SOURCE, away], weights=[scale, scale]).distance
        assert np.abs(found - even).max() < 1e-9


# --- interrupted ----------------------------------------------------------------------------------


@pytest.mark.parametrize("geometry", [BALL, BODIES["animal"], BALL.as_cloud()], ids=repr)
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
