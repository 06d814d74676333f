"""Pairs of our own: poses, permuted and mirrored copies."""

import numpy as np
import pytest
from conftest import creature

from spectra_kit.geometry import creature_pair, mirrored, permuted


@pytest.fixture(scope="module")
def animal():
    return creature(600)


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


def test_a_pair_of_equal_size_corresponds_vertex_by_vertex(animal):
    source, target, point_map = creature_pair(600, poses=(0, 1))
    np.testing.assert_array_equal(source.points, animal.points)
    np.testing.assert_array_equal(point_map, np.arange(600))
    np.testing.assert_array_equal(target.points, creature(600, pose=1).points)


def test_a_remeshed_pair_corresponds_within_an_edge(animal):
    source, target, point_map = creature_pair(600, 500, poses=(0, 0))
    edge = edge_lengths(source)
    distance = np.linalg.norm(source.points[point_map] - target.points, axis=1)
    assert distance.max() < edge.max()
    assert distance.mean() < edge.mean() / 2
    np.testing.assert_array_equal(source.points, animal.points)
    np.testing.assert_array_equal(target.points, creature(500).points)


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
