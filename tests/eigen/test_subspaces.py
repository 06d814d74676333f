import numpy as np
import pytest
from conftest import bumpy, refused

from spectra_kit import Refined, eigensolve, robust_laplacian
from spectra_kit._sparse import orthonormalize
from spectra_kit.eigen.metrics import span_error
from spectra_kit.eigen.subspaces import AmbientFourier, GivenBasis, Union, restricted

CLOUD = bumpy()
MASS = robust_laplacian(CLOUD).mass


def test_ambient_fourier_is_seeded_and_rigid_motion_invariant() -> None:
    subspace = AmbientFourier(m=100)
    basis = subspace(CLOUD.points, MASS)
    assert np.array_equal(basis, subspace(CLOUD.points, MASS))
    assert not np.array_equal(basis, AmbientFourier(m=100, seed=1)(CLOUD.points, MASS))
    q = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    q[:, 0] *= np.linalg.det(q)
    moved = subspace(7.5 * CLOUD.points @ q + [1, -2, 3], 7.5**2 * MASS)
    assert moved == pytest.approx(basis, abs=1e-9)


def test_union_spans_both() -> None:
    a, b = AmbientFourier(m=30, seed=0), AmbientFourier(m=40, seed=1)
    joint = orthonormalize(Union(a, b)(CLOUD.points, MASS), MASS)
    for part in (a, b):
        assert span_error(joint, MASS, orthonormalize(part(CLOUD.points, MASS), MASS)).max() < 1e-9
    assert repr(Union(a, b)).startswith("Union(AmbientFourier(m=30")


def test_fourier_covers_the_low_modes_and_more_functions_cover_more(bumpy_laplacian) -> None:
    exact = eigensolve(bumpy_laplacian, 40)
    errors = [
        span_error(
            AmbientFourier(m=m, bandwidth=4.0)(CLOUD.points, MASS), MASS, exact.eigenvectors
        ).mean()
        for m in (60, 120, 240)
    ]
    assert errors[0] > 3 * errors[1] > 9 * errors[2]
    assert errors[2] < 2e-3


def test_bases_that_belong_to_the_points_can_be_restricted() -> None:
    """Inside unions and solvers too; what is a function of the points stays as it is."""
    rows, given, waves = np.array([2, 0]), GivenBasis(np.eye(4)), AmbientFourier(m=5)
    points = np.random.default_rng(0).standard_normal((4, 3))
    expected = np.hstack([np.eye(4)[rows], waves(points[rows], np.ones(2))])
    for part in (Union(given, waves), Refined(start=Union(given, waves), seed=3)):
        part = restricted(part, rows)
        union = part.start if isinstance(part, Refined) else part
        assert np.array_equal(union(points[rows], np.ones(2)), expected)
    assert part == Refined(start=union, seed=3)
    assert restricted(waves, rows) is waves
    refused("rows", "be in [0, 4)", given.restricted, [4])
    refused("rows", "be a vector of at least one point", given.restricted, np.empty(0, int))
