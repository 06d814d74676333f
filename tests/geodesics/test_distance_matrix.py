"""Distances from many sources: blocks against single calls, truths, memory maps, and bad input."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from conftest import creature, joined, moved, refused, two_parts
from geodesic_truths import angles, straight

from spectra_kit.errors import DoubtfulDistanceWarning
from spectra_kit.geodesics import (
    Direct,
    FacePoint,
    HeatGeodesics,
    Iterative,
    distance_matrix,
    exact_distances,
)
from spectra_kit.geometry import TriangleMesh, rectangle, sphere

# Of what is coarse, and compared with itself alone.
coarse = pytest.mark.filterwarnings("ignore:.*triangles are too large")
SOURCES = [*range(0, 500, 50), [3, 4], FacePoint(7, (0.2, 0.3, 0.5))]


def same_fields(one, other) -> None:
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a.distance, b.distance)
        np.testing.assert_array_equal(a.heat.log, b.heat.log)
        np.testing.assert_array_equal(a.poisson.x, b.poisson.x)
        np.testing.assert_array_equal(a.poisson.residual_norms, b.poisson.residual_norms)
        assert a.heat.backward_error == b.heat.backward_error


# --- fields in blocks ---


@coarse
@pytest.mark.parametrize("threads", ["1", "3"])
@pytest.mark.parametrize("solver", [Direct(), Iterative()], ids=["direct", "iterative"])
def test_fields_of_blocks_are_those_of_single_calls_bit_by_bit(
    monkeypatch, solver, threads
) -> None:
    heat = HeatGeodesics(creature(500), solver=solver)
    alone = [heat.distance(one) for one in SOURCES]
    monkeypatch.setenv("NUMBA_NUM_THREADS", threads)
    same_fields(heat.distances(SOURCES), alone)
    assert heat.distances([]) == []


@pytest.mark.parametrize("boundary", ["neumann", "dirichlet", "average"])
def test_also_with_a_boundary_and_triangles_of_many_sizes(boundary) -> None:
    points = rectangle(n=400).geometry.points.copy()
    points[:, 0] = points[:, 0] ** 6  # sides from a hundredth of the typical edge to twenty of them
    mesh = TriangleMesh(points, rectangle(n=400).geometry.faces)
    heat = HeatGeodesics(mesh, boundary=boundary, solver=Direct())
    inner = np.setdiff1d(np.arange(mesh.n), mesh.boundary_vertices)[::9]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DoubtfulDistanceWarning)
        same_fields(heat.distances(inner), [heat.distance(one) for one in inner])


def test_also_on_several_components_whatever_the_order() -> None:
    mesh = two_parts()
    heat = HeatGeodesics(mesh)
    mixed = np.random.default_rng(0).permutation(mesh.n)[:40]
    assert len(set(heat.triangulation.laplacian.component_labels[mixed])) == 2
    same_fields(heat.distances(mixed), [heat.distance(int(one)) for one in mixed])


# --- matrices ---


@coarse
def test_rows_are_distances_from_sources() -> None:
    mesh = creature(500)
    matrix = distance_matrix(mesh, SOURCES, dtype="float64")
    heat = HeatGeodesics(mesh)
    rows = [heat.distance(one).distance for one in SOURCES]
    np.testing.assert_array_equal(matrix, rows)
    single = distance_matrix(mesh, np.arange(3))
    assert single.dtype == np.float32
    double = distance_matrix(mesh, [0, 1, 2], dtype="float64")
    np.testing.assert_array_equal(single, double.astype(np.float32))


def test_all_points_of_a_sphere_are_an_angle_apart() -> None:
    ball = sphere(subdivisions=3).geometry
    matrix = distance_matrix(ball, dtype="float64")
    truth = np.array([angles(ball.points, i) for i in range(ball.n)])
    np.testing.assert_array_equal(matrix, matrix.T)
    assert not matrix.diagonal().any()
    away = truth > 0
    assert np.abs(matrix - truth)[away].mean() < 0.03 * truth[away].mean()


@coarse
def test_the_mean_of_both_directions_is_nearer_to_exact_distances() -> None:
    mesh = creature(600)
    truth = np.array([exact_distances(mesh, i) for i in range(0, mesh.n, 40)])
    one_way = distance_matrix(mesh, dtype="float64", symmetric=False)
    mean = (one_way + one_way.T) / 2
    errors = [np.abs(matrix[::40] - truth).mean() for matrix in (mean, one_way)]
    assert errors[0] < errors[1] < 0.04 * truth.mean()


@coarse
def test_what_is_not_reached_is_infinitely_far() -> None:
    ball = sphere(subdivisions=1).geometry
    mesh = joined(ball, moved(ball, 5, 0, 0))
    matrix = distance_matrix(mesh)
    labels = HeatGeodesics(mesh).triangulation.laplacian.component_labels
    np.testing.assert_array_equal(np.isfinite(matrix), labels[:, None] == labels)
    np.testing.assert_array_equal(matrix, matrix.T)


def test_halves_are_averaged_across_tiles(monkeypatch) -> None:
    ball = sphere(subdivisions=2).geometry
    whole, one_way = (distance_matrix(ball, symmetric=way) for way in (None, False))
    np.testing.assert_array_equal(whole, (one_way + one_way.T) / 2)
    monkeypatch.setattr("spectra_kit.geodesics.matrix._TILE", 50)
    np.testing.assert_array_equal(distance_matrix(ball), whole)


def test_a_memory_map_is_filled_and_gone_on_with(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("NUMBA_NUM_THREADS", "1")
    mesh, path = sphere(subdivisions=2).geometry, tmp_path / "distances.npy"
    out = np.lib.format.open_memmap(path, "w+", np.float32, (mesh.n, mesh.n))

    def interrupt(done: int, total: int) -> None:
        assert total == mesh.n
        if done >= 80:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        distance_matrix(mesh, out=out, progress=interrupt)
    out = np.lib.format.open_memmap(path, "r+")
    last = int(np.flatnonzero(out.any(axis=1))[-1])
    assert last == 79
    told: list[int] = []
    found = distance_matrix(
        mesh, out=out, start=last, progress=lambda done, total: told.append(done)
    )
    assert found is out
    assert told == [*range(79 + 8, mesh.n, 8), mesh.n]
    whole = distance_matrix(mesh)
    np.testing.assert_array_equal(np.load(path), whole)
    # Nothing is left to do, and what has been averaged stays as it is.
    np.testing.assert_array_equal(distance_matrix(mesh, out=out, start=mesh.n), whole)


def test_doubts_are_told_once() -> None:
    heat = HeatGeodesics(sphere(subdivisions=2).geometry, time_coefficient=1e4)  # blurs all
    with pytest.warns(DoubtfulDistanceWarning) as caught:
        distance_matrix(heat, range(20))
    (warning,) = caught
    assert str(warning.message).startswith("20 of the fields are in doubt; of the first, ")


def test_bad_input_is_refused() -> None:
    mesh = sphere(subdivisions=1).geometry
    n = mesh.n
    fits = f"be an array of shape (3, {n}) and type float32 that can be written to"
    frozen = np.empty((3, n), np.float32)
    frozen.flags.writeable = False
    for out in (np.empty((n, 3), np.float32), np.empty((3, n)), frozen, [[0.0] * n] * 3):
        refused("out", fits, distance_matrix, mesh, [0, 1, 2], out=out)
    refused("symmetric", "be left out where there", distance_matrix, mesh, [0], symmetric=True)
    refused("start", "be 0 without `out`", distance_matrix, mesh, [0, 1], start=1)
    out = np.empty((2, n), np.float32)
    refused("start", "be in [0, 2]", distance_matrix, mesh, [0, 1], out=out, start=3)
    refused("sources", "be in [0, 42)", distance_matrix, mesh, [0, n])
    assert distance_matrix(mesh, []).shape == (0, n)


def test_a_plane_is_as_far_as_a_ruler_says() -> None:
    mesh = rectangle(n=900).geometry
    middle = np.linalg.norm(mesh.points - mesh.points.mean(axis=0), axis=1).argsort()[:20]
    matrix = distance_matrix(mesh, middle, dtype="float64")
    truth = np.array([straight(mesh.points, i) for i in middle])
    assert np.abs(matrix - truth).mean() < 0.02 * truth.mean()
