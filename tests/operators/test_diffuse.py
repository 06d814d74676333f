"""Heat: eigenfunctions, matrix exponentials, what is preserved; and Schroedinger's levels."""

import numpy as np
import pytest
from conftest import bumpy, creature, moebius, refused, two_parts
from scipy.linalg import expm

from spectra_kit import Dense, cotan_laplacian, delaunay_laplacian, eigensolve, robust_laplacian
from spectra_kit.geometry import rectangle, sphere
from spectra_kit.operators import diffuse, schroedinger
from spectra_kit.operators.equations import _SOLVES, _STEP, heat_weights

BOUND = 1e-10  # of the docstring


def off_by(solves: int, step: float) -> float:
    """Largest error of the rational function, over all x = lambda t >= 0."""
    x = np.concatenate([[0.0], np.geomspace(1e-8, 1e12, 20001), np.linspace(0, 60, 20001)])
    weights = heat_weights(solves, step)
    found = np.polynomial.chebyshev.chebval(2 / (1 + step * x) - 1, weights)
    return float(np.abs(found - np.exp(-x)).max())


def test_each_solve_lowers_the_error_by_more_than_half() -> None:
    solves = np.arange(6, 22, 3)
    errors = [off_by(m, _STEP * _SOLVES / m) for m in solves]
    assert np.polyfit(solves, np.log(errors), 1)[0] < np.log(0.5)
    assert off_by(_SOLVES, _STEP) < BOUND


def test_constants_stay_and_infinite_frequencies_are_gone() -> None:
    ends = np.polynomial.chebyshev.chebval([-1.0, 1.0], heat_weights(_SOLVES, _STEP))
    np.testing.assert_allclose(ends, [0, 1], atol=1e-14)


def test_eigenfunctions_decay_by_their_eigenvalues_at_all_times() -> None:
    L = cotan_laplacian(bumpy(162))
    modes = eigensolve(L, L.n, Dense())
    U, values = modes.eigenvectors, modes.eigenvalues
    for time in [1e-3 / values[-1], 1 / values[-1], 1 / values[20], 1 / values[1], 50 / values[1]]:
        found = modes.project(diffuse(L, U, time))
        np.testing.assert_allclose(found, np.diag(np.exp(-values * time)), atol=2 * BOUND)


@pytest.mark.parametrize("held", [False, True])
def test_it_is_the_exponential_of_the_matrix(held) -> None:
    L = robust_laplacian(creature(500))
    L = schroedinger(L, np.linspace(0, 9, L.n)).dirichlet([4, 50]) if held else L
    rng = np.random.default_rng(0)
    fields = np.column_stack([rng.standard_normal((L.n, 3)), np.arange(L.n) == 7])
    generator = L.stiffness.toarray() / L.mass[:, None]
    start = fields.copy()
    start[L.fixed] = generator[L.fixed] = generator[:, L.fixed] = 0
    for time in (1e-4 * L.area, 0.01 * L.area, L.area):
        found = diffuse(L, fields, time)
        miss = found - expm(-time * generator) @ start
        size = np.sqrt(L.mass @ start**2)
        assert (np.sqrt(L.mass @ miss**2) <= 2 * BOUND * size).all()
        assert (diffuse(L, fields[:, 1], time) == found[:, 1]).all()


def test_heat_is_preserved_on_each_component_and_flows_to_its_mean() -> None:
    L = robust_laplacian(two_parts())
    part = L.component_labels
    field = np.random.default_rng(1).random(L.n) + 5 * part
    total = np.bincount(part, L.mass * field)
    for time in (1e-6, 1e-2, 1.0, 1e6):
        found = diffuse(L, field, time * L.area)
        np.testing.assert_allclose(np.bincount(part, L.mass * found), total, rtol=1e-14)
    np.testing.assert_allclose(found, (total / np.bincount(part, L.mass))[part], rtol=1e-9)


@pytest.mark.parametrize("shape", [creature(700), creature(500).as_cloud(), moebius()])
def test_it_has_no_greater_values_and_falls(shape) -> None:
    L = delaunay_laplacian(shape)
    field = (np.random.default_rng(2).random(L.n) < 0.1).astype(float)
    least, most, spread = 0.0, 1.0, np.inf
    for time in np.geomspace(1e-5, 1, 6) * L.area:
        found = diffuse(L, field, time)
        assert least - 1e-8 <= found.min() <= found.max() <= most + 1e-8
        least, most = found.min(), found.max()
        before, spread = spread, L.mass @ (found - L.mass @ found / L.area) ** 2
        assert spread < before


def test_two_times_are_their_sum_and_units_do_not_matter() -> None:
    mesh = creature(600)
    L, field = robust_laplacian(mesh), mesh.points[:, 0]
    twice = diffuse(L, diffuse(L, field, 2e-3), 3e-3)
    np.testing.assert_allclose(twice, diffuse(L, field, 5e-3), atol=1e-8)
    for scale in (1e-90, 1e90):
        other = robust_laplacian(mesh.with_points(scale * mesh.points))
        np.testing.assert_allclose(
            diffuse(other, field, 5e-3 * scale**2), diffuse(L, field, 5e-3), atol=1e-9
        )


def test_on_the_sphere_and_a_cold_rectangle_it_converges() -> None:
    def ball(level):
        mesh = sphere(subdivisions=level + 2).geometry
        x, y, _ = mesh.points.T
        return robust_laplacian(mesh), x * y, 6.0

    def sheet(level):
        mesh = rectangle(n=300 * 4**level, height=1.0).geometry
        x, y = np.pi * mesh.points[:, :2].T
        L = robust_laplacian(mesh).dirichlet(mesh.boundary_vertices)
        return L, np.sin(x) * np.sin(y), 2 * np.pi**2

    for case in (ball, sheet):
        errors, sizes = [], []
        for level in range(3):
            L, mode, value = case(level)
            miss = diffuse(L, mode, 1 / value) - np.exp(-1) * mode
            errors.append(np.sqrt(L.mass @ miss**2))
            sizes.append(L.n**-0.5)
        assert np.polyfit(np.log(sizes), np.log(errors), 1)[0] == pytest.approx(2, abs=0.2)


def test_a_factor_is_kept_for_the_same_time() -> None:
    L = robust_laplacian(creature(600))

    def kept() -> list:
        tuples = [value for value in vars(L).values() if type(value) is tuple]
        return [one for one in tuples if any(not isinstance(part, np.ndarray) for part in one)]

    first = diffuse(L, np.arange(L.n), 0.01)
    (before,) = kept()
    diffuse(L, np.ones((L.n, 2)), 0.01)
    assert kept()[0] is before
    diffuse(L, np.arange(L.n), 0.02)
    assert kept()[0] is not before
    assert (diffuse(L, np.arange(L.n), 0.01) == first).all()
    L.solve(fixed=[0])
    assert len(kept()) == 2


@pytest.mark.parametrize("scale", [1e-60, 1.0, 1e60])
def test_after_long_what_is_left_is_the_mean_of_each_part(scale) -> None:
    shape = two_parts()
    L = robust_laplacian(shape.with_points(scale * shape.points))
    part, field = L.component_labels, np.random.default_rng(0).random((L.n, 2))
    member = np.arange(part.max() + 1)[:, None] == part
    means = (member * L.mass) @ field / (member @ L.mass)[:, None]
    for power in (3, 14, 16, 18, 100):
        np.testing.assert_allclose(diffuse(L, field, 10.0**power * L.area), means[part], atol=1e-9)
    cold = L.dirichlet([0])
    means[part[0]] = 0
    for power in (14, 20):
        found = diffuse(cold, field, 10.0**power * L.area)
        np.testing.assert_allclose(found, means[part], atol=1e-9)


def test_a_constant_potential_damps_heat() -> None:
    L, field = robust_laplacian(creature(600)), np.arange(600) / 600
    damped = diffuse(schroedinger(L, 30.0), field, 0.02)
    np.testing.assert_allclose(damped, np.exp(-0.6) * diffuse(L, field, 0.02), atol=1e-9)


def test_levels_of_the_harmonic_oscillator_converge() -> None:
    errors, sizes = [], []
    for n in (900, 3600, 14400):
        mesh = rectangle(n=n, width=10.0, height=10.0).geometry
        potential = ((mesh.points[:, :2] - 5) ** 2).sum(axis=1)
        found = eigensolve(schroedinger(robust_laplacian(mesh), potential), 6).eigenvalues
        errors.append(np.abs(found - [2, 4, 4, 6, 6, 6]).max())
        sizes.append(mesh.n**-0.5)
    assert np.polyfit(np.log(sizes), np.log(errors), 1)[0] == pytest.approx(2, abs=0.2)
    assert errors[-1] < 0.03


def test_a_potential_lifts_eigenvalues_and_can_be_shifted() -> None:
    L = robust_laplacian(bumpy(162))
    V = np.sin(np.arange(L.n))
    lifted = eigensolve(schroedinger(L, V - V.min()), 5, Dense()).eigenvalues + V.min()
    dense = L.stiffness.toarray() / np.sqrt(np.outer(L.mass, L.mass)) + np.diag(V)
    np.testing.assert_allclose(lifted, np.linalg.eigvalsh(dense)[:5], atol=1e-9)
    assert schroedinger(L, 0.0).kernel_dimension == 1
    assert schroedinger(L, V + 1).kernel_dimension == 0


def test_refused() -> None:
    L = robust_laplacian(bumpy(162))
    refused("time", "be positive and finite", diffuse, L, np.ones(L.n), 0.0)
    refused("field", "have shape (162,) or (162, c)", diffuse, L, np.ones(3), 1.0)
    refused("potential", "not be negative", schroedinger, L, -np.ones(L.n))
    refused("potential", "be a number or have shape (162,)", schroedinger, L, np.ones(3))
