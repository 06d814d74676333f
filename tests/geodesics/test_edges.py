"""Distances along edges, between pairs of vertices."""

import numpy as np
import pytest
from conftest import bumpy, two_parts
from scipy.sparse.csgraph import floyd_warshall

from spectra_kit import TriangleMesh
from spectra_kit.geodesics import edge_graph, pair_distances
from spectra_kit.geometry import sphere


def random_pairs(mesh, q, seed=0):
    return np.random.default_rng(seed).integers(0, mesh.n, (2, q))


def test_exact_distances_on_the_sphere_are_great_circles():
    ball = sphere(subdivisions=3).geometry
    a, b = random_pairs(ball, 20)
    angle = np.arccos(np.clip(np.sum(ball.points[a] * ball.points[b], axis=1), -1, 1))
    found = pair_distances(ball, a, b, method="exact")
    np.testing.assert_allclose(found, angle, rtol=5e-3, atol=1e-9)


def test_edge_distances_are_shortest_paths_near_and_far():
    mesh = bumpy()
    a, b = random_pairs(mesh, 3000)
    full = floyd_warshall(edge_graph(mesh), directed=False)
    np.testing.assert_allclose(pair_distances(mesh, a, b), full[a, b], rtol=1e-12)
    # Few ends and many starts: searched from the other side.
    np.testing.assert_allclose(pair_distances(mesh, a, 0 * b), full[a, 0], rtol=1e-12)
    assert pair_distances(mesh, a[:0], b[:0]).shape == (0,)


def test_edges_lead_to_the_end_of_a_long_strip():
    n = 300
    x = np.repeat(np.arange(n + 1.0), 2)
    points = np.column_stack([x, np.tile([0.0, 1.0], n + 1), 0 * x])
    corner = 2 * np.arange(n)[:, None]
    strip = TriangleMesh(points, np.vstack([corner + [0, 2, 3], corner + [0, 3, 1]]))
    found = pair_distances(strip, np.zeros(strip.n, int), np.arange(strip.n))
    assert found[::2] == pytest.approx(x[::2])
    assert found[3::2] == pytest.approx(x[3::2] - 1 + np.sqrt(2))  # one diagonal on the way


def test_no_way_leads_to_another_component():
    mesh = two_parts()
    found = pair_distances(mesh, [0, 0], [mesh.n - 1, 0])
    np.testing.assert_array_equal(found, [np.inf, 0])


def test_a_vertex_at_the_same_place_is_no_barrier():
    points = [[0, 0, 0], [1, 0, 0], [1, 0, 0], [2, 0, 0], [1, 1, 0]]
    mesh = TriangleMesh(points, [[0, 1, 4], [1, 2, 4], [2, 3, 4]])
    assert pair_distances(mesh, [0], [3]) == pytest.approx([2.0])
