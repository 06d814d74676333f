"""Factors of ``L - sigma M`` for one shift after the other, against LAPACK's eigenvalues."""

import numpy as np
import pytest
from conftest import creature
from scipy import linalg, sparse
from volumes import box

import spectra_kit as sk
from spectra_kit._sparse import SparseLDL
from spectra_kit._sparse.pencil import Pencil
from spectra_kit.operators import tetrahedral_laplacian


@pytest.fixture(scope="module")
def animal():
    return sk.laplacian(creature(500, seed=1))


def test_inertia_counts_eigenvalues_below_each_shift(animal):
    pencil = Pencil(animal.stiffness, animal.mass)
    truth = linalg.eigh(animal.stiffness.toarray(), np.diag(animal.mass), eigvals_only=True)
    for sigma in (-1.0, *(truth[[5, 40, 200]] + truth[[6, 41, 201]]) / 2, 2 * truth[-1]):
        assert pencil.factor(sigma).inertia.negative == (truth < sigma).sum()


@pytest.mark.parametrize(
    "operator",
    [
        lambda: sk.laplacian(creature(500, seed=1)),
        lambda: sk.laplacian(creature(500, seed=1), mass="consistent"),
        lambda: sk.laplacian(sk.geometry.sphere(subdivisions=3).geometry),  # clusters
        lambda: tetrahedral_laplacian(box(7, 8, 9)),
    ],
    ids=["animal", "consistent", "sphere", "volume"],
)
def test_eight_shifts_at_once_count_as_each_alone(operator):
    laplacian = operator()
    pencil, values = Pencil(laplacian.stiffness, laplacian._weights), np.arange(43.0)
    shifts = (values - 0.5) * laplacian.eigenvalue_spacing
    alone = [pencil.factor(sigma).inertia for sigma in shifts]
    assert alone[0].negative == 0 < alone[-1].negative
    assert pencil.inertias(shifts) == alone


def test_a_shift_without_a_factor_leaves_the_others_beside_it_alone():
    pencil = Pencil(sparse.csr_array([[0.0, 1.0], [1.0, 0.0]]), np.ones(2))
    assert [one and one.negative for one in pencil.inertias([-2.0, 0.0, 0.5, 2.0])] == [
        0,
        None,
        1,
        2,
    ]


def test_factors_are_those_of_the_matrix(animal):
    sigma = 3 * animal.eigenvalue_spacing
    own = Pencil(animal.stiffness, animal.mass).factor(sigma)
    shifted = sparse.csr_array(animal.stiffness - sigma * sparse.diags_array(animal.mass))
    np.testing.assert_array_equal(own.pivots, SparseLDL(shifted, definite=False).pivots)
    pencil = Pencil(animal.stiffness, animal.mass)
    for _ in range(2):  # what one returns is not what the next is made of
        assert abs(pencil.shifted(sigma) - shifted).max() == 0
        pencil.shifted(-sigma).data[:] = 0


def test_what_has_no_diagonal_entries_gets_them():
    swap = sparse.csr_array([[0.0, 1.0], [1.0, 0.0]])
    pencil = Pencil(swap, np.ones(2))
    assert pencil.factor(0.0) is None  # a pivot is zero
    assert [pencil.factor(sigma).inertia.negative for sigma in (-2.0, 0.5, 2.0)] == [0, 1, 2]
    some = sparse.csr_array(([-1.0, 1.0, 1.0], ([0, 0, 1], [0, 1, 0])), (2, 2))
    found = [Pencil(some, np.ones(2)).factor(s).inertia.negative for s in (-2.0, -1.0 + 1e-9, 2.0)]
    assert found == [0, 1, 2]
