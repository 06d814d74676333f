"""Each name of the catalogue makes what it says, and spectra know the name of their solver."""

import numpy as np
import pytest
from conftest import bumpy

import spectra_kit as sk
from spectra_kit.catalogue import OPERATORS, SOLVERS, SUBSPACES
from spectra_kit.eigen import Eigensolver
from spectra_kit.eigen.subspaces import Subspace


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulSpectrumWarning")
def test_solvers(name: str, bumpy_laplacian: sk.Laplacian) -> None:
    few = {"coarsest": 100} if name == "cascade" else {}  # else Arpack solves so few points
    solver = SOLVERS[name](**few)
    assert isinstance(solver, Eigensolver)
    assert solver.promise == SOLVERS[name].promise
    made = sk.eigensolve(bumpy_laplacian, 6, solver).provenance
    chosen = {"automatic": "arpack", "lanczos": "dense"}.get(name, name)  # on so few points
    assert made.name == chosen, "the class in lower case, or what its attribute `name` says"
    assert made.accuracy == SOLVERS[name].promise


def test_operators_and_subspaces() -> None:
    for entry in OPERATORS.values():
        assert entry(bumpy()).n == bumpy().n
    for name, entry in SUBSPACES.items():
        assert isinstance(entry(np.eye(3)) if name == "given" else entry(), Subspace)


@pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulSpectrumWarning")
def test_solvers_that_are_not_in_it() -> None:
    class Foreign:
        def eigenpairs(self, laplacian, k):
            return sk.Dense().eigenpairs(laplacian, k)

    def name(solver):
        return sk.spectrum(bumpy(), 3, solver).provenance.name

    assert name(Foreign()) == "foreign"
    assert name(sk.RayleighRitz(subspace=sk.eigen.subspaces.RandomBasis())) == "rayleighritz"
    assert sk.eigen.Provenance().name == ""


def test_the_default_line() -> None:
    """By hand, and in one call; of meshes and of clouds."""
    mesh = bumpy()
    built = ((mesh, sk.robust_laplacian), (mesh.as_cloud(), sk.delaunay_laplacian))
    for geometry, assemble in built:
        by_hand = sk.eigensolve(assemble(geometry), 5)
        assert (sk.laplacian(geometry).stiffness != assemble(geometry).stiffness).nnz == 0
        assert (sk.spectrum(geometry, 5).eigenvalues == by_hand.eigenvalues).all()
