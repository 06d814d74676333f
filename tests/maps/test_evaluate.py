"""Distances along surfaces, errors of point maps, and their quality without a truth."""

import numpy as np
import pytest
from conftest import bumpy, creature, refused
from scipy.sparse.csgraph import floyd_warshall

from spectra_kit import cotan_laplacian, robust_laplacian
from spectra_kit.geodesics import edge_graph, pair_distances
from spectra_kit.geometry import rectangle, sphere
from spectra_kit.maps import (
    MapErrors,
    Truth,
    accuracy_curve,
    auc,
    bijectivity_errors,
    coverage,
    dirichlet_energy,
    geodesic_errors,
    map_errors,
    orientation,
)


@pytest.fixture(scope="module")
def ball():
    return sphere(subdivisions=3).geometry


# --- errors ---


def test_errors_are_those_of_the_definition():
    mesh = bumpy()
    rng = np.random.default_rng(1)
    p, truth = rng.integers(0, mesh.n, 500), Truth(*rng.integers(0, 500, (3, 200)))
    full = 100 * floyd_warshall(edge_graph(mesh), directed=False) / np.sqrt(mesh.area)
    found = map_errors(mesh, p, truth)
    np.testing.assert_allclose(found.direct, full[p[truth.target], truth.source], rtol=1e-12)
    np.testing.assert_allclose(found.symmetric, full[p[truth.target], truth.symmetric], rtol=1e-12)
    np.testing.assert_array_equal(found.either, np.minimum(found.direct, found.symmetric))
    np.testing.assert_array_equal(geodesic_errors(mesh, p, truth), found.direct)
    in_mm = mesh.with_points(1000 * mesh.points)
    np.testing.assert_allclose(geodesic_errors(in_mm, p, truth), found.direct, rtol=1e-9)
    direct = MapErrors(found.direct, found.target)  # where no mirror image is known
    np.testing.assert_array_equal(direct.either, found.direct)
    assert not direct.flipped()
    largest = MapErrors([3.0, 2.0, 1.0], [1, 0, 1]).at_points(3)
    np.testing.assert_array_equal(largest, [2.0, 3.0, np.nan])


def test_a_mirrored_map_is_flipped():
    mesh = sphere(subdivisions=2).geometry
    mirror = np.array(
        [np.linalg.norm(mesh.points - q * [-1, 1, 1], axis=1).argmin() for q in mesh.points]
    )
    truth = Truth(np.arange(mesh.n), np.arange(mesh.n), mirror)
    right, wrong = (map_errors(mesh, p, truth) for p in (np.arange(mesh.n), mirror))
    assert right.direct.max() == 0 == wrong.symmetric.max()
    assert wrong.flipped()
    assert not right.flipped()
    assert not wrong.flipped(margin=1000)
    assert not map_errors(mesh, mirror, Truth.of_map(np.arange(mesh.n))).flipped()


def test_a_truth_is_its_own_copy():
    source = np.array([3, 1])
    truth = Truth(source, [0, 1])
    source[:] = 0
    np.testing.assert_array_equal(truth.source, [3, 1])
    np.testing.assert_array_equal(truth.swapped().target, [3, 1])


def test_curve_and_area_agree():
    errors = np.random.default_rng(3).exponential(4, 2000)
    at = np.linspace(0, 10, 4001)
    sampled = np.trapezoid(accuracy_curve(errors, at), at) / 10
    assert auc(errors) == pytest.approx(sampled, abs=1e-4)
    assert auc([0.0, 0.0]) == 1
    assert auc([np.inf, 10.0]) == 0


# --- quality ---


def test_coverage_counts_area():
    mass = np.array([1.0, 2.0, 5.0])
    assert coverage([0, 0, 1, 1], mass) == 3 / 8
    assert coverage([2, 0, 1], 1e6 * mass) == 1


def test_energy_of_an_affine_map_is_that_of_its_matrix():
    mesh = rectangle(n=600).geometry
    wide = mesh.with_points(mesh.points * [2.0, 1.0, 1.0])
    same = np.arange(mesh.n)
    # x goes to 2x: (2^2 + 1^2) / 2 for each unit of area, which is doubled.
    energy = dirichlet_energy(cotan_laplacian(wide), cotan_laplacian(mesh), same)
    assert energy == pytest.approx(5 / 4, rel=1e-9)


def test_energy_of_the_identity_is_one_but_for_triangles_that_are_not_delaunay():
    mesh = creature(900)
    stretched = mesh.with_points(mesh.points * [1.0, 1.0, 2.5])
    exact, near, less = (
        dirichlet_energy(laplacian, laplacian, range(laplacian.n))
        for laplacian in (
            cotan_laplacian(stretched),
            robust_laplacian(mesh),
            robust_laplacian(stretched),
        )
    )
    assert exact == pytest.approx(1, rel=1e-9)
    assert 0.95 < less < near < 1
    large, same = cotan_laplacian(mesh.with_points(1e3 * mesh.points)), np.arange(mesh.n)
    assert dirichlet_energy(robust_laplacian(mesh), large, same) == pytest.approx(1, rel=1e-9)
    assert dirichlet_energy(large, large, 0 * same) == pytest.approx(0, abs=1e-12)


def test_orientation_of_a_rotation_a_reflection_and_half_of_each():
    mesh = sphere(subdivisions=3).geometry
    x, y, z = mesh.points.T

    def to(*coordinates):
        image = np.column_stack(coordinates)
        gaps = np.linalg.norm(mesh.points[None] - image[:, None], axis=2)
        return gaps.argmin(axis=1)

    def turn(point_map):
        return orientation(mesh.points, mesh.faces, mesh.faces, point_map)

    assert turn(to(y, z, x)) > 0.9
    assert turn(to(-x, y, z)) == -1
    assert abs(turn(to(np.abs(x), y, z))) < 0.05  # folded: one half of each kind
    assert turn(np.zeros(mesh.n, int)) == 0


def test_bijectivity_finds_what_does_not_come_back():
    mesh = bumpy()
    there = np.random.default_rng(0).permutation(mesh.n)
    back = np.argsort(there)
    assert bijectivity_errors(mesh, there, back).max() == 0
    back[[3, 4]] = back[[4, 3]]
    errors = bijectivity_errors(mesh, there, back)
    np.testing.assert_array_equal(np.flatnonzero(errors), [3, 4])
    apart = pair_distances(mesh, [3], [4])[0]
    assert errors[[3, 4]] == pytest.approx(np.full(2, 100 * apart / np.sqrt(mesh.area)))


def test_what_does_not_fit_is_refused(ball):
    laplacian = robust_laplacian(ball)
    truth = Truth([0], [0])
    for argument, expected, call, *given in (
        ("starts` and `ends", "have the same shape (q,)", pair_distances, ball, [0], [1, 2]),
        ("ends", "be in [0,", pair_distances, ball, [0], [642]),
        ("target", "have the shape (1,) of `direct`", MapErrors, [1.0], [0, 1]),
        ("symmetric", "have the shape (1,) of `direct`", MapErrors, [1.0], [0], [1.0, 2.0]),
        ("direct", "be at least one number >= 0", MapErrors, [-1.0], [0]),
        ("target", "be in", MapErrors, [1.0], [-1]),
        ("target", "have the shape", Truth, [0, 1], [0]),
        ("symmetric", "hold integers", Truth, [0], [0], [0.5]),
        ("source", "have the shape (c,) of `source`, c >= 1", Truth, *np.empty((2, 0), int)),
        ("point_map", "be in [0,", map_errors, ball, [700], truth),
        (
            "point_map",
            "be in [0, 642), got -1; leave out the points without a partner",
            map_errors,
            ball,
            [-1],
            truth,
        ),
        ("truth.target", "be in [0,", map_errors, ball, [7], Truth([0], [5])),
        ("point_map", "have shape (n2,)", map_errors, ball, [[7]], truth),
        ("errors", "be at least", auc, []),
        ("errors", "be at least one number >= 0", accuracy_curve, [np.nan, 1.0], [1.0]),
        ("point_map", "have shape (642,)", dirichlet_energy, laplacian, laplacian, [0, 1]),
        ("point_map", "have shape (n2,)", coverage, [[0]], [1.0]),
        ("point_map", "be in [0,", coverage, [1], [1.0]),
        ("back", "have shape (642,)", bijectivity_errors, ball, np.arange(642), [0]),
        ("target_faces", "be in [0,", orientation, ball.points, ball.faces, [[0, 1, 2]], [0, 1]),
    ):
        refused(argument, expected, call, *given)
    refused("limit", "be positive", auc, [1.0], limit=0)
