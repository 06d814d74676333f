"""Conjugate gradients: the right solution, within the bound of theory, of the true residual."""

import numpy as np
import pytest
from conftest import refused
from one_system import body_of_all
from scipy import sparse
from scipy.sparse.linalg import splu, spsolve

from spectra_kit import ConvergenceError, InvalidInputError, delaunay_laplacian
from spectra_kit.geometry import rectangle, sphere
from spectra_kit.linalg import (
    AdditiveTwoLevel,
    CoarseSpace,
    ConstantKernel,
    GroundedCholesky,
    IncompleteCholesky,
    ProjectedTwoLevel,
    pcg,
)

RNG = np.random.default_rng(0)


@pytest.fixture
def body():
    return body_of_all()


def preconditioners(body):
    exact = CoarseSpace(body.spectrum.eigenvectors, matrix=body.A, dtype=np.float64)
    return {
        "none": None,
        "level 0": body.factor,
        "level 0 in float32": IncompleteCholesky(body.A, dtype=np.float32),
        "threshold": IncompleteCholesky(body.A, drop=0.01, relaxation=0.97),
        "additive": AdditiveTwoLevel(body.factor, body.coarse),
        "additive in float64": AdditiveTwoLevel(body.factor, exact),
        "projected": ProjectedTwoLevel(body.factor, body.coarse, body.A),
        "projected in float64": ProjectedTwoLevel(body.factor, exact, body.A),
    }


def test_all_solvers_agree(body):
    grounded = np.zeros(body.n)
    grounded[1:] = spsolve(sparse.csc_array(body.A[1:][:, 1:]), body.b[1:])
    truth = grounded - grounded.mean()
    np.testing.assert_allclose(truth, body.x, atol=1e-9)
    np.testing.assert_allclose(
        GroundedCholesky(body.A, body.kernel).solve(body.b), truth, atol=1e-9
    )
    for name, preconditioner in preconditioners(body).items():
        for start in (None, body.coarse.solve(body.b)):
            found = pcg(
                body.A,
                body.b,
                preconditioner=preconditioner,
                start=start,
                kernel=body.kernel,
                rtol=1e-11,
            )
            np.testing.assert_allclose(found.x, truth, atol=1e-9, err_msg=name)
            assert np.linalg.norm(body.b - body.A @ found.x) <= 1.01e-11 * found.rhs_norm
            assert found.relative_residual <= 1e-11


def relative_condition(body, preconditioner):
    """Condition number of the preconditioned matrix on the complement of its kernel."""
    columns = [preconditioner.solve(body.kernel.remove(unit)) for unit in np.eye(body.n)]
    applied = np.array([body.kernel.remove(column) for column in columns])
    eigenvalues = np.linalg.eigvalsh(body.root.T @ ((applied + applied.T) / 2) @ body.root)
    assert abs(eigenvalues[0]) < 1e-6 * eigenvalues[-1]  # the constants, removed
    return eigenvalues[-1] / eigenvalues[1]


def test_iterations_obey_the_bound_and_fall_with_the_modes(body):
    iterations, conditions = [], []
    for k in (0, 4, 12, 24):
        preconditioner = body.factor
        if k:
            few = body.spectrum.truncate(k)
            modes = CoarseSpace(few.eigenvectors, energies=few.eigenvalues)
            preconditioner = AdditiveTwoLevel(body.factor, modes)
        kappa = relative_condition(body, preconditioner)
        found = pcg(body.A, body.b, preconditioner=preconditioner, kernel=body.kernel, rtol=1e-8)
        # ||e_k||_A <= 2 exp(-2 k / sqrt(kappa)) ||e_0||_A; residuals differ from errors in the
        # A-norm by at most sqrt(cond A) at either end.
        tolerance = 1e-8 / np.sqrt(body.eigenvalues[-1] / body.eigenvalues[1])
        assert found.iterations <= np.sqrt(kappa) / 2 * np.log(2 / tolerance) + 1
        iterations.append(found.iterations)
        conditions.append(kappa)
    assert iterations == sorted(iterations, reverse=True)
    assert conditions == sorted(conditions, reverse=True)
    assert iterations[-1] < 0.5 * iterations[0]


def test_bound_in_the_energy_norm(body):
    # The bound of theory itself: iterations until the error in the A-norm has fallen by eps.
    kappa = relative_condition(body, body.factor)
    eps = 1e-6
    bound = int(np.sqrt(kappa) / 2 * np.log(2 / eps) + 1)

    def energy(error):
        return np.sqrt(error @ (body.A @ error))

    found = pcg(
        body.A,
        body.b,
        preconditioner=body.factor,
        kernel=body.kernel,
        rtol=0.0,
        max_iterations=bound,
        throw=False,
    )
    assert energy(found.x - body.x) <= eps * energy(body.x)


def test_one_iteration_where_the_factor_is_exact():
    n = 400
    off = -np.ones(n - 1)
    diagonal = np.r_[1.0, np.full(n - 2, 2.0), 1.0]
    path = sparse.csr_array(sparse.diags_array([off, diagonal, off], offsets=[-1, 0, 1]))
    x = np.cos(np.pi * (np.arange(n) + 0.5) / n)
    kernel = ConstantKernel(np.zeros(n, int))
    found = pcg(path, path @ x, preconditioner=IncompleteCholesky(path), kernel=kernel)
    assert found.iterations == 1
    np.testing.assert_allclose(found.x, x, atol=1e-8)


def test_kernel_of_several_components_and_a_fixed_one(body):
    mesh = rectangle(n=300).geometry
    fixed = delaunay_laplacian(mesh.as_cloud()).dirichlet(mesh.boundary_vertices)
    inner = fixed.stiffness[fixed.free][:, fixed.free]
    ball = delaunay_laplacian(sphere(subdivisions=2).geometry.as_cloud())
    A = sparse.csr_array(sparse.block_diag([body.A, inner, 50 * ball.stiffness]))
    labels = np.r_[np.zeros(body.n, int), np.full(len(fixed.free), -1), np.ones(ball.n, int)]
    order = RNG.permutation(len(labels))
    A, labels = sparse.csr_array(A[order][:, order]), labels[order]
    kernel = ConstantKernel(labels)
    assert (kernel.dimension, kernel.whole) == (2, False)
    x = kernel.remove(RNG.standard_normal(len(labels)))
    for factor in (None, IncompleteCholesky(A), IncompleteCholesky(A, drop=0.01, relaxation=0.95)):
        found = pcg(A, A @ x, preconditioner=factor, kernel=kernel, rtol=1e-12)
        np.testing.assert_allclose(found.x, x, atol=1e-8)
        assert np.abs(kernel.means(found.x)).max() < 1e-14
    np.testing.assert_allclose(GroundedCholesky(A, kernel).solve(A @ x), x, atol=1e-9)


def test_no_drift_in_five_thousand_iterations():
    # A path has the worst condition number there is for its size: plain CG needs them all.
    n = 6000
    off = -np.ones(n - 1)
    diagonal = np.r_[1.0, np.full(n - 2, 2.0), 1.0]
    path = sparse.csr_array(sparse.diags_array([off, diagonal, off], offsets=[-1, 0, 1]))
    kernel = ConstantKernel(np.zeros(n, int))
    rhs = kernel.remove(RNG.standard_normal(n))
    found = pcg(
        path, rhs, kernel=kernel, start=1e6 + 0 * rhs, max_iterations=5000, rtol=0, throw=False
    )
    assert found.iterations == 5000
    assert abs(found.x.mean()) < 1e-12 * np.abs(found.x).max()
    assert np.linalg.norm(rhs - path @ found.x) == pytest.approx(found.residual_norms[-1])


def test_same_bits_for_one_and_two_threads(monkeypatch):
    laplacian = delaunay_laplacian(sphere(subdivisions=5).geometry.as_cloud())  # 10,242 points
    A = sparse.csr_array(sparse.block_diag([laplacian.stiffness] * 4))
    n = A.shape[0]  # three ranges of rows
    kernel = ConstantKernel(np.repeat(np.arange(4), laplacian.n))
    rhs = kernel.remove(RNG.standard_normal(n))
    factor = IncompleteCholesky(A, relaxation=0.9)
    narrow, wide = (CoarseSpace(RNG.standard_normal((n, k)), matrix=A) for k in (5, 40))
    for preconditioner in (
        AdditiveTwoLevel(factor, narrow),
        AdditiveTwoLevel(factor, wide),
        ProjectedTwoLevel(factor, wide, A),
    ):
        found = []
        for threads in ("1", "2", "3"):
            monkeypatch.setenv("NUMBA_NUM_THREADS", threads)
            found.append(pcg(A, rhs, preconditioner=preconditioner, kernel=kernel, rtol=1e-3))
        for other in found[1:]:
            np.testing.assert_array_equal(found[0].x, other.x)
            np.testing.assert_array_equal(found[0].residual_norms, other.residual_norms)


@pytest.mark.parametrize("scale", [1e-150, 1e-20, 1e20, 1e150])
def test_units_do_not_matter(body, scale):
    plain, scaled = (
        pcg(s * body.A, b, preconditioner=IncompleteCholesky(s * body.A), kernel=body.kernel)
        for s, b in ((1.0, body.b), (2.0**-60, scale * body.b))
    )
    assert plain.iterations == scaled.iterations
    np.testing.assert_allclose(scaled.x, 2.0**60 * scale * plain.x, rtol=1e-6)


def test_record_of_the_solve(body):
    seen = []
    found = pcg(
        body.A,
        body.b,
        preconditioner=AdditiveTwoLevel(body.factor, body.coarse),
        start=body.coarse.solve(body.b),
        kernel=body.kernel,
        progress=lambda iteration, residual: seen.append((iteration, residual)),
    )
    assert [i for i, _ in seen] == list(range(1, found.iterations + 1))
    relative = found.residual_norms / found.rhs_norm
    np.testing.assert_allclose([r for _, r in seen[:-1]], relative[1:-1])
    assert len(found.times) == len(found.residual_norms) == found.iterations + 1
    assert (np.diff(found.times) > 0).all()
    assert found.seconds >= found.times[-1]
    assert found.setup_seconds == body.factor.seconds + body.coarse.seconds
    assert found.relative_residual == relative[-1] <= 1e-8
    assert "AdditiveTwoLevel" in found.method
    # The warm start: the first residual is that of the coarse solution.
    coarse = body.b - body.A @ body.coarse.solve(body.b)
    assert found.residual_norms[0] == pytest.approx(np.linalg.norm(coarse), rel=1e-6)


def test_tolerances(body):
    start = body.x + 1e-3 * RNG.standard_normal(body.n)
    at_once = pcg(body.A, body.b, start=body.x, kernel=body.kernel)
    assert at_once.iterations == 0
    # Relative to b, whatever the start.
    warm = pcg(body.A, body.b, start=start, kernel=body.kernel, rtol=1e-6)
    assert warm.residual_norms[-1] <= 1e-6 * np.linalg.norm(body.b) < warm.residual_norms[-2]
    loose = pcg(body.A, body.b, kernel=body.kernel, rtol=0.0, atol=1e-3)
    assert loose.residual_norms[-1] <= 1e-3 < loose.residual_norms[-2]
    nothing = pcg(body.A, np.zeros(body.n), start=start, kernel=body.kernel)
    assert (nothing.converged, nothing.relative_residual) == (True, 0.0)
    assert not nothing.x.any()


def test_iteration_limit_keeps_what_there_is(body):
    with pytest.raises(
        ConvergenceError, match=r"after 7 iterations.*raise `max_iterations`"
    ) as info:
        pcg(body.A, body.b, kernel=body.kernel, max_iterations=7)
    partial = info.value.partial
    assert not partial.converged
    assert partial.iterations == 7
    again = pcg(body.A, body.b, kernel=body.kernel, max_iterations=7, throw=False)
    np.testing.assert_array_equal(again.x, partial.x)
    assert partial.residual_norms[-1] == pytest.approx(np.linalg.norm(body.b - body.A @ partial.x))


def test_a_matrix_that_is_not_symmetric_is_recognised_in_the_end():
    with pytest.raises(ConvergenceError, match=r"not symmetric, \|A - A.T\| is up to 1.00e\+00"):
        pcg(sparse.csr_array([[2.0, 1], [0, 2]]), [1.0, 3])


def test_more_than_rounding_allows_is_not_claimed(body):
    with pytest.raises(ConvergenceError, match="rounding does not allow for less") as info:
        pcg(body.A, body.b, preconditioner=body.factor, kernel=body.kernel, rtol=1e-17)
    assert info.value.partial.relative_residual < 1e-12


def test_indefinite_matrices_are_recognised(body):
    values = np.linspace(-1, 5, body.n)
    indefinite = sparse.csr_array(sparse.diags_array(values))
    refused("matrix", "be symmetric positive", pcg, indefinite, np.ones(body.n))

    # Energies that cancel: the direction has none, but is not in the kernel either.
    for matrix, rhs in (([[1.0, 0], [0, -1]], [1.0, 1]), ([[0, 1.0], [1, 0]], [1.0, 0])):
        with pytest.raises(
            InvalidInputError, match=r"direction of energy \S+ that it does not map"
        ):
            pcg(sparse.csr_array(matrix), rhs)
    # In the kernel there is none to be had of a semi-definite matrix.
    with pytest.raises(ConvergenceError, match="`rhs` is not in the range"):
        pcg(sparse.csr_array([[1.0, 0], [0, 0]]), [1.0, 1])

    class Negative:
        def solve(self, rhs):
            return -rhs

    class Turning:
        def solve(self, rhs):
            return np.array([-rhs[1], rhs[0]])

    with pytest.raises(InvalidInputError, match="`preconditioner` must be"):
        pcg(sparse.eye_array(2, format="csr"), [1.0, 0], preconditioner=Turning())

    with pytest.raises(InvalidInputError, match="`preconditioner` must be symmetric positive"):
        pcg(body.A, body.b, preconditioner=Negative())


def test_what_is_refused(body):
    A, b, kernel = body.A, body.b, body.kernel
    refused("rhs", "sum to zero", pcg, A, b + 1, kernel=kernel)
    refused("rhs", "have shape (", pcg, A, b[:3])
    refused("rhs", "be finite", pcg, A, np.where(np.arange(body.n) == 5, np.nan, b))
    refused("start", "have shape", pcg, A, b, start=b[:3])
    refused("start", "be finite", pcg, A, b, start=np.full(body.n, np.inf))
    refused("rtol", "be a number", pcg, A, b, rtol=-1)
    refused("max_iterations", "be at least", pcg, A, b, max_iterations=-1)
    with pytest.raises(InvalidInputError, match="`preconditioner` must be of size"):
        pcg(A, b, preconditioner=IncompleteCholesky(sparse.eye_array(3, format="csr")))
    refused("kernel", "have", pcg, A, b, kernel=ConstantKernel([0, 0]))
    with pytest.raises(InvalidInputError, match="constants that `matrix` maps to zero"):
        pcg(sparse.csr_array(A + sparse.eye_array(body.n)), b, kernel=kernel)
    halves = ConstantKernel((np.arange(body.n) > body.n // 2).astype(int))  # not its components
    with pytest.raises(InvalidInputError, match="constants that `matrix` maps to zero"):
        pcg(A, b, kernel=halves)
    for labels in ([0.5, 1.0], [-2, 0], [[0, 0]], []):
        refused("labels", "be integers from", ConstantKernel, labels)

    class Short:
        def solve(self, rhs):
            return rhs[:3]

    refused("preconditioner.solve(...)", "have shape", pcg, A, b, preconditioner=Short())


def test_an_inconsistent_system_without_a_kernel_does_not_converge(body):
    with pytest.raises(ConvergenceError, match="asked for"):
        pcg(body.A, body.b + 0.1, preconditioner=body.factor, max_iterations=300)


def test_matches_scipy_on_a_definite_matrix(body):
    A = sparse.csr_array(body.A + sparse.diags_array(body.laplacian.mass))
    rhs = RNG.standard_normal(body.n)
    found = pcg(A, rhs, preconditioner=IncompleteCholesky(A), rtol=1e-13)
    np.testing.assert_allclose(found.x, splu(sparse.csc_array(A)).solve(rhs), atol=1e-9)
