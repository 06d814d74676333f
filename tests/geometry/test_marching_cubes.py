"""Marching cubes against libigl's."""

import igl
import numpy as np
import pytest

from spectra_kit.geometry.marching_cubes import marching_cubes


@pytest.mark.parametrize("share_of_zeros", [0.0, 0.1])
def test_points_and_faces_are_those_of_libigl(share_of_zeros):
    rng = np.random.default_rng(0)
    nz, ny, nx = 9, 12, 30  # random signs: all 256 cases
    values = rng.normal(size=(nz, ny, nx))
    values[rng.random(values.shape) < share_of_zeros] = 0.0
    nodes = np.stack(
        np.meshgrid(*(0.3 * np.arange(n) + 0.1 for n in values.shape), indexing="ij")[::-1], -1
    )
    points, faces = marching_cubes(values, nodes)
    expected, triangles, _ = igl.marching_cubes(values.ravel(), nodes.reshape(-1, 3), nx, ny, nz, 0)
    np.testing.assert_array_equal(faces, triangles)
    np.testing.assert_array_equal(points, expected)
