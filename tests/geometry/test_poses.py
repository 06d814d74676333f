"""Pairs of our own: poses, permuted and mirrored copies."""

import numpy as np
import pytest
from conftest import creature

from spectra_kit.eigensolvers import eigensolve
from spectra_kit.geometry import creature_pair, mirrored, permuted
from spectra_kit.operators import robust_laplacian


@pytest.fixture(scope="module")
def animal():
    return creature(800)


def edge_lengths(mesh, edges):
    return np.linalg.norm(np.diff(mesh.points[edges], axis=1)[:, 0], axis=1)


@pytest.mark.parametrize("seed", [0, 3])
@pytest.mark.parametrize("pose", [1, 2, 5])
def test_a_pose_moves_much_and_stretches_little(seed, pose):
    rest, bent = creature(800, seed=seed), creature(800, seed=seed, pose=pose)
    np.testing.assert_array_equal(rest.faces, bent.faces)
    edges, _ = rest.unique_edges
    stretch = np.log(edge_lengths(bent, edges) / edge_lengths(rest, edges))
    assert np.abs(stretch).mean() < 0.06
    assert bent.area == pytest.approx(rest.area, rel=0.02)
    assert np.linalg.norm(bent.points - rest.points, axis=1).mean() > 0.1
    assert np.linalg.det(bent.points[bent.faces]).sum() > 0


def test_poses_are_nearly_isometric(animal):
    rest, bent = (
        eigensolve(robust_laplacian(mesh), 20).eigenvalues[1:]
        for mesh in (animal, creature(800, pose=2))
    )
    np.testing.assert_allclose(bent, rest, rtol=0.08)


def test_pose_zero_is_rest_and_poses_differ(animal):
    np.testing.assert_array_equal(creature(800, pose=0).points, animal.points)
    one, two = creature(800, pose=1).points, creature(800, pose=2).points
    np.testing.assert_array_equal(creature(800, pose=1).points, one)
    assert np.abs(one - two).max() > 0.2


def test_a_pair_of_equal_size_corresponds_vertex_by_vertex():
    source, target, point_map = creature_pair(800, seed=1, poses=(0, 3))
    np.testing.assert_array_equal(source.faces, target.faces)
    np.testing.assert_array_equal(point_map, np.arange(800))
    np.testing.assert_array_equal(target.points, creature(800, seed=1, pose=3).points)


def test_a_remeshed_pair_corresponds_within_an_edge(animal):
    source, target, point_map = creature_pair(800, 600, poses=(0, 0))
    edge = edge_lengths(source, source.unique_edges[0])
    distance = np.linalg.norm(source.points[point_map] - target.points, axis=1)
    assert distance.max() < edge.max()
    assert distance.mean() < edge.mean() / 2
    _, posed, same = creature_pair(800, 600, poses=(1, 4))
    np.testing.assert_array_equal(same, point_map)
    np.testing.assert_array_equal(posed.faces, target.faces)


def test_a_permuted_copy_is_the_same_surface(animal):
    copy, point_map = permuted(animal, seed=3)
    np.testing.assert_array_equal(copy.points, animal.points[point_map])
    assert {*map(tuple, point_map[copy.faces])} == {*map(tuple, animal.faces)}
    cloud, order = permuted(animal.as_cloud(), seed=3)
    np.testing.assert_array_equal(order, point_map)
    np.testing.assert_array_equal(cloud.points, copy.points)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_mirrored_copy_looks_outwards_still(animal, axis):
    copy = mirrored(animal, axis=axis)
    volumes = [np.linalg.det(mesh.points[mesh.faces]).sum() for mesh in (animal, copy)]
    assert volumes[1] == pytest.approx(volumes[0])
    np.testing.assert_array_equal(mirrored(copy, axis=axis).points, animal.points)
    np.testing.assert_array_equal(mirrored(animal.as_cloud(), axis=axis).points, copy.points)
