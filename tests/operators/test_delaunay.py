"""`delaunay_laplacian` of clouds, and the kernels under it."""

from copy import copy

import numpy as np
import pytest
import robust_laplacian as library
from conftest import ball, refused
from scipy import sparse
from scipy.spatial import ConvexHull, Delaunay

from spectra_kit import (
    Dense,
    Laplacian,
    PointCloud,
    TriangleMesh,
    cotan_laplacian,
    eigensolve,
    knn_laplacian,
    robust_laplacian,
)
from spectra_kit.errors import ConvergenceError, SplitSurfaceWarning
from spectra_kit.geometry import rectangle, sphere, torus
from spectra_kit.operators import (
    _cover,
    delaunay_laplacian,
    intrinsic_delaunay,
    local_delaunay,
    oriented_triangles,
)
from spectra_kit.operators._hulls import hulls
from spectra_kit.operators._planes import project


def square(n: int, seed: int = 0) -> np.ndarray:
    return np.c_[np.random.default_rng(seed).random((n, 2)), np.zeros(n)]


def grid(nx: int, ny: int) -> np.ndarray:
    x, y = np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij")
    return np.c_[x.ravel(), y.ravel(), np.zeros(nx * ny)].astype(float)


def error(points: np.ndarray, exact: np.ndarray, build=delaunay_laplacian) -> float:
    """Mean relative error of the eigenvalues after the first."""
    found = eigensolve(build(PointCloud(points)), len(exact)).eigenvalues
    return np.abs(found[1:] / exact[1:] - 1).mean()


def tufted(cloud: PointCloud) -> Laplacian:
    """The operator of the library robust_laplacian."""
    stiffness, mass = library.point_cloud_laplacian(np.array(cloud.points))
    return Laplacian(stiffness, mass, cloud.points)


CLOUDS = {
    "ball": lambda: ball(400),
    "square": lambda: square(400),
    "two balls": lambda: np.vstack([ball(200), 0.5 * ball(150, 1) + [5, 0, 0]]),
    "thin sheets": lambda: np.vstack([square(200), square(200, 1) + [0, 0, 0.03]]),
    "graded": lambda: square(400) ** [3, 1, 1],
    "volume": lambda: np.random.default_rng(0).random((300, 3)),
    "grid": lambda: grid(15, 20),
    "four": lambda: np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.1]]),
}


@pytest.mark.parametrize("name", CLOUDS)
def test_semi_definite_with_constant_kernel_and_weights_of_one_sign(name: str) -> None:
    L = delaunay_laplacian(PointCloud(CLOUDS[name]()))
    dense = L.stiffness.toarray()
    size = np.abs(dense).max()
    assert np.array_equal(dense, dense.T)
    assert np.abs(dense.sum(axis=1)).max() < 1e-12 * size
    assert np.linalg.eigvalsh(dense)[0] > -1e-12 * size
    assert (dense - np.diag(np.diag(dense))).max() < 1e-8 * size
    assert (L.mass > 0).all()
    assert L.kernel_dimension == L.n_components == (2 if name == "two balls" else 1)


def test_in_the_plane_it_is_the_cotangent_laplacian_of_the_delaunay_triangulation() -> None:
    points = square(700)
    mesh = TriangleMesh(points, Delaunay(points[:, :2]).simplices)
    expected = cotan_laplacian(mesh)
    got = delaunay_laplacian(PointCloud(points), n_neighbors=60)
    # Slivers along the boundary have neighbours farther off than those that vote.
    inner = (np.abs(points[:, :2] - 0.5) < 0.35).all(axis=1)
    difference = (got.stiffness - sparse.csr_array(expected.stiffness))[inner]
    assert inner.sum() > 300
    assert abs(difference).max() < 2e-3  # the mollification of needles


def test_squares_are_cut_the_same_way_by_all_their_corners() -> None:
    # All circles of a grid pass through four points. Both diagonals have the weight zero.
    points = grid(20, 30)
    L = delaunay_laplacian(PointCloud(points))
    assert L.area == pytest.approx(19 * 29, rel=1e-9)
    interior = L.stiffness[20 * 15 + 10].toarray().ravel()
    assert sorted(np.round(interior[np.abs(interior) > 1e-6], 4)) == [-1, -1, -1, -1, 4]


def test_sphere_spectrum_and_rate() -> None:
    exact = sphere().eigenvalues[:16]
    errors = [error(ball(n), exact) for n in (1000, 2000, 4000)]
    assert errors[2] < 0.012
    rate = -np.polyfit(np.log([1000, 2000, 4000]), np.log(errors), 1)[0]
    assert rate == pytest.approx(1.0, abs=0.25)  # in 1 / n: h^2
    # Gluing equal triangles to each other, as the library does, takes some five per cent off.
    assert errors[2] < 0.25 * error(ball(4000), exact, build=tufted)
    one, other = (build(PointCloud(ball(500))) for build in (delaunay_laplacian, robust_laplacian))
    assert (one.stiffness != other.stiffness).nnz == 0
    np.testing.assert_array_equal(one.mass, other.mass)


def test_rectangle_and_torus_spectra() -> None:
    points = np.random.default_rng(0).random((4000, 3)) * [1, (1 + 5**0.5) / 2, 0]
    exact = rectangle(n=100).eigenvalues[:16]
    coarse, fine = error(points[:1000], exact), error(points, exact)
    assert fine < 0.02
    assert fine < 0.7 * coarse
    ring = torus()  # quadrangles are planar trapezoids: again four points on each circle
    assert error(np.array(ring.geometry.points), ring.eigenvalues[:16]) < 0.03


# --- points along lines ---


def rings(count: int, points: int, *, turn: float = 2.4) -> np.ndarray:
    """Of the unit sphere, at equal angles from pole to pole, each turned against the one before."""
    along = 2 * np.pi * np.arange(points) / points
    ring = np.arange(1, count + 1)[:, None]
    up = np.pi * ring / (count + 1) - np.pi / 2
    along = along + turn * ring
    height = np.broadcast_to(np.sin(up), along.shape)
    circle = np.cos(up)[..., None] * np.stack([np.cos(along), np.sin(along)], axis=-1)
    return np.concatenate([circle, height[..., None]], axis=-1).reshape(-1, 3)


def helix(turns: int, points: int) -> np.ndarray:
    at = (np.arange(turns * points) + 0.5) / (turns * points)
    up, along = np.pi * (at - 0.5), 2 * np.pi * turns * at
    return np.c_[np.cos(up) * np.cos(along), np.cos(up) * np.sin(along), np.sin(up)]


def slices(count: int, points: int) -> np.ndarray:
    """Horizontal cuts of a torus of radii 1 and 0.4: two circles at each height."""
    along = 2 * np.pi * np.arange(points) / points
    height = 0.4 * np.linspace(-1, 1, count + 2)[1:-1]
    half = np.sqrt(0.16 - height**2)
    radii, heights = np.concatenate([1 - half, 1 + half]), np.concatenate([height, height])
    circle = np.stack([np.cos(along), np.sin(along), 0 * along], axis=-1)
    return (radii[:, None, None] * circle + heights[:, None, None] * [0, 0, 1]).reshape(-1, 3)


def meridians(count: int, points: int) -> np.ndarray:
    """Circles around the tube of the same torus."""
    u, v = np.meshgrid(*(2 * np.pi * np.arange(m) / m for m in (count, points)), indexing="ij")
    out = 1 + 0.4 * np.cos(v)
    return np.stack([out * np.cos(u), out * np.sin(u), 0.4 * np.sin(v)], axis=-1).reshape(-1, 3)


def turned(points: np.ndarray) -> np.ndarray:
    axes = np.linalg.qr(np.random.default_rng(3).standard_normal((3, 3)))[0]
    return points @ axes


def noisy(points: np.ndarray, size: float) -> np.ndarray:
    return points + size * np.random.default_rng(4).standard_normal(points.shape)


BALL, WIDE = [2, 2, 2, 6, 6], [1, 1.4, 0.7]
SCANS = {
    "rings": (lambda: rings(18, 225), BALL, 4 * np.pi),
    "dense rings": (lambda: turned(rings(18, 600)), BALL, 4 * np.pi),
    "noisy rings": (lambda: noisy(rings(18, 300), 1.5e-3), BALL, 4 * np.pi),
    "a helix": (lambda: turned(helix(18, 300)), BALL, 4 * np.pi),
    "two balls": (
        lambda: np.vstack([rings(18, 225), rings(18, 225) + [2.4, 0, 0]]),
        [0, *BALL[:3] * 2][:5],
        8 * np.pi,
    ),
    "an ellipsoid": (lambda: turned(rings(22, 360) * WIDE), "ellipsoid", None),
    "a torus": (lambda: turned(meridians(18, 150)), "torus", 1.6 * np.pi**2),
    "lines on a sheet": (lambda: turned(grid(300, 15) * [1 / 299, 1 / 15, 0]), "sheet", 14 / 15),
}


@pytest.mark.parametrize("name", SCANS)
def test_points_along_lines_are_one_surface(name: str) -> None:
    build, truth, area = SCANS[name]
    if truth == "sheet":  # of 1 by its area
        i, j = np.mgrid[:4, :4]
        truth = np.sort(np.pi**2 * (i**2 + (j / area) ** 2), axis=None)[1:6]
    elif truth == "torus":
        truth = torus(n=400, major=1.0, minor=0.4).eigenvalues[1:6]
    elif truth == "ellipsoid":
        fine = sphere(subdivisions=4).geometry
        fine = robust_laplacian(TriangleMesh(fine.points * WIDE, fine.faces))
        truth, area = eigensolve(fine, 6).eigenvalues[1:], fine.area
    built = delaunay_laplacian(PointCloud(build()))
    assert built.n_components == 1 + (name == "two balls")
    assert built.area == pytest.approx(area, rel=0.03)
    found = eigensolve(built, 6).eigenvalues[1:]
    assert found == pytest.approx(np.array(truth, dtype=float), rel=0.05, abs=1e-6)


@pytest.mark.parametrize("k", [3, 30, 960])
def test_hulls_around_the_origin_are_those_of_qhull(k: int) -> None:
    rng = np.random.default_rng(k)
    x, y = rng.standard_normal((2, 50, k)) + np.linspace(0, 4, 50)[:, None]  # half of them open
    x[:, 2::3], y[:, 2::3] = x[:, :-2:3] / 2, y[:, :-2:3] / 2  # of one direction
    names = np.tile(np.arange(k, dtype=np.int32), (50, 1))
    links, sizes, closed = np.empty_like(names), np.empty(50, np.int32), np.empty(50, bool)
    hulls(x, y, names, links, sizes, closed)
    for row in range(50):
        corners = ConvexHull(np.vstack([np.c_[x[row], y[row]], [0, 0]])).vertices  # k: the origin
        assert closed[row] == (k not in corners)
        start = np.flatnonzero(corners == k if k in corners else corners == links[row, 0])[0]
        around = np.roll(corners, -start)[int(k in corners) :]
        assert list(links[row, : sizes[row]]) == list(around)


@pytest.mark.parametrize("thick", [0.0, 1e-9, 0.3, 1.0])
def test_neighbours_are_projected_to_the_plane_of_least_spread(thick: float) -> None:
    """As LAPACK finds it: of flat, thin and round neighbourhoods, and of lines."""
    rng = np.random.default_rng(0)
    points = rng.standard_normal((400, 3)) * [1, 1e-4, 1e-4 * thick]
    points[:300] = rng.standard_normal((300, 3)) * [1, 0.7, thick / 2]
    points[200:300] *= [1, 0.05, 0.05]  # a strip: some of it as narrow as a line
    points[:, 0] += np.repeat([0, 50, 100], [200, 100, 100])
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    points = points @ turn.T
    distances = np.linalg.norm(points[:, None] - points, axis=2)
    near = np.argsort(distances, axis=1)[:, 1:13].astype(np.int32)
    ties, rows = 1e-3 * distances[np.arange(400), near[:, 0]] ** 2 * rng.random(400), np.arange(400)
    x, y, lined = np.empty((400, 12)), np.empty((400, 12)), np.empty(400, dtype=bool)
    project(points, ties, rows, near, x, y, lined)
    assert lined[300:].mean() > 0.9
    assert lined[:200].mean() < 0.1
    for i in rows:
        offsets = points[near[i]] - points[i]
        z = np.square(offsets).sum(axis=1)
        weights = (1 - z / (1.001 * z.max())) ** 2
        mean = weights @ offsets / (1 + weights.sum())
        moments = (weights[:, None] * offsets).T @ offsets - (1 + weights.sum()) * np.outer(
            mean, mean
        )
        spreads, axes = np.linalg.eigh(moments)
        across = spreads[1] - spreads[0] < 0.05 * spreads[2] and spreads[1] < 0.12 * spreads[2]
        assert lined[i] == across
        if min(np.diff(spreads)) < 1e-6 * spreads[2]:
            continue  # any axes will do
        z += ties[i] - ties[near[i]]
        normal = axes[:, 0] * np.sign(axes[np.abs(axes[:, 0]).argmax(), 0])
        frame = np.column_stack([axes[:, 2], np.cross(normal, axes[:, 2])])
        expected, found = offsets @ frame / z[:, None], np.column_stack([x[i], y[i]])
        found *= np.sign(np.sum(found * expected))  # a half turn says nothing
        np.testing.assert_allclose(found, expected, atol=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("shape", [sphere(subdivisions=2).geometry, PointCloud(ball(300))])
def test_the_cover_with_less_ado_has_the_same_operator(shape) -> None:
    cover, laplacian = _cover.plain_cover(shape), delaunay_laplacian(shape)
    np.testing.assert_array_equal(cover.stiffness.toarray(), laplacian.stiffness.toarray())
    np.testing.assert_array_equal(cover.mass, laplacian.mass)


@pytest.mark.parametrize("name", CLOUDS)
def test_what_it_leaves_unchecked_holds(name: str) -> None:
    cloud = PointCloud(CLOUDS[name]())
    found = intrinsic_delaunay(cloud)
    L, again = found.laplacian, copy(found.laplacian)  # through the constructor, which checks
    for part in ("data", "indices", "indptr"):
        one, other = (getattr(made.stiffness, part) for made in (L, again))
        np.testing.assert_array_equal(one, other, strict=True)
        assert not one.flags.writeable
    assert set(vars(again)) <= set(vars(L))
    for part in ("mass", "points", "fixed", "component_labels"):
        np.testing.assert_array_equal(getattr(L, part), getattr(again, part), strict=True)
        assert not getattr(L, part).flags.writeable
    for part in ("corners", "lengths", "boundary"):
        one, other = (getattr(made, part) for made in (found, copy(found)))
        np.testing.assert_array_equal(one, other, strict=True)
        assert not one.flags.writeable


def test_points_that_differ_by_the_sign_of_a_zero_are_one() -> None:
    refused("geometry", "have distinct", delaunay_laplacian, [*POINTS, [0.0, 2, 2], [-0.0, 2, 2]])


def test_parts_that_look_like_lines_of_one_surface_are_told() -> None:
    cut = PointCloud(slices(24, 200))  # flat at top and bottom, with nothing between two circles
    with pytest.warns(SplitSurfaceWarning, match="and they lie as near"):
        assert delaunay_laplacian(cut).n_components == 2
    with pytest.warns(SplitSurfaceWarning, match="raise `n_neighbors` above 20"):
        assert knn_laplacian(PointCloud(rings(24, 400))).n_components > 1
    sheets = PointCloud(np.vstack([grid(30, 30), grid(30, 30) + [0, 0, 2.5]]))
    with pytest.warns(SplitSurfaceWarning, match="2 parts"):
        knn_laplacian(sheets, n_neighbors=4)


def test_parts_far_from_each_other_are_parts() -> None:
    apart = PointCloud(np.vstack([ball(600), ball(600, 1) + [4, 0, 0], grid(20, 20) / 9 + 5]))
    for build in (delaunay_laplacian, knn_laplacian):  # a warning would be an error
        assert build(apart).n_components == 3


def test_same_bits_whatever_the_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (_cover, local_delaunay):  # so that a small cloud is of many tasks
        monkeypatch.setattr(module, "_BLOCK", 256)
    cloud = PointCloud(ball(2000))
    found = []
    for count in (1, 3):
        monkeypatch.setenv("NUMBA_NUM_THREADS", str(count))
        found.append(delaunay_laplacian(cloud))
    one, three = found
    assert np.array_equal(one.stiffness.data, three.stiffness.data)
    assert np.array_equal(one.mass, three.mass)


def test_nearly_coincident_points() -> None:
    points = ball(500)
    twins = points[:20] * (1 + 1e-9)
    L = delaunay_laplacian(PointCloud(np.vstack([points, twins])))
    assert np.isfinite(L.stiffness.data).all()
    assert L.n_components == 1
    exact = eigensolve(L, 9, Dense()).eigenvalues
    assert exact[1:] == pytest.approx(sphere().eigenvalues[1:9], rel=0.15)


POINTS = ball(50)
LINE = [5, 0, 0] + np.arange(90.0)[:, None] * [0.01, 0, 0]
NEAR = [[1e-170, 0, 0], [0, 1e-170, 0], [0, 0, 0]]


@pytest.mark.parametrize(
    ("points", "options", "argument", "expected"),
    [
        (POINTS, {"mollify_factor": 0}, "mollify_factor", "be positive"),
        (POINTS, {"n_neighbors": 2}, "n_neighbors", "be at least 3"),
        (POINTS[:3], {}, "geometry", "have at least 4 points for a cloud Laplacian, got 3"),
        ([*POINTS, *POINTS[:2]], {}, "geometry", "have distinct points, got 2 duplicate points"),
        (np.arange(10.0)[:, None] * [1, 2, 3], {}, "geometry", "be a surface, got points on one"),
        ([*POINTS, *LINE], {}, "geometry", "have triangles at all points"),
        ([*NEAR, *(POINTS + [3, 0, 0])], {}, "geometry", "have points further apart than 1e-150"),
    ],
)
def test_bad_input(points, options, argument, expected) -> None:
    refused(argument, expected, delaunay_laplacian, PointCloud(points), **options)
    if not options and len(points) != 140:
        refused(argument, expected, oriented_triangles, PointCloud(points))


def test_flips_that_do_not_end_are_given_up(monkeypatch) -> None:
    monkeypatch.setattr(_cover, "_FLIPS", 0)
    with pytest.raises(ConvergenceError, match="no end to them after 0; raise `mollify_factor`"):
        delaunay_laplacian(PointCloud(square(200)))
