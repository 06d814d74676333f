"""Operators on which rank, factor, convergence and units may not be taken for granted."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import two_sheets, whole_spectrum
from scipy import sparse

import spectra_kit as sk
from spectra_kit.errors import ConvergenceError, InvalidInputError
from spectra_kit.geometry import sphere

DOUBTFUL = pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulSpectrumWarning")
BALL = sk.robust_laplacian(sphere(subdivisions=3).geometry)
SMALL_BALL = sk.robust_laplacian(sphere(subdivisions=2).geometry)


def side_by_side(*parts: sk.Laplacian) -> sk.Laplacian:
    """Several operators as one, of as many components."""
    return sk.Laplacian(
        sparse.csr_array(sparse.block_diag([part.stiffness for part in parts])),
        np.concatenate([part.mass for part in parts]),
        np.vstack([part.points + [4 * i, 0, 0] for i, part in enumerate(parts)]),
    )


def coupled_spheres(weight: float) -> sk.Laplacian:
    """Two spheres joined by one edge."""
    both, n = side_by_side(SMALL_BALL, SMALL_BALL), SMALL_BALL.n
    edge = sparse.csr_array(
        ([1.0, 1.0, -1.0, -1.0], ([0, n, 0, n], [0, n, n, 0])), shape=both.stiffness.shape
    )
    return sk.Laplacian(both.stiffness + weight * edge, both.mass, both.points)


def with_potential(height: float, share: float) -> sk.Laplacian:
    """A sphere with a potential on the lowest `share` of its points."""
    z = BALL.points[:, 2]
    where = z <= np.quantile(z, share)
    potential = sparse.diags_array(height * where * BALL.mass)
    return sk.Laplacian(BALL.stiffness + potential, BALL.mass, BALL.points)


@pytest.mark.parametrize("weight", [1e-6, 1e-15])
@pytest.mark.parametrize("solver", [sk.Arpack(), sk.Dense(), sk.Refined()], ids=repr)
def test_weakly_coupled_parts_have_one_zero_mode(solver, weight) -> None:
    """The energy of (1, -1), of unit norm: the eigenvalue that the edge splits off, to O(w^2)."""
    laplacian = coupled_spheres(weight)
    spectrum = sk.eigensolve(laplacian, 12, solver)
    second = 4 * weight / laplacian.area
    assert spectrum.eigenvalues[0] == 0
    np.testing.assert_allclose(spectrum.eigenvalues[1], second, rtol=1e-3, atol=1e-14)
    assert (spectrum.n_zero_modes, laplacian.kernel_dimension) == (1, 1)
    assert spectrum.nonzero().k == 11
    assert spectrum.certificate.orthonormality_error < 1e-10
    u = spectrum.eigenvectors[:, 1] * np.sqrt(laplacian.area)
    sides = np.repeat([np.sign(u[0]), -np.sign(u[0])], SMALL_BALL.n)
    np.testing.assert_allclose(u, sides, atol=1e-4)


def test_a_steep_potential_leaves_no_zero_mode() -> None:
    for height, share in ((1e2, 0.1), (1e12, 0.1), (1e7, 0.9)):
        laplacian = with_potential(height, share)
        spectrum = sk.eigensolve(laplacian, 8)
        assert spectrum.eigenvalues[0] > 0.01
        assert (spectrum.n_zero_modes, laplacian.kernel_dimension) == (0, 0)
        assert spectrum.nonzero().k == 8


def test_one_zero_mode_at_any_aspect_ratio() -> None:
    """Needles make entries of L, and so its rounding, larger than its typical ones by 1e12."""
    rng = np.random.default_rng(0)
    mesh = sphere(subdivisions=1).geometry
    for _ in range(12):
        points = mesh.points * 10.0 ** rng.uniform(-6, 6, 3)
        points[rng.integers(mesh.n)] *= 10.0 ** rng.uniform(0, 8)
        stretched = sk.TriangleMesh(points, mesh.faces)
        for build in (sk.robust_laplacian, sk.cotan_laplacian, sk.delaunay_laplacian):
            try:
                laplacian = build(stretched)
            except ValueError:  # areas that vanish
                continue
            L = laplacian.stiffness
            rounding = 1e-14 * np.asarray(abs(L).sum(axis=1))
            assert (np.abs(L.sum(axis=1)) <= rounding).all(), build
            assert laplacian.kernel_dimension == laplacian.n_components
            found = sk.eigensolve(laplacian, 6).n_zero_modes
            assert found == min(6, laplacian.kernel_dimension), build


def test_a_fixed_point_leaves_no_constant_however_coarse_the_rounding() -> None:
    """Entries of 1e17 elsewhere must not hide the edges to the point that is held."""
    n = 30
    weights = np.ones(n - 1)
    weights[20] = 1e17
    chain = sparse.diags_array([-weights, -weights], offsets=[1, -1], shape=(n, n)).tocsr()
    chain = sparse.csr_array(chain + sparse.diags_array(-np.asarray(chain.sum(axis=1))))
    points = np.arange(3.0 * n).reshape(n, 3)
    laplacian = sk.Laplacian(chain, np.ones(n), points)
    assert laplacian.kernel_dimension == 1
    assert laplacian.dirichlet([0]).kernel_dimension == 0
    assert laplacian.dirichlet([10]).kernel_dimension == 0


def test_a_part_whose_modes_round_to_zero_keeps_its_constant_first() -> None:
    """`nonzero` drops the leading modes: they must be the constants of all parts."""
    laplacian = side_by_side(coupled_spheres(1e-17), SMALL_BALL, coupled_spheres(1e-17))
    spectrum = sk.eigensolve(laplacian, 20)
    assert spectrum.n_zero_modes == laplacian.kernel_dimension == 3
    for label in range(3):
        part = laplacian.component_labels == label
        assert (np.ptp(spectrum.eigenvectors[part, :3], axis=0) < 1e-12).all()


def cliques(weight: float, number: int = 24, size: int = 12) -> sk.Laplacian:
    """Complete graphs in a ring, each joined to the next by one weak edge."""
    n = number * size
    graph = sparse.lil_array(sparse.block_diag([np.ones((size, size))] * number))
    for i in range(number):
        a, b = i * size, (i + 1) % number * size + 1
        graph[a, b] = graph[b, a] = weight
    graph.setdiag(0)
    L = sparse.diags_array(np.asarray(graph.sum(axis=1)).ravel()) - graph
    points = np.random.default_rng(0).standard_normal((n, 3))
    return sk.Laplacian(sparse.csr_array(L), np.ones(n), points)


def scaled(laplacian: sk.Laplacian, size: float, energy: float = 1.0) -> sk.Laplacian:
    """The same in another unit of length, and of energy."""
    L, mass, points = laplacian.stiffness, laplacian.mass, laplacian.points
    return sk.Laplacian(L * energy, mass * size**2, points * size)


HARD = {
    "a steep potential on most points": lambda: with_potential(1e8, 0.9),
    "a wall": lambda: with_potential(1e12, 0.99),
    "thin sheets": lambda: sk.robust_laplacian(two_sheets(apart=1e-5)),
    "coupled cliques": lambda: cliques(1e-4),
    "coupled spheres": lambda: coupled_spheres(1e-9),
    "parts of very different size": lambda: side_by_side(
        scaled(SMALL_BALL, 1e3), scaled(SMALL_BALL, 1e-3)
    ),
    "fixed points": lambda: side_by_side(SMALL_BALL, SMALL_BALL).dirichlet([3, 170]),
}
EXACT = [
    sk.Arpack(),
    sk.Dense(),
    sk.Refined(degree=6),
]
APPROXIMATE = [
    sk.RayleighRitz(subspace=sk.eigen.subspaces.AmbientFourier(m=80)),
    sk.Cascade(coarsest=100),
    sk.Neo(coarsest=100),
]


@pytest.fixture(scope="module", params=HARD)
def hard(request) -> tuple[sk.Laplacian, np.ndarray]:
    """An operator, and its eigenvalues by LAPACK."""
    laplacian = HARD[request.param]()
    return laplacian, whole_spectrum(laplacian)[0]


@pytest.mark.parametrize("solver", EXACT, ids=repr)
def test_an_exact_solver_is_right_or_says_that_it_is_not(hard, solver) -> None:
    (laplacian, truth), k = hard, 20
    try:
        spectrum = sk.eigensolve(laplacian, k, solver)
    except ConvergenceError:
        return
    # Dense and Arpack: down to the rounding of the largest entries of L.
    rounding = 1e-14 * (abs(laplacian.stiffness).sum(axis=1) / laplacian.mass).max()
    rtol = getattr(solver, "rtol", 1e-8)
    bound = 2 * rtol * np.maximum(truth[:k], laplacian.component_spacings.max()) + rounding
    assert (np.abs(spectrum.eigenvalues - truth[:k]) <= bound).all()
    assert spectrum.certificate.orthonormality_error < 1e-8
    assert spectrum.n_zero_modes == laplacian.kernel_dimension


@DOUBTFUL
@pytest.mark.parametrize("solver", APPROXIMATE, ids=repr)
def test_an_approximation_bounds_every_eigenvalue_from_above(hard, solver) -> None:
    (laplacian, truth), k = hard, 20
    try:
        spectrum = sk.eigensolve(laplacian, k, solver)
    except InvalidInputError as error:  # which its documentation names
        if "smooth them less" in str(error):
            return
        raise
    rounding = 1e-14 * (abs(laplacian.stiffness).sum(axis=1) / laplacian.mass).max()
    assert (spectrum.eigenvalues >= truth[:k] * (1 - 1e-9) - rounding).all()
    assert spectrum.certificate.orthonormality_error < 1e-8
    assert spectrum.n_zero_modes == laplacian.kernel_dimension


def test_what_a_failure_hands_over_says_how_much_of_it_converged() -> None:
    """Of the part that failed some modes, of the one before all."""
    parts = side_by_side(SMALL_BALL, scaled(BALL, 0.7))
    with pytest.raises(ConvergenceError, match="reached rtol") as caught:
        sk.eigensolve(
            parts,
            30,
            sk.Refined(rtol=1e-10, max_sweeps=3, start=sk.eigen.subspaces.RandomBasis(m=20)),
        )
    partial, relative = caught.value.partial, caught.value.partial.certificate.relative_residuals
    assert partial.k == 30
    assert 0 < caught.value.n_converged == (relative <= 1e-10 * (1 + 1e-6)).sum() < 30


def test_lanczos_that_breaks_down_is_an_error_of_the_house() -> None:
    """Of two clusters, one within rounding, ARPACK may find no shift that it can apply."""
    try:
        spectrum = sk.eigensolve(cliques(1e-10), 30)
    except ConvergenceError:
        return
    assert spectrum.eigenvalues == pytest.approx(np.repeat([0, 12], [24, 6]), abs=1e-9)


@pytest.mark.parametrize("solver", [sk.RayleighRitz, sk.Cascade, sk.Refined])
def test_columns_on_several_parts_give_each_what_they_hold(solver) -> None:
    """A few modes of each of two spheres, and none on a third, which is held."""
    parts = side_by_side(SMALL_BALL, SMALL_BALL, SMALL_BALL).dirichlet([2 * SMALL_BALL.n + 5])
    exact = sk.eigensolve(parts, 16)
    held = parts.component_labels == parts.component_labels[-1]
    columns = exact.eigenvectors[:, ~exact.eigenvectors[held].any(axis=0)]
    name = "start" if solver is sk.Refined else "subspace"
    found = sk.eigensolve(parts, 8, solver(**{name: sk.eigen.subspaces.GivenBasis(columns)}))
    assert 8 <= columns.shape[1] < 16
    others = exact.eigenvalues[~exact.eigenvectors[held].any(axis=0)]
    expected = exact.eigenvalues if solver is sk.Refined else others
    assert found.eigenvalues == pytest.approx(expected[:8], rel=1e-9, abs=1e-9)
    if solver is not sk.Refined:
        with pytest.raises(InvalidInputError, match="must span at least"):
            sk.eigensolve(parts, 40, solver(**{name: sk.eigen.subspaces.GivenBasis(columns)}))


@DOUBTFUL
@pytest.mark.parametrize(
    ("solver", "power"),
    [(sk.Arpack(), 250), *((solver, -500) for solver in [*EXACT, *APPROXIMATE])],
    ids=repr,
)
def test_the_unit_of_length_changes_no_bit(solver, power) -> None:
    """Nor that of energy: sizes and energies of 1e75 and 1e150 times as much, and as little."""
    unit, energy = 2.0**power, 2.0 ** (power // 2)
    one = sk.eigensolve(BALL, 9, solver)  # whole clusters: 1, 3 and 5 modes
    other = sk.eigensolve(scaled(BALL, unit, energy), 9, solver)
    np.testing.assert_array_equal(other.eigenvalues / energy * unit**2, one.eigenvalues)
    np.testing.assert_array_equal(other.eigenvectors * unit, one.eigenvectors)
    relative = one.certificate.relative_residuals
    if solver == sk.Arpack():  # whose own test of convergence is absolute for small Ritz values
        assert relative.max() < 1e-12
    np.testing.assert_array_equal(other.certificate.relative_residuals, relative)
    found, expected = other.certificate, one.certificate
    np.testing.assert_array_equal(found.residuals / energy * unit**2, expected.residuals)
    if expected.count is not None:
        assert found.count.radius / energy * unit**2 == expected.count.radius
        assert found.count.floor / energy * unit**2 == expected.count.floor
    assert found.n_zero_modes == 1


@pytest.mark.parametrize(
    ("parts", "k", "solver"),
    [(40, 300, sk.Automatic()), (20, 400, sk.Lanczos(tol=1e-4))],
    ids=["exact", "loose"],
)
def test_many_equal_parts_in_a_chain_are_solved(parts, k, solver) -> None:
    """Grids, each tied to the next at one corner: what blocks lose, LAPACK finds."""
    side = 9
    line = sparse.diags_array(
        [-np.ones(side - 1), np.r_[1, np.full(side - 2, 2.0), 1], -np.ones(side - 1)],
        offsets=[-1, 0, 1],
    )
    grid = sparse.kron(line, sparse.eye_array(side)) + sparse.kron(sparse.eye_array(side), line)
    ends = np.arange(1, parts) * side**2  # the first corner of each part but the first
    tie = sparse.coo_array(
        (np.ones(parts - 1), (ends, ends - side**2)), shape=2 * (parts * side**2,)
    )
    ties = tie + tie.T
    stiffness = sparse.block_diag([grid] * parts) + sparse.diags_array(ties.sum(axis=1)) - ties
    n = stiffness.shape[0]
    points = np.random.default_rng(0).random((n, 3))
    chain = sk.Laplacian(sparse.csr_array(stiffness), np.ones(n), points)
    found = sk.eigensolve(chain, k, solver)
    assert found.certificate.level == "verified"
    assert found.eigenvalues == pytest.approx(
        np.linalg.eigvalsh(chain.stiffness.toarray())[:k], abs=1e-10
    )
