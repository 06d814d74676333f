"""Fits to descriptors of two surfaces do not depend on the unit that either is measured in."""

import numpy as np
import pytest
from conftest import creature
from measure.matching.methods import Side, match_wks

from spectra_kit import Spectrum, TriangleMesh, eigensolve, robust_laplacian
from spectra_kit.descriptors import normalize_descriptors, wave_kernel_signature
from spectra_kit.functional_maps import fit_functional_map


def solved(mesh: TriangleMesh) -> Side:
    return Side(mesh, eigensolve(robust_laplacian(mesh), 40))


@pytest.fixture(scope="module")
def animal() -> Side:
    return solved(creature(700))


@pytest.fixture(scope="module")
def bent() -> Side:
    return solved(creature(700, pose=1))


@pytest.fixture(scope="module")
def in_millimetres(bent) -> Side:
    mesh = bent.geometry
    return Side(mesh.with_points(1000 * mesh.points), bent.spectrum.rescale(1000.0))


def fitted(source: Spectrum, target: Spectrum) -> np.ndarray:
    f, g = (normalize_descriptors(s, wave_kernel_signature(s, count=20)) for s in (source, target))
    return fit_functional_map(source, target, f, g, k=20)


def test_fits_are_the_same_in_other_units(animal, bent, in_millimetres) -> None:
    expected = fitted(animal.spectrum, bent.spectrum)
    found = fitted(animal.spectrum, in_millimetres.spectrum)
    assert found == pytest.approx(expected, abs=1e-6)


def test_the_plain_method_matches_across_units(animal, bent, in_millimetres) -> None:
    expected, found = (match_wks(animal, other).point_map for other in (bent, in_millimetres))
    np.testing.assert_array_equal(found, expected)
    same = np.linalg.norm(animal.geometry.points[found] - animal.geometry.points, axis=1)
    assert np.median(same) < 0.05 * np.ptp(animal.geometry.points)
