"""Real bodies and animals are matched without flips, to hundredths of the root of the area."""

import numpy as np
import pytest
from conftest import data_folder
from measure.matching.subjects import subjects_in, truth_between

from spectra_kit.correspondence import geodesic_errors
from spectra_kit.eigensolvers import Arpack, Polished, eigensolve
from spectra_kit.matching import match, prepare
from spectra_kit.neo import NeoSubspace
from spectra_kit.operators import robust_laplacian

pytestmark = pytest.mark.data

# Of other seeds than the figures in the README: bodies of different people, and two dogs and two
# horses. Limits are half as much again as what was measured.
PAIRS = [
    ("faust_r", "tr_reg_033", "tr_reg_068", 2.4),
    ("faust_r", "tr_reg_077", "tr_reg_078", 3.4),
    ("tosca_r", "dog7", "dog6", 4.5),
    ("tosca_r", "horse6", "horse0", 1.5),
]


def error_of(subjects, names, solver) -> float:
    one, other = (subjects[name] for name in names)
    sides = [
        prepare(eigensolve(robust_laplacian(side.mesh), 150, solver), side.mesh)
        for side in (one, other)
    ]
    found = match(*sides)
    assert not found.mirrored
    return float(np.mean(geodesic_errors(one.mesh, found.point_map, truth_between(one, other))))


@pytest.mark.parametrize(("folder", "source", "target", "limit"), PAIRS)
def test_real_shapes_are_not_flipped(folder, source, target, limit) -> None:
    root = data_folder()
    if root is None or not (root / folder).is_dir():
        pytest.skip("set SPECTRA_KIT_DATA to the folder of real shapes to run this")
    assert error_of(subjects_in(root / folder), (source, target), Arpack()) < limit


def test_one_polish_makes_predicted_modes_as_good() -> None:
    root = data_folder()
    if root is None or not (root / "faust_r").is_dir():
        pytest.skip("set SPECTRA_KIT_DATA to the folder of real shapes to run this")
    subjects = subjects_in(root / "faust_r")
    names = ("tr_reg_002", "tr_reg_062")
    exact = error_of(subjects, names, Arpack())
    polished = error_of(subjects, names, Polished(start=NeoSubspace("small"), sweeps=1))
    assert polished < 1.1 * exact
