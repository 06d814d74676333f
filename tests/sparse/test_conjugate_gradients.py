"""Conjugate gradients: the right solution, within the bound of theory, of the true residual."""

import numpy as np
import pytest
from conftest import refused
from one_system import path, stopped
from scipy import sparse

from spectra_kit import InvalidInputError, delaunay_laplacian
from spectra_kit._sparse import (
    AdditiveTwoLevel,
    CoarseSpace,
    ConstantKernel,
    GroundedCholesky,
    IncompleteCholesky,
    ProjectedTwoLevel,
    pcg,
)
from spectra_kit.errors import ConvergenceError
from spectra_kit.geometry import sphere

RNG = np.random.default_rng(0)


def test_all_solvers_agree(body):
    (direct,) = GroundedCholesky(body.A, body.kernel).solutions([body.b])
    np.testing.assert_allclose(direct.x, body.x, atol=1e-9)
    exact = CoarseSpace(body.spectrum.eigenvectors, matrix=body.A, dtype=np.float64)
    for preconditioner in (
        None,
        IncompleteCholesky(body.A, dtype=np.float32),
        IncompleteCholesky(body.A, drop=0.01, relaxation=0.97),
        AdditiveTwoLevel(body.factor, body.coarse),
        ProjectedTwoLevel(body.factor, body.coarse, body.A),
        ProjectedTwoLevel(body.factor, exact, body.A),
    ):
        for start in (None, body.coarse.solve(body.b)):
            options = {"preconditioner": preconditioner, "start": start, "kernel": body.kernel}
            found = pcg(body.A, body.b, rtol=1e-11, **options)
            np.testing.assert_allclose(found.x, body.x, atol=1e-9, err_msg=repr(preconditioner))
            assert np.linalg.norm(body.b - body.A @ found.x) <= 1.01e-11 * found.rhs_norm
            assert found.relative_residual <= 1e-11


def relative_condition(body, preconditioner):
    """Condition number of the preconditioned matrix on the complement of its kernel."""
    columns = [preconditioner.solve(body.kernel.remove(unit)) for unit in np.eye(body.n)]
    applied = np.array([body.kernel.remove(column) for column in columns])
    eigenvalues = np.linalg.eigvalsh(body.root.T @ ((applied + applied.T) / 2) @ body.root)
    assert abs(eigenvalues[0]) < 1e-6 * eigenvalues[-1]  # the constants, removed
    return eigenvalues[-1] / eigenvalues[1]


def test_the_bound_of_theory_holds_and_modes_lower_it(body):
    """In ``sqrt(kappa) / 2 log(2 / eps)`` iterations the error in the A-norm falls by eps."""

    def energy(error):
        return np.sqrt(error @ (body.A @ error))

    eps, iterations, conditions = 1e-6, [], []
    for k in (0, 4, 24):
        preconditioner = body.factor
        if k:
            few = body.spectrum.truncate(k)
            modes = CoarseSpace(few.eigenvectors, energies=few.eigenvalues)
            preconditioner = AdditiveTwoLevel(body.factor, modes)
        options = {"preconditioner": preconditioner, "kernel": body.kernel}
        conditions.append(relative_condition(body, preconditioner))
        bound = int(np.sqrt(conditions[-1]) / 2 * np.log(2 / eps) + 1)
        found = stopped(body.A, body.b, rtol=0.0, max_iterations=bound, **options)
        assert energy(found.x - body.x) <= eps * energy(body.x)
        iterations.append(pcg(body.A, body.b, **options).iterations)
    assert conditions == sorted(conditions, reverse=True)
    assert iterations == sorted(iterations, reverse=True)
    assert iterations[-1] < 0.5 * iterations[0]


def test_kernel_of_several_components(body):
    ball = delaunay_laplacian(sphere(subdivisions=2).geometry.as_cloud())
    A = sparse.csr_array(sparse.block_diag([body.A, 50 * ball.stiffness]))
    labels = np.r_[np.zeros(body.n, int), np.ones(ball.n, int)]
    order = RNG.permutation(len(labels))
    A, labels = sparse.csr_array(A[order][:, order]), labels[order]
    kernel = ConstantKernel(labels)
    assert not kernel.whole
    x = kernel.remove(RNG.standard_normal(len(labels)))
    for factor in (None, IncompleteCholesky(A), IncompleteCholesky(A, drop=0.01, relaxation=0.95)):
        found = pcg(A, A @ x, preconditioner=factor, kernel=kernel, rtol=1e-12)
        np.testing.assert_allclose(found.x, x, atol=1e-8)
        assert np.abs(kernel.means(found.x)).max() < 1e-14
    (direct,) = GroundedCholesky(A, kernel).solutions([A @ x])
    np.testing.assert_allclose(direct.x, x, atol=1e-9)


def test_no_drift_in_two_thousand_iterations():
    # A path has the worst condition number there is for its size: plain CG needs them all.
    n = 2500
    kernel = ConstantKernel(np.zeros(n, int))
    rhs = kernel.remove(RNG.standard_normal(n))
    options = {"start": 1e6 + 0 * rhs, "max_iterations": 2000, "rtol": 0}
    found = stopped(path(n), rhs, kernel=kernel, **options)
    assert found.iterations == 2000
    assert abs(found.x.mean()) < 1e-12 * np.abs(found.x).max()
    assert np.linalg.norm(rhs - path(n) @ found.x) == pytest.approx(found.residual_norms[-1])


def test_same_bits_on_any_number_of_threads(monkeypatch):
    laplacian = delaunay_laplacian(sphere(subdivisions=5).geometry.as_cloud())  # 10,242 points
    A = sparse.csr_array(sparse.block_diag([laplacian.stiffness] * 4))
    n = A.shape[0]  # three ranges of rows
    kernel = ConstantKernel(np.repeat(np.arange(4), laplacian.n))
    rhs = kernel.remove(RNG.standard_normal(n))
    factor = IncompleteCholesky(A, relaxation=0.9)
    narrow, wide = (CoarseSpace(RNG.standard_normal((n, k)), matrix=A) for k in (5, 40))
    for preconditioner in (AdditiveTwoLevel(factor, narrow), ProjectedTwoLevel(factor, wide, A)):
        found = []
        for threads in ("1", "3"):
            monkeypatch.setenv("NUMBA_NUM_THREADS", threads)
            found.append(pcg(A, rhs, preconditioner=preconditioner, kernel=kernel, rtol=1e-3))
        np.testing.assert_array_equal(found[0].x, found[1].x)
        np.testing.assert_array_equal(found[0].residual_norms, found[1].residual_norms)


@pytest.mark.parametrize("scale", [1e-150, 1e150])
def test_units_do_not_matter(body, scale):
    plain, scaled = (
        pcg(s * body.A, b, preconditioner=IncompleteCholesky(s * body.A), kernel=body.kernel)
        for s, b in ((1.0, body.b), (2.0**-60, scale * body.b))
    )
    assert plain.iterations == scaled.iterations
    np.testing.assert_allclose(scaled.x, 2.0**60 * scale * plain.x, rtol=1e-6)


def test_record_of_the_solve(body):
    start = body.coarse.solve(body.b)
    found = pcg(
        body.A,
        body.b,
        preconditioner=AdditiveTwoLevel(body.factor, body.coarse),
        start=start,
        kernel=body.kernel,
    )
    relative = found.residual_norms / found.rhs_norm
    assert len(found.times) == len(found.residual_norms) == found.iterations + 1
    assert (np.diff(found.times) > 0).all()
    assert found.seconds >= found.times[-1]
    assert found.setup_seconds == body.factor.seconds + body.coarse.seconds
    assert found.relative_residual == relative[-1] <= 1e-8
    assert "AdditiveTwoLevel" in found.method
    first = np.linalg.norm(body.b - body.A @ start)
    assert found.residual_norms[0] == pytest.approx(first, rel=1e-6)


def test_tolerances(body):
    start = body.x + 1e-3 * RNG.standard_normal(body.n)
    assert pcg(body.A, body.b, start=body.x, kernel=body.kernel).iterations == 0
    # Relative to b, whatever the start.
    warm = pcg(body.A, body.b, start=start, kernel=body.kernel, rtol=1e-6)
    assert warm.residual_norms[-1] <= 1e-6 * np.linalg.norm(body.b) < warm.residual_norms[-2]
    nothing = pcg(body.A, np.zeros(body.n), start=start, kernel=body.kernel)
    assert (nothing.converged, nothing.relative_residual) == (True, 0.0)
    assert not nothing.x.any()


def test_iteration_limit_keeps_what_there_is(body):
    with pytest.raises(ConvergenceError, match=r"after 7 iter.*raise `max_iterations`") as info:
        pcg(body.A, body.b, kernel=body.kernel, max_iterations=7)
    partial = info.value.partial
    assert (partial.converged, partial.iterations) == (False, 7)
    assert partial.residual_norms[-1] == pytest.approx(np.linalg.norm(body.b - body.A @ partial.x))


def test_why_it_did_not_converge(body):
    with pytest.raises(ConvergenceError, match=r"not symmetric, \|A - A.T\| is up to 1.00e\+00"):
        pcg(sparse.csr_array([[2.0, 1], [0, 2]]), [1.0, 3])
    with pytest.raises(ConvergenceError, match="rounding does not allow for less") as info:
        pcg(body.A, body.b, preconditioner=body.factor, kernel=body.kernel, rtol=1e-17)
    assert info.value.partial.relative_residual < 1e-12
    with pytest.raises(ConvergenceError, match="asked for"):  # no solution, and no kernel told
        pcg(body.A, body.b + 0.1, preconditioner=body.factor, max_iterations=300)


class Applied:
    """A preconditioner that is a function."""

    def __init__(self, function) -> None:
        self.solve = function


def test_indefinite_matrices_are_recognised(body):
    indefinite = sparse.csr_array(sparse.diags_array(np.linspace(-1, 5, body.n)))
    refused("matrix", "be symmetric positive", pcg, indefinite, np.ones(body.n))
    # Energies that cancel: the direction has none, but is not in the kernel either.
    for matrix, rhs in (([[1.0, 0], [0, -1]], [1.0, 1]), ([[0, 1.0], [1, 0]], [1.0, 0])):
        with pytest.raises(InvalidInputError, match=r"of energy \S+ that it does not map"):
            pcg(sparse.csr_array(matrix), rhs)
    # In the kernel there is none to be had of a semi-definite matrix.
    with pytest.raises(ConvergenceError, match="`rhs` is not in the range"):
        pcg(sparse.csr_array([[1.0, 0], [0, 0]]), [1.0, 1])
    turning = Applied(lambda r: np.array([-r[1], r[0]]))
    eye, expected = sparse.eye_array(2, format="csr"), "be symmetric positive semi-definite"
    refused("preconditioner", expected, pcg, eye, [1.0, 0], preconditioner=turning)
    negative = Applied(np.negative)
    refused("preconditioner", expected, pcg, body.A, body.b, preconditioner=negative)


def test_what_is_refused(body):
    A, b, kernel = body.A, body.b, body.kernel
    short = Applied(lambda r: r[:3])
    halves = ConstantKernel((np.arange(body.n) > body.n // 2).astype(int))  # not its components
    held = sparse.csr_array(A + sparse.eye_array(body.n))
    maps = "hold constants that `matrix` maps to zero"
    for argument, expected, matrix, rhs, options in (
        ("rhs", "sum to zero", A, b + 1, {"kernel": kernel}),
        ("rhs", "have shape (", A, b[:3], {}),
        ("rhs", "be finite", A, np.where(np.arange(body.n) == 5, np.nan, b), {}),
        ("start", "have shape", A, b, {"start": b[:3]}),
        ("preconditioner.solve(...)", "have shape", A, b, {"preconditioner": short}),
        ("kernel", maps, held, b, {"kernel": kernel}),
        ("kernel", maps, A, b, {"kernel": halves}),
    ):
        refused(argument, expected, pcg, matrix, rhs, **options)
