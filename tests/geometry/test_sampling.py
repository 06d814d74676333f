"""Sampling follows area, or the density asked for, repeats with its seed and stays on faces."""

import numpy as np
import pytest
from scipy import stats

from spectra_kit.geometry import GaussianDensity, TriangleMesh, sample, sample_with_origin, sphere


@pytest.fixture(scope="module")
def ball():
    return sphere(subdivisions=2).geometry


def stretched(mesh):
    return mesh.with_points(mesh.points * [1.0, 2.0, 5.0])


def p_value(mesh, samples, weights):
    """Chi-square probability of the observed counts on faces under the expected weights."""
    expected = len(samples.faces) * weights / weights.sum()
    counts = np.bincount(samples.faces, minlength=len(mesh.faces))
    enough = expected >= 5
    observed = np.append(counts[enough], counts[~enough].sum())
    wanted = np.append(expected[enough], expected[~enough].sum())
    return stats.chisquare(observed[wanted > 0], wanted[wanted > 0]).pvalue


def test_faces_are_hit_by_area(ball):
    mesh = stretched(ball)
    samples = sample_with_origin(mesh, 40_000, seed=1)
    assert 1e-3 < p_value(mesh, samples, mesh.face_areas) < 1 - 1e-3
    assert p_value(mesh, samples, np.ones(len(mesh.faces))) < 1e-12  # the test sees the difference


def test_points_are_uniform_inside_a_face():
    """Barycentric coordinates of a uniform point: mean 1/3, variance 1/18, covariance -1/36."""
    mesh = TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    barycentric = sample_with_origin(mesh, 200_000, seed=2).barycentric
    np.testing.assert_allclose(barycentric.mean(axis=0), 1 / 3, atol=2e-3)
    covariance = np.full((3, 3), -1 / 36) + np.eye(3) * (1 / 18 + 1 / 36)
    np.testing.assert_allclose(np.cov(barycentric.T), covariance, atol=5e-4)


@pytest.mark.parametrize("sigma", [0.1, 1.0])
def test_gaussian_density_is_area_times_gaussian_of_the_distance(ball, sigma):
    mesh = stretched(ball)
    centre = tuple(mesh.points[7])
    density = GaussianDensity(sigma=sigma, centre=centre)
    samples = sample_with_origin(mesh, 40_000, seed=3, density=density)
    diagonal = np.linalg.norm(mesh.points.max(axis=0) - mesh.points.min(axis=0))
    distance = np.linalg.norm(mesh.points[mesh.faces].mean(axis=1) - centre, axis=1)
    weights = mesh.face_areas * np.exp(-0.5 * (distance / (sigma * diagonal)) ** 2)
    assert 1e-3 < p_value(mesh, samples, weights) < 1 - 1e-3


def test_random_centre_lies_on_the_surface_and_moves_with_the_seed(ball):
    """With a narrow Gaussian the cloud gathers at its centre, which for a sphere has norm 1."""
    density = GaussianDensity(sigma=0.02)
    middles = [sample(ball, 500, seed=s, density=density).points.mean(axis=0) for s in range(6)]
    np.testing.assert_allclose(np.linalg.norm(middles, axis=1), 1.0, atol=0.05)
    assert np.ptp(middles, axis=0).min() > 0.1


def test_far_centre_does_not_underflow(ball):
    density = GaussianDensity(sigma=0.01, centre=(50.0, 0.0, 0.0))
    cloud = sample(ball, 100, seed=0, density=density)
    assert cloud.points[:, 0].min() > 0.8


@pytest.mark.parametrize("density", ["uniform", GaussianDensity(sigma=0.2)])
def test_the_seed_decides_in_any_unit(ball, density):
    first = sample_with_origin(ball, 200, seed=5, density=density)
    np.testing.assert_array_equal(
        sample(ball, 200, seed=5, density=density).points, first.cloud.points
    )
    assert not np.allclose(first.cloud.points, sample(ball, 200, seed=6, density=density).points)
    for exponent in (-1000, 10, 1000):
        scaled = ball.with_points(np.ldexp(ball.points, exponent))
        other = sample_with_origin(scaled, 200, seed=5, density=density)
        np.testing.assert_array_equal(other.faces, first.faces)
        np.testing.assert_array_equal(other.barycentric, first.barycentric)
        np.testing.assert_array_equal(other.cloud.points, np.ldexp(first.cloud.points, exponent))


def test_degenerate_faces_are_never_hit():
    points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0]]
    flat, double = [0, 1, 3], [0, 2, 2]
    mesh = TriangleMesh(points, [flat, double, [0, 1, 2], flat, [1, 3, 2], double])
    samples = sample_with_origin(mesh, 5000, seed=0)
    assert set(samples.faces) == {2, 4}


def test_functions_are_interpolated_linearly(ball):
    samples = sample_with_origin(ball, 100, seed=0)
    linear = ball.points @ [1.0, -2.0, 3.0] + 4.0
    np.testing.assert_allclose(
        samples.interpolate(linear), samples.cloud.points @ [1.0, -2.0, 3.0] + 4.0, atol=1e-13
    )
    assert samples.interpolate(np.ones((ball.n, 4))).shape == (100, 4)
