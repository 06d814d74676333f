"""Operators of clouds on a device, and of many at once: what the host finds of each alone.

"cpu:0" plays the device: the arrays are torch's.
"""

from functools import cache

import numpy as np
import pytest
import torch
from conftest import ball, creature, refused
from launches import Launches
from test_delaunay import CLOUDS, NEAR, POINTS, grid, meridians, rings, turned

import spectra_kit as sk
from spectra_kit import PointCloud, delaunay_laplacian, laplacian, laplacian_many, robust_laplacian
from spectra_kit.errors import (
    ConvergenceError,
    InvalidInputError,
    OutOfMemoryError,
    SplitSurfaceWarning,
)
from spectra_kit.geometry import rectangle, sphere, torus
from spectra_kit.operators import _cover, _device_stars, intrinsic_delaunay, local_delaunay
from spectra_kit.operators._hulls import hulls
from spectra_kit.operators.local_delaunay import first_stars, local_triangles

DEVICE = "cpu:0"
SHAPES = CLOUDS | {
    "an animal": lambda: creature(700, seed=3).points,
    "a sphere": lambda: sphere(subdivisions=2).geometry.points,
    "a torus": lambda: torus(n=500).geometry.points,  # four points on each circle
    "a turned grid": lambda: turned(grid(12, 17)),
    "a rectangle": lambda: rectangle(n=300).geometry.points,
    "rings": lambda: rings(10, 90),  # lines, with a plane where they are near each other
    "lines": lambda: meridians(10, 80),
    "31 points": lambda: ball(31),
}


@cache
def cloud(name: str) -> PointCloud:
    return PointCloud(SHAPES[name]())


def ordered(name: str) -> tuple[np.ndarray, int]:
    one = _cover.ordered_cloud(cloud(name), 30)
    return one.points, one.n_neighbors


def assert_same(found: sk.Laplacian, host: sk.Laplacian) -> None:
    size = abs(host.stiffness).max()
    assert found.stiffness.nnz == host.stiffness.nnz
    assert abs(found.stiffness - host.stiffness).max() <= 1e-12 * size
    np.testing.assert_allclose(found.mass, host.mass, rtol=1e-12)
    np.testing.assert_array_equal(found.points, host.points)
    assert found.operator == host.operator


def in_order(triangles: np.ndarray) -> np.ndarray:
    """Where a star begins is left open; which way round it goes is not."""
    return triangles[np.lexsort(triangles.T)]


# --- the stars -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SHAPES)
def test_triangles_are_those_of_the_host(name: str) -> None:
    points, k = ordered(name)
    (first,) = _device_stars.first_stars([points], k, DEVICE)
    host = first_stars(points, k)
    np.testing.assert_array_equal(first.stars.lined, host.stars.lined)
    np.testing.assert_allclose(first.nearest, host.nearest, rtol=1e-11)
    np.testing.assert_allclose(first.farthest, host.farthest, rtol=1e-11)
    found, expected = local_triangles(points, k, first), local_triangles(points, k)
    np.testing.assert_array_equal(in_order(found[0]), in_order(expected[0]))
    np.testing.assert_array_equal(found[1], expected[1])


def test_stars_do_not_depend_on_what_else_is_in_a_batch(monkeypatch) -> None:
    names = ["an animal", "a torus", "square", "two balls", "rings"]
    clouds = [ordered(name)[0] for name in names]
    alone = [_device_stars.first_stars([points], 30, DEVICE)[0] for points in clouds]
    for entries in (_device_stars._ENTRIES, 1 << 18):  # of one block, and of many
        monkeypatch.setattr(_device_stars, "_ENTRIES", entries)
        for one, other in zip(_device_stars.first_stars(clouds, 30, DEVICE), alone, strict=True):
            np.testing.assert_array_equal(one.nearest, other.nearest)
            np.testing.assert_array_equal(one.farthest, other.farthest)
            for here, there in zip(one.stars, other.stars, strict=True):
                np.testing.assert_array_equal(here, there)


def test_a_cloud_too_large_for_all_distances_asks_a_tree(monkeypatch) -> None:
    clouds = [ordered(name)[0] for name in ("an animal", "ball")]
    expected = _device_stars.first_stars(clouds, 30, DEVICE)
    monkeypatch.setattr(_device_stars, "_NAMES", 512)
    for one, other in zip(_device_stars.first_stars(clouds, 30, DEVICE), expected, strict=True):
        np.testing.assert_array_equal(one.farthest, other.farthest)
        everywhere = np.ones(len(one.farthest), dtype=bool)
        found, triangles = (first.stars.triangles(everywhere) for first in (one, other))
        np.testing.assert_array_equal(found, triangles)


def test_of_points_at_one_distance_the_first_are_the_neighbours() -> None:
    """On any device: torch leaves open which of equal numbers it takes first."""
    corners = np.vstack([np.zeros((1, 3)), ball(12) @ np.diag([1, 1, 0])])
    corners[1:] /= np.linalg.norm(corners[1:], axis=1)[:, None]
    near = _device_stars._neighbors([corners], 5, torch.device(DEVICE))
    assert near[0].tolist() == [1, 2, 3, 4, 5]


def test_rotations_diagonalise_matrices_of_all_kinds() -> None:
    rng = np.random.default_rng(0)
    A = rng.standard_normal((400, 3, 3))
    A = A @ A.transpose(0, 2, 1)
    A[50:100] += 1e6 * np.eye(3)
    A[100:150] *= np.outer([1e-8, 1, 1], [1e-8, 1, 1])
    A[150:200] = A[150:200, 0, 0, None, None] * np.ones((3, 3))
    A[200:250] *= np.eye(3)
    A[250:300, 2] = A[250:300, :, 2] = 0
    values, V = (part.numpy() for part in _device_stars._eigh(torch.from_numpy(A)))
    size = np.abs(A).max(axis=(1, 2))
    assert (np.abs(values - np.linalg.eigvalsh(A)).max(axis=1) < 1e-14 * size).all()
    assert (np.abs(A @ V - V * values[:, None]).max(axis=(1, 2)) < 1e-14 * size).all()
    assert np.abs(V.transpose(0, 2, 1) @ V - np.eye(3)).max() < 1e-14


def test_hulls_are_those_of_the_host() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.standard_normal((2, 90, 12)) + np.linspace(0, 4, 90)[:, None]  # half of them open
    x[:30, 2::3], y[:30, 2::3] = x[:30, :-2:3] / 2, y[:30, :-2:3] / 2  # of one direction
    x[30:60, 6:], y[30:60, 6:] = x[30:60, :6], y[30:60, :6]  # twice
    x[60:, 4] = y[60:, 4] = 0  # at the origin
    x[-3:], y[-3:] = 1, np.linspace(0, 1, 36).reshape(3, 12)  # on a line
    x[-1] = y[-1] = 0
    names = np.tile(np.arange(12, dtype=np.int32), (90, 1))
    links, sizes, closed = np.empty_like(names), np.empty(90, np.int32), np.empty(90, bool)
    hulls(x, y, names, links, sizes, closed)
    found = [part.numpy() for part in _device_stars._hulls(*map(torch.from_numpy, (x, y)))]
    np.testing.assert_array_equal(found[2], closed)
    np.testing.assert_array_equal(found[1], sizes)
    for row, size in enumerate(sizes):
        np.testing.assert_array_equal(found[0][row, :size], links[row, :size])


def test_launches_and_waits_do_not_grow_with_a_batch() -> None:
    clouds, counts = [ordered(name)[0] for name in ("31 points", "grid")], []
    for times in (1, 4):
        with Launches() as launches:
            _device_stars.first_stars(clouds * times, 30, DEVICE)
        counts.append((len(launches.names), launches.waits()))
    assert counts[0] == counts[1]
    assert counts[0][1] == 0  # but for the results


# --- the operators -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def both() -> dict[str, tuple[sk.Laplacian, sk.Laplacian]]:
    """Of each shape the operator of a device, all in one call, and that of the host."""
    found = laplacian_many([cloud(name) for name in SHAPES], device=DEVICE)
    return {
        name: (one, delaunay_laplacian(cloud(name)))
        for name, one in zip(SHAPES, found, strict=True)
    }


@pytest.mark.parametrize("name", SHAPES)
def test_operators_are_those_of_the_host(name: str, both) -> None:
    found, host = both[name]
    assert_same(found, host)
    L = found.stiffness.toarray()
    size = np.abs(L).max()
    assert np.array_equal(L, L.T)
    assert np.abs(L.sum(axis=1)).max() < 1e-12 * size
    assert (L - np.diag(np.diag(L))).max() < 1e-8 * size
    if found.n < 1000:
        assert np.linalg.eigvalsh(L)[0] > -1e-12 * size
    assert found.seconds > 0


@pytest.mark.parametrize("name", ["an animal", "thin sheets", "two balls"])
def test_a_move_and_a_unit_change_nothing_else(name: str, both) -> None:
    base, scale = both[name][0], 1e6
    moved = PointCloud(scale * (turned(cloud(name).points) + [3, -7, 11]))
    other = delaunay_laplacian(moved, device=DEVICE)
    size = abs(base.stiffness).max()
    assert abs(other.stiffness - base.stiffness).max() < 1e-6 * size
    assert other.mass == pytest.approx(scale**2 * base.mass, rel=1e-6)


def test_every_call_takes_a_device_and_its_options() -> None:
    shape = cloud("an animal")
    for build in (laplacian, robust_laplacian, delaunay_laplacian):
        assert_same(build(shape, device=DEVICE), build(shape))
    options = {"n_neighbors": 45, "mollify_factor": 1e-3}
    found, host = (intrinsic_delaunay(shape, device=where, **options) for where in (DEVICE, "cpu"))
    assert_same(found.laplacian, host.laplacian)
    np.testing.assert_array_equal(found.boundary, host.boundary)
    mesh = sphere(subdivisions=2).geometry
    for build in (laplacian, robust_laplacian, delaunay_laplacian):
        assert_same(build(mesh, device=DEVICE), build(mesh))
    for operator in ("knn", "cotan"):
        assert_same(
            laplacian(mesh, operator=operator, device=DEVICE), laplacian(mesh, operator=operator)
        )


@pytest.mark.parametrize("device", ["cpu", DEVICE])
@pytest.mark.parametrize("threads", ["1", "3"])
def test_many_are_those_of_single_calls_in_the_order_given(monkeypatch, device, threads) -> None:
    monkeypatch.setenv("NUMBA_NUM_THREADS", threads)
    sheet = rectangle(n=200).geometry
    shapes = [cloud("31 points"), sheet, cloud("four"), cloud("an animal"), cloud("a torus")]
    shapes += [PointCloud(ball(n, 2)) for n in (27, 29)]  # neighbours are all others
    for found, shape in zip(laplacian_many(shapes, device=device), shapes, strict=True):
        assert_same(found, laplacian(shape))
    for options in ({"operator": "delaunay"}, {"operator": "knn"}):
        some = shapes[3:]
        for found, shape in zip(laplacian_many(some, device=device, **options), some, strict=True):
            assert_same(found, laplacian(shape, **options))
    mesh = sphere(subdivisions=2).geometry
    (found,) = laplacian_many([mesh], operator="cotan", device=device)
    assert_same(found, laplacian(mesh, operator="cotan"))
    assert laplacian_many([], device=device) == []


class There(sk.Dense):
    device = DEVICE


def test_the_host_does_not_look_for_neighbours_of_what_a_device_has(monkeypatch) -> None:
    """Nor where it is a solver that asks for the device."""
    monkeypatch.setattr(local_delaunay, "first_stars", None)
    shape, here, there = cloud("square"), sk.Dense(), There()
    plans = {solver: sk.datasets.Plan(k=5, solver=solver) for solver in (here, there)}
    for call in (
        lambda solver: delaunay_laplacian(shape, device=getattr(solver, "device", "cpu")),
        lambda solver: plans[solver].laplacian(shape),
        lambda solver: plans[solver].laplacians([shape]),
        lambda solver: sk.spectrum(shape, 5, solver),
    ):
        call(there)
        with pytest.raises(TypeError, match="not callable"):
            call(here)


# --- what is refused -----------------------------------------------------------------------------


@pytest.mark.parametrize("device", ["cpu", DEVICE])
@pytest.mark.parametrize(
    ("points", "argument", "expected"),
    [
        (POINTS[:3], "geometry", "have at least 4 points for a cloud Laplacian, got 3"),
        ([*POINTS, *POINTS[:2]], "geometry", "have distinct points, got 2 duplicate points"),
        ([*NEAR, *(POINTS + [3, 0, 0])], "geometry", "have points further apart than 1e-150"),
        (np.arange(10.0)[:, None] * [1, 2, 3], "geometry", "be a surface, got points on one line"),
    ],
)
def test_bad_clouds_are_refused_and_named(device, points, argument, expected) -> None:
    bad = PointCloud(points)
    refused(argument, expected, delaunay_laplacian, bad, device=device)
    with pytest.raises(InvalidInputError, match=expected) as caught:
        laplacian_many([cloud("an animal"), bad, bad], device=device)
    assert caught.value.where == "geometries[1]"
    assert str(caught.value).startswith("geometries[1]: `geometry` must ")


def test_a_bad_boundary_is_refused_and_named() -> None:
    for device in ("cpu", DEVICE):
        with pytest.raises(InvalidInputError, match=r"geometries\[0\]: `boundary` must be neumann"):
            laplacian_many([cloud("an animal")], boundary="dirichlet", device=device)


@pytest.mark.parametrize("device", ["nowhere", "meta", "cpu:x"])
def test_a_device_that_torch_cannot_use_is_refused(device: str) -> None:
    mesh = sphere(subdivisions=1).geometry
    for shape in (cloud("square"), mesh):
        for build in (laplacian, robust_laplacian, delaunay_laplacian):
            refused("device", "be one that torch can use here", build, shape, device=device)
    refused("device", "be one that torch can use here", laplacian_many, [mesh], device=device)


def test_a_full_device_is_told(monkeypatch) -> None:
    def full(*_: object) -> None:
        raise torch.OutOfMemoryError("CUDA out of memory.")

    monkeypatch.setattr(_device_stars, "_neighbors", full)
    with pytest.raises(OutOfMemoryError, match="leave out `device`"):
        delaunay_laplacian(cloud("square"), device=DEVICE)


def test_flips_that_do_not_end_are_named(monkeypatch) -> None:
    monkeypatch.setattr(_cover, "_FLIPS", 0)
    with pytest.raises(ConvergenceError, match=r"geometries\[0\]: .*no end to them"):
        laplacian_many([cloud("square")], device=DEVICE)


@pytest.mark.parametrize("device", ["cpu", DEVICE])
def test_a_warning_says_which_one_it_is_about(device: str) -> None:
    from test_delaunay import slices

    cut = PointCloud(slices(12, 100))
    with pytest.warns(SplitSurfaceWarning, match="and they lie as near") as caught:
        laplacian_many([cloud("an animal"), cut, cut], device=device)
    assert [str(one.message).partition(":")[0] for one in caught] == [
        "geometries[1]",
        "geometries[2]",
    ]
    assert {one.filename for one in caught} == {__file__}


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs CUDA")
def test_an_accelerator_gives_what_the_host_does(both) -> None:
    found = laplacian_many([cloud(name) for name in SHAPES], device="cuda")
    for (_, host), own in zip(both.values(), found, strict=True):
        assert_same(own, host)
