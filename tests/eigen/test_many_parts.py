"""Operators of many parts: only those are solved that may have one of the lowest modes."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from functools import cache

import numpy as np
import pytest
from conftest import whole_spectrum
from scipy import linalg, sparse

import spectra_kit as sk
from spectra_kit.eigen import small_parts
from spectra_kit.eigen.answers import component_indices
from spectra_kit.geometry import TriangleMesh, sphere

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
SIDES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def tetrahedra(number: int, seed: int = 0) -> TriangleMesh:
    """Of any size, far from each other."""
    sizes = np.random.default_rng(seed).uniform(0.3, 1, (number, 1, 1))
    apart = 4 * np.arange(number)[:, None, None] * np.array([1, 0, 0])
    faces = SIDES + 4 * np.arange(number)[:, None, None]
    return TriangleMesh((sizes * CORNERS + apart).reshape(-1, 3), faces.reshape(-1, 3))


def joined(meshes: list[TriangleMesh]) -> TriangleMesh:
    starts = np.cumsum([0] + [mesh.n for mesh in meshes])
    return TriangleMesh(
        np.vstack([mesh.points for mesh in meshes]),
        np.vstack([mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]),
    )


def with_balls(number: int) -> TriangleMesh:
    """Tetrahedra beside three balls, whose modes are lower."""
    small, ball = tetrahedra(number), sphere(subdivisions=2).geometry
    others = [
        TriangleMesh(size * ball.points + [0, 30 * size, 0], ball.faces) for size in (3, 4, 5)
    ]
    return joined([small, *others])


@cache
def beside_balls() -> tuple[sk.Laplacian, np.ndarray]:
    laplacian = sk.laplacian(with_balls(30))
    return laplacian, whole_spectrum(laplacian)[0]


@dataclass(frozen=True)
class Told:
    """A solver of one's own, which tells how often it was called."""

    sizes: list[int] = field(default_factory=list)
    promise = "exact"

    def eigenpairs(self, laplacian, k):
        self.sizes.append(laplacian.n)
        return sk.Dense().eigenpairs(laplacian, k)


@pytest.mark.parametrize("k", [1, 10, 40])
def test_constants_of_the_first_parts_are_all_that_is_solved_for(k) -> None:
    laplacian, told = sk.laplacian(tetrahedra(40)), Told()
    spectrum = sk.eigensolve(laplacian, k, told)
    assert told.sizes == [4] * k
    assert (spectrum.eigenvalues == 0).all()
    assert spectrum.certificate.level == "verified"
    assert spectrum.n_zero_modes == k
    parts = laplacian.component_labels
    np.testing.assert_array_equal([parts[u != 0].max() for u in spectrum.eigenvectors.T], range(k))


SOLVERS = [sk.Automatic(), sk.Automatic(accuracy=1e-3), sk.Dense(), sk.Refined(), sk.Cascade()]


@pytest.mark.parametrize("solver", [*SOLVERS, sk.Neo()], ids=repr)
@pytest.mark.parametrize("k", [20, 70])
def test_the_lowest_of_all_parts_are_found(solver, k) -> None:
    laplacian, truth = beside_balls()
    found = sk.eigensolve(laplacian, k, solver).eigenvalues
    np.testing.assert_allclose(found, truth[:k], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("k", [5, 20])
def test_parts_without_a_constant_are_looked_at_together(k) -> None:
    """One corner of each is held: the largest tetrahedra have the lowest modes."""
    mesh, told = tetrahedra(200), Told()
    laplacian = sk.laplacian(mesh).dirichlet(np.arange(0, mesh.n, 4))
    spectrum = sk.eigensolve(laplacian, k, told)
    truth = whole_spectrum(laplacian)[0][:k]
    np.testing.assert_allclose(spectrum.eigenvalues, truth, rtol=1e-9)
    assert len(told.sizes) <= k
    assert spectrum.certificate.level == "verified"


@pytest.mark.parametrize("solver", [sk.Automatic(), sk.Dense()], ids=repr)
@pytest.mark.parametrize("k", [5, 40, 90])
def test_small_parts_together_are_what_each_is_alone(k, solver) -> None:
    """Each beside its equal, some held at a corner, and two isolated points."""
    mesh = tetrahedra(20)
    one = sk.laplacian(mesh)
    stiffness = sparse.block_diag([one.stiffness, one.stiffness, [[0.0]], [[0.5]]])
    mass, apart = np.append(np.tile(one.mass, 2), [1, 1]), np.zeros((2 * one.n + 2, 3))
    laplacian = sk.Laplacian(sparse.csr_array(stiffness), mass, apart).dirichlet([0, 8, 16, 24, 32])
    together, alone = (sk.eigensolve(laplacian, k, s) for s in (solver, Told()))
    np.testing.assert_allclose(together.eigenvalues, alone.eigenvalues, rtol=1e-12, atol=1e-12)
    parts = laplacian.component_labels
    own, other = ([parts[np.abs(u).argmax()] for u in s.eigenvectors.T] for s in (together, alone))
    assert np.bincount(own).tolist() == np.bincount(other).tolist()
    assert own[:36] == other[:36]
    assert (together.eigenvalues[: together.n_zero_modes] == 0).all()
    assert together.n_zero_modes == alone.n_zero_modes == min(k, 36)
    assert together.certificate.level == "verified"
    assert together.certificate.relative_residuals.max() < 1e-14


@pytest.mark.parametrize("solver", [sk.Automatic(), sk.Dense()], ids=repr)
def test_a_small_part_of_negative_energy_is_refused(solver) -> None:
    laplacian = sk.laplacian(tetrahedra(3))
    turned = laplacian.stiffness - sparse.diags_array(np.repeat([0, 0, 1e-3], 4))
    with pytest.raises(sk.errors.InvalidSpectrumError, match="negative eigenvalue"):
        sk.eigensolve(sk.Laplacian(turned, laplacian.mass, laplacian.points), 8, solver)


def test_isolated_points_with_a_potential() -> None:
    """Of no energy but their own: the lowest heights, in order."""
    height = np.random.default_rng(0).permutation(np.arange(1.0, 301.0))
    points = np.random.default_rng(1).random((300, 3))
    laplacian = sk.Laplacian(sparse.csr_array(sparse.diags_array(height)), np.ones(300), points)
    np.testing.assert_array_equal(sk.eigensolve(laplacian, 12).eigenvalues, np.arange(1.0, 13.0))


def test_a_part_is_the_operator_on_its_points() -> None:
    laplacian = sk.laplacian(tetrahedra(5))
    some = np.array([4, 5, 6, 7, 9])
    part = laplacian.restricted(some)
    expected = laplacian.stiffness.toarray()[np.ix_(some, some)]
    np.testing.assert_array_equal(part.stiffness.toarray(), expected)
    turned = laplacian.restricted(some[::-1])
    np.testing.assert_array_equal(turned.stiffness.toarray(), expected[::-1, ::-1])


@pytest.mark.parametrize("together", [2**22, 600])
def test_small_parts_are_blocks_of_the_operator_by_size(monkeypatch, together) -> None:
    """Tetrahedra, and balls of 162 points between them; one corner is held, one part left out."""
    monkeypatch.setattr(small_parts, "_TOGETHER", together)
    laplacian = sk.laplacian(with_balls(7)).dirichlet([5])
    parts = component_indices(laplacian)[1:]
    root, seen = np.sqrt(laplacian.mass), []
    for alike in small_parts.small_components(laplacian, parts):
        for which, points, matrix in zip(*alike, strict=True):
            seen.append(int(which))
            np.testing.assert_array_equal(points, parts[which - 1])
            scale = np.outer(root[points], root[points])
            block = laplacian.stiffness.toarray()[np.ix_(points, points)] / scale
            np.testing.assert_allclose(matrix, block, rtol=1e-14)
    assert seen == [1, *range(2, 7), 7, 8, 9]


def test_a_small_part_that_lapack_would_round_is_asked_for_its_share_alone() -> None:
    """One point of hardly any mass: the largest eigenvalue is far above all others."""
    ball = sk.robust_laplacian(sphere(subdivisions=2).geometry)
    mass = np.tile(ball.mass, 2)
    mass[0] *= 1e-9
    stiffness = sparse.csr_array(sparse.block_diag([ball.stiffness] * 2))
    both = sk.Laplacian(stiffness, mass, np.zeros((2 * ball.n, 3)))
    found = sk.eigensolve(both, 80)
    assert found.provenance.reason.endswith("of 2 components, 1 by arpack")
    assert found.certificate.level == "verified"


@cache
def balls() -> sk.Laplacian:
    """Eight of 642 points and less, of many sizes."""
    meshes = [sphere(subdivisions=3 - i % 2, radius=1 + i / 8).geometry for i in range(8)]
    meshes = [
        TriangleMesh(mesh.points + [9 * i, 0, 0], mesh.faces) for i, mesh in enumerate(meshes)
    ]
    return sk.laplacian(joined(meshes))


BESIDE = [sk.Lanczos(), sk.Automatic(), sk.Automatic(accuracy=1e-3)]


@pytest.mark.parametrize("solver", BESIDE, ids=repr)
def test_parts_side_by_side_are_what_one_thread_finds(monkeypatch, solver) -> None:
    found = []
    for threads in ("1", "2", "5"):
        monkeypatch.setenv("NUMBA_NUM_THREADS", threads)
        found.append(sk.eigensolve(balls(), 50, solver))
    one, *others = found
    assert one.n_zero_modes == 8
    assert one.certificate.level == "verified"
    for other in others:
        np.testing.assert_array_equal(other.eigenvalues, one.eigenvalues)
        np.testing.assert_array_equal(other.eigenvectors, one.eigenvectors)


def owners(laplacian: sk.Laplacian, spectrum: sk.Spectrum) -> set[int]:
    return {int(laplacian.component_labels[np.abs(u).argmax()]) for u in spectrum.eigenvectors.T}


def test_what_parts_beside_found_is_rescued() -> None:
    meshes = [sk.geometry.creature(2000, seed=seed) for seed in range(2)]
    laplacian = sk.laplacian(joined(meshes))
    with pytest.raises(sk.errors.ConvergenceError) as caught:
        sk.eigensolve(laplacian, 800, sk.Lanczos(max_shifts=1))
    assert owners(laplacian, caught.value.partial) == {0, 1}


def test_want_of_memory_in_one_part_leaves_the_others(monkeypatch) -> None:
    solve = sk.Lanczos.eigenpairs

    def none_left(self, laplacian, k):
        if laplacian.area > 4 * np.pi * 1.8**2:  # the largest
            raise MemoryError
        return solve(self, laplacian, k)

    monkeypatch.setattr(sk.Lanczos, "eigenpairs", none_left)
    with pytest.raises(sk.errors.OutOfMemoryError) as caught:
        sk.eigensolve(balls(), 50, sk.Lanczos())
    assert owners(balls(), caught.value.partial) == set(range(7))


def test_solvers_of_users_stay_in_the_thread_of_the_caller() -> None:
    threads = set()

    class Own(sk.Lanczos):
        def eigenpairs(self, laplacian, k):
            threads.add(threading.get_ident())
            return super().eigenpairs(laplacian, k)

    sk.eigensolve(balls(), 50, Own())
    assert threads == {threading.get_ident()}


def test_a_point_that_a_mass_joins_to_none() -> None:
    ball = sk.laplacian(sphere(subdivisions=2).geometry, mass="consistent")
    matrices = [
        sparse.csr_array(sparse.block_diag([matrix, [[value]]]))
        for matrix, value in ((ball.stiffness, 0.7), (ball.consistent_mass, 0.3))
    ]
    found = sk.eigensolve(matrices[0], 12, mass=matrices[1])
    truth = linalg.eigh(*(matrix.toarray() for matrix in matrices), eigvals_only=True)
    np.testing.assert_allclose(found.eigenvalues, truth[:12], rtol=1e-10, atol=1e-10)
    assert found.certificate.level == "verified"
