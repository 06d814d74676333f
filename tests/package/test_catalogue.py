"""Each name of the catalogue makes what it says, and spectra know the name of their solver.

What names of it stand elsewhere by hand, as type checkers want it, are the same.
"""

from typing import get_args, get_type_hints

import numpy as np
import pytest
from conftest import bumpy

import spectra_kit as sk
from spectra_kit.catalogue import OPERATORS, SOLVERS, SUBSPACES
from spectra_kit.cli import options
from spectra_kit.datasets import Plan, plan
from spectra_kit.eigen import Eigensolver
from spectra_kit.eigen.subspaces import Subspace
from spectra_kit.features import DESCRIPTORS
from spectra_kit.geometry import io
from spectra_kit.geometry.formats import foreign
from spectra_kit.learn import tensors


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulSpectrumWarning")
def test_solvers(name: str, bumpy_laplacian: sk.Laplacian) -> None:
    few = {"coarsest": 100} if name == "cascade" else {}  # else Arpack solves so few points
    solver = SOLVERS[name](**few)
    assert isinstance(solver, Eigensolver)
    assert solver.promise == SOLVERS[name].promise
    made = sk.eigensolve(bumpy_laplacian, 6, solver).provenance
    chosen = {"automatic": "arpack"}.get(name, name)  # on so few points
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


@pytest.mark.parametrize("asked", [sk.laplacian, Plan])
def test_operators_are_asked_for_by_these_names(asked) -> None:
    assert names_in(get_type_hints(asked)["operator"]) == set(OPERATORS)


def test_descriptors_are_asked_for_by_one_list_of_names() -> None:
    assert names_in(plan.Descriptor) == set(DESCRIPTORS) == set(tensors._POWERS)


def test_what_is_read_is_told_and_not_sent_elsewhere() -> None:
    kin = set(io._SURFACES) - {".pial"}  # FreeSurfer has seven names for one format
    named = options.FORMATS.replace(" and its kin", "").split(", ")
    assert {f".{name}" for name in named} == set(io.READERS) - kin
    elsewhere = {suffix for told in (foreign._CALLS, foreign._WORDS) for suffix in each(told)}
    assert not elsewhere & set(io.READERS)


def each(told: dict[str, str]) -> list[str]:
    return " ".join(told.values()).split()


def names_in(hint: object) -> set[str]:
    """Return the words among which a hint lets choose."""
    words = {hint} if isinstance(hint, str) else set()
    return words.union(*(names_in(part) for part in get_args(hint)))
