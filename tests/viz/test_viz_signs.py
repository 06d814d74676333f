"""The sign of a mode is the same in every picture, whatever the solver returned."""

import numpy as np

from spectra_kit import eigensolve, robust_laplacian
from spectra_kit.geometry import sphere
from spectra_kit.metrics import compare_spectra
from spectra_kit.viz.modes import _panel, _panels
from spectra_kit.viz.signs import display_signs


def test_the_largest_entry_decides_then_the_cubes_then_the_first():
    columns = np.array([[1, -3, 0], [-2, 2, 2, -1.5], [2, -2, 1, 0], [0, 0, 0], [-5]], dtype=object)
    signs = [float(display_signs(np.array(c, dtype=float)[:, None])[0]) for c in columns]
    assert signs == [-1.0, 1.0, 1.0, 1.0, -1.0]


def test_rounding_does_not_turn_a_tie():
    rng = np.random.default_rng(0)
    odd = np.concatenate([[1.0, -1.0], rng.uniform(-0.9, 0.9, 40)])
    skewed = odd.copy()
    skewed[2:] = np.abs(skewed[2:])
    antisymmetric = np.concatenate([odd, -odd])
    for v in (skewed, antisymmetric):
        noisy = v[:, None] + 1e-9 * rng.normal(size=(len(v), 50))
        assert (display_signs(noisy) == display_signs(v[:, None])).all()
        assert (display_signs(-noisy) == -display_signs(v[:, None])).all()
    assert display_signs(skewed[:, None]) == 1.0


def test_modes_look_the_same_in_galleries_and_comparisons():
    ball = sphere(subdivisions=2).geometry
    found = eigensolve(robust_laplacian(ball.with_points(ball.points * [1.5, 1.2, 1.0])), 5)
    for sign in (1.0, -1.0):
        turned = type(found)(
            eigenvalues=found.eigenvalues,
            eigenvectors=sign * found.eigenvectors,
            mass=found.mass,
        )
        comparison = compare_spectra(turned, found)
        for mode in range(found.k):
            shown = _panel(turned, mode, ()).values
            np.testing.assert_allclose(shown, _panel(found, mode, ()).values)
            aligned = turned.eigenvectors[:, mode]
            left, right, _ = _panels(turned, found, aligned, comparison, mode, ())
            np.testing.assert_allclose(left.values, shown)
            np.testing.assert_allclose(right.values, shown)
            assert shown.max() > (1 - 1e-5) * -shown.min()
