"""`delaunay_laplacian` of clouds, and the kernels under it."""

import numpy as np
import pytest
import robust_laplacian as library
from conftest import ball, refused
from scipy import sparse
from scipy.spatial import Delaunay

from spectra_kit import (
    ConvergenceError,
    Dense,
    Laplacian,
    PointCloud,
    TriangleMesh,
    cotan_laplacian,
    eigensolve,
    robust_laplacian,
)
from spectra_kit.geometry import rectangle, sphere, torus
from spectra_kit.operators import _gluing, delaunay_laplacian, oriented_triangles


def square(n: int, seed: int = 0) -> np.ndarray:
    return np.c_[np.random.default_rng(seed).random((n, 2)), np.zeros(n)]


def grid(nx: int, ny: int) -> np.ndarray:
    x, y = np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij")
    return np.c_[x.ravel(), y.ravel(), np.zeros(nx * ny)].astype(float)


def eigenvalues(points: np.ndarray, k: int = 26, build=delaunay_laplacian) -> np.ndarray:
    return eigensolve(build(PointCloud(points)), k).eigenvalues


def error(points: np.ndarray, exact: np.ndarray, **options) -> float:
    """Mean relative error of the eigenvalues after the first."""
    return np.abs(eigenvalues(points, len(exact), **options)[1:] / exact[1:] - 1).mean()


def tufted(cloud: PointCloud) -> Laplacian:
    """The operator of the library robust_laplacian."""
    stiffness, mass = library.point_cloud_laplacian(np.array(cloud.points))
    return Laplacian(stiffness, mass, cloud.points)


CLOUDS = {
    "ball": lambda: ball(800),
    "square": lambda: square(800),
    "two balls": lambda: np.vstack([ball(400), 0.5 * ball(300, 1) + [3, 0, 0]]),
    "thin sheets": lambda: np.vstack([square(400), square(400, 1) + [0, 0, 0.02]]),
    "graded": lambda: square(800) ** [3, 1, 1],
    "volume": lambda: np.random.default_rng(0).random((500, 3)),
    "grid": lambda: grid(25, 30),
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
    exact = sphere().eigenvalues[:25]
    errors = [error(ball(n), exact) for n in (1000, 2000, 4000)]
    assert errors[2] < 0.012
    rate = -np.polyfit(np.log([1000, 2000, 4000]), np.log(errors), 1)[0]
    assert rate == pytest.approx(1.0, abs=0.25)  # in 1 / n: h^2
    # Gluing equal triangles to each other, as the library does, takes some five per cent off.
    assert errors[2] < 0.25 * error(ball(4000), exact, build=tufted)
    assert (
        eigenvalues(ball(1000), build=robust_laplacian).tolist() == eigenvalues(ball(1000)).tolist()
    )


def test_rectangle_and_torus_spectra() -> None:
    points = np.random.default_rng(0).random((4000, 3)) * [1, (1 + 5**0.5) / 2, 0]
    exact = rectangle(n=100).eigenvalues[:16]
    coarse, fine = error(points[:1000], exact), error(points, exact)
    assert fine < 0.02
    assert fine < 0.7 * coarse
    ring = torus()  # quadrangles are planar trapezoids: again four points on each circle
    assert error(np.array(ring.geometry.points), ring.eigenvalues[:16]) < 0.03


def test_same_bits_whatever_the_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    cloud = PointCloud(ball(20_000))
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
    monkeypatch.setattr(_gluing, "_FLIPS", 0)
    with pytest.raises(ConvergenceError, match="no end to them after 0; raise `mollify_factor`"):
        delaunay_laplacian(PointCloud(square(200)))
