"""The demo animal, the implicit surfaces it is made of, and pairs: bent, mirrored, permuted."""

from functools import cache
from importlib import import_module

import numpy as np
import pytest
from conftest import creature, refused

from spectra_kit.eigen import eigensolve
from spectra_kit.geometry import creature_pair, mirrored, permuted
from spectra_kit.geometry import implicit as clay
from spectra_kit.geometry.shapes import TriangleMesh
from spectra_kit.operators import robust_laplacian

MODULE = import_module("spectra_kit.geometry.creature")  # whose name there is the function's
AT_REST = cache(MODULE._at_rest)


@pytest.fixture(autouse=True)
def made_once(monkeypatch):
    """Poses and pairs bend animals that others have made."""
    monkeypatch.setattr(MODULE, "_at_rest", AT_REST)


@pytest.fixture(scope="module")
def animal():
    return creature(3000)


@pytest.fixture(scope="module")
def small():
    return creature(600)


@pytest.mark.parametrize(("n", "seed"), [(500, 0), (500, 4), (12_000, 0)])
def test_size_is_met_and_the_surface_is_one_closed_sphere(n, seed):
    mesh = creature(n, seed=seed)
    assert mesh.n == pytest.approx(n, rel=0.01)
    edges, counts = mesh.unique_edges
    assert (counts == 2).all()
    assert mesh.n - len(edges) + len(mesh.faces) == 2
    assert not mesh.component_labels.any()
    assert np.linalg.det(mesh.points[mesh.faces]).sum() > 0  # oriented outwards


def test_triangles_are_decent_and_vertices_lie_on_the_surface(animal):
    corners = animal.points[animal.faces]
    lengths = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    quality = 4 * 3**0.5 * animal.face_areas / (lengths**2).sum(axis=1)  # 1: equilateral
    assert quality.mean() > 0.92
    assert np.quantile(quality, 0.01) > 0.5
    distance = np.abs(MODULE._animal(np.random.default_rng(0), calm=True).field(animal.points))
    assert np.quantile(distance, 0.99) < 1e-3
    assert distance.max() < 2e-2


def test_low_eigenvalues_are_simple_and_stable_under_refinement(animal):
    coarse, fine = (
        eigensolve(robust_laplacian(m), 12).eigenvalues for m in (animal, creature(12_000))
    )
    assert (np.diff(fine) / fine[1:] > 2e-3).all()
    np.testing.assert_allclose(coarse[1:], fine[1:], rtol=0.03)


def test_seed_decides_the_animal(monkeypatch):
    monkeypatch.undo()
    again = creature.__wrapped__(500)
    np.testing.assert_array_equal(again.points, creature(500).points)
    assert np.abs(creature(500, seed=4).points - again.points).max() > 0.05
    refused("n_points", "be in [500, 5000000]", creature, 499)
    refused("seed", "be at least 0", creature, seed=-1)


TURN = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
SOLIDS = {
    "limb": (clay.limb([-1, 0, 0], [1, 0, 0], 0.5, 0.5), np.pi * 0.5**2 * 2 + np.pi / 6),
    "ellipsoid": (clay.ellipsoid([0, 0, 0], [1, 0.8, 0.6], TURN), 4 / 3 * np.pi * 0.48),
    "box": (clay.box([0, 0.1, 0], [0.9, 0.6, 0.5], TURN), 8 * 0.27),
    "cylinder": (clay.cylinder([0, 0, 0], 0.6, 0.8, TURN), np.pi * 0.36 * 1.6),
    "ring": (clay.ring([0, 0, 0], 0.9, 0.3, TURN), 2 * np.pi**2 * 0.9 * 0.09),
}


@pytest.mark.parametrize("name", SOLIDS)
def test_solids_have_their_volume_and_distances(name):
    field, volume = SOLIDS[name]
    mesh = TriangleMesh(*clay.polygonize(field, [-1.7] * 3, [1.7] * 3, n_cells=200_000))
    assert len(mesh.boundary_vertices) == 0
    assert np.linalg.det(mesh.points[mesh.faces]).sum() / 6 == pytest.approx(volume, rel=0.02)
    if name == "ellipsoid":  # its field is an estimate
        return
    points = np.random.default_rng(1).uniform(-2, 2, (2000, 3))
    outside = points[field(points) > 0.05]
    slope = (field(outside + 1e-6 * TURN[0]) - field(outside - 1e-6 * TURN[0])) / 2e-6
    assert (np.abs(slope) <= 1 + 1e-6).all()
    nearest = np.array([np.linalg.norm(mesh.points - p, axis=1).min() for p in outside[:100]])
    np.testing.assert_allclose(field(outside[:100]), nearest, atol=0.05)


def test_coarse_to_fine_polygons_are_the_same():
    field = MODULE._animal(np.random.default_rng(2), calm=False).field
    box = ([-1.75, -0.85, -1.05], [1.65, 0.85, 1.35])
    plain = clay.polygonize(field, *box, n_cells=60_000)
    quick = clay.polygonize(field, *box, n_cells=60_000, stride=4)
    np.testing.assert_array_equal(quick[1], plain[1])
    np.testing.assert_allclose(quick[0], plain[0], atol=1e-12)


def test_smooth_union_contains_both_and_adds_little():
    ball = [clay.ellipsoid([x, 0, 0], [0.5] * 3) for x in (-0.4, 0.4)]
    points = np.random.default_rng(0).uniform(-1, 1, (5000, 3))
    sharp = np.minimum(ball[0](points), ball[1](points))
    np.testing.assert_array_equal(clay.smooth_union(ball, 0.0)(points), sharp)
    melted = clay.smooth_union(ball, 0.3)(points)
    assert (melted <= sharp).all()
    assert (melted >= sharp - 0.3 / 6 - 1e-12).all()


def test_no_zero_gives_an_empty_mesh():
    points, faces = clay.polygonize(lambda p: np.ones(len(p)), [-1] * 3, [1] * 3, n_cells=1000)
    assert len(points) == len(faces) == 0


# --- pairs ---


def edge_lengths(mesh):
    return np.linalg.norm(np.diff(mesh.points[mesh.unique_edges[0]], axis=1)[:, 0], axis=1)


@pytest.mark.parametrize(("seed", "pose"), [(0, 1), (3, 2)])
def test_a_pose_moves_much_and_stretches_little(seed, pose):
    rest, bent = creature(600, seed=seed), creature(600, seed=seed, pose=pose)
    np.testing.assert_array_equal(rest.faces, bent.faces)
    assert np.abs(np.log(edge_lengths(bent) / edge_lengths(rest))).mean() < 0.06
    assert bent.area == pytest.approx(rest.area, rel=0.02)
    assert np.linalg.norm(bent.points - rest.points, axis=1).mean() > 0.1
    assert np.linalg.det(bent.points[bent.faces]).sum() > 0


def test_a_pair_of_equal_size_corresponds_vertex_by_vertex(small):
    source, target, point_map = creature_pair(600, poses=(0, 1))
    np.testing.assert_array_equal(source.points, small.points)
    np.testing.assert_array_equal(point_map, np.arange(600))
    np.testing.assert_array_equal(target.points, creature(600, pose=1).points)


def test_a_remeshed_pair_corresponds_within_an_edge(small):
    source, target, point_map = creature_pair(600, 500, poses=(0, 0))
    edge = edge_lengths(source)
    distance = np.linalg.norm(source.points[point_map] - target.points, axis=1)
    assert distance.max() < edge.max()
    assert distance.mean() < edge.mean() / 2
    np.testing.assert_array_equal(source.points, small.points)
    np.testing.assert_array_equal(target.points, creature(500).points)


def test_a_permuted_copy_is_the_same_surface(small):
    copy, point_map = permuted(small, seed=3)
    np.testing.assert_array_equal(copy.points, small.points[point_map])
    assert {*map(tuple, point_map[copy.faces])} == {*map(tuple, small.faces)}
    cloud, order = permuted(small.as_cloud(), seed=3)
    np.testing.assert_array_equal(order, point_map)
    np.testing.assert_array_equal(cloud.points, copy.points)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_mirrored_copy_looks_outwards_still(small, axis):
    copy = mirrored(small, axis=axis)
    volumes = [np.linalg.det(mesh.points[mesh.faces]).sum() for mesh in (small, copy)]
    assert volumes[1] == pytest.approx(volumes[0])
    np.testing.assert_array_equal(mirrored(copy, axis=axis).points, small.points)
    np.testing.assert_array_equal(mirrored(small.as_cloud(), axis=axis).points, copy.points)
