"""The direct solver of singular Laplacians."""

import numpy as np
import pytest
from conftest import refused
from one_system import path
from scipy import sparse
from scipy.sparse.linalg import spsolve

from spectra_kit import InvalidInputError
from spectra_kit._sparse import ConstantKernel, GroundedCholesky
from spectra_kit.geodesics import Direct, geodesic_distance
from spectra_kit.geometry import rectangle
from spectra_kit.operators import intrinsic_delaunay

RNG = np.random.default_rng(0)


def test_against_scipy_and_whichever_point_is_held():
    A, n = path(200), 200
    kernel = ConstantKernel(np.zeros(n, int))
    rhs = kernel.remove(RNG.standard_normal(n))
    truth = np.zeros(n)
    truth[:-1] = spsolve(sparse.csc_array(A[:-1][:, :-1]), rhs[:-1])  # the last one here
    (solution,) = GroundedCholesky(A, kernel).solutions([rhs])
    np.testing.assert_allclose(solution.x, truth - truth.mean(), atol=1e-10 * abs(truth).max())
    assert (solution.converged, solution.iterations, solution.method) == (True, 0, "Cholesky")
    assert solution.relative_residual < 1e-11
    assert solution.setup_seconds > 0
    assert solution.times == [solution.seconds]
    both = GroundedCholesky(A, kernel).solutions([2 * rhs, rhs])
    np.testing.assert_array_equal(both[1].x, solution.x)


def test_several_components():
    A = sparse.csr_array(sparse.block_diag([path(60), sparse.csr_array((1, 1))]))
    kernel = ConstantKernel([4] * 60 + [2])  # labels with gaps
    x = kernel.remove(RNG.standard_normal(61))
    factor = GroundedCholesky(A, kernel)
    none, found = factor.solutions([np.zeros(61), A @ x])
    np.testing.assert_allclose(found.x, x, atol=1e-10)
    np.testing.assert_array_equal(none.x, 0)
    assert none.relative_residual == 0


def test_what_is_refused():
    solve = GroundedCholesky(path(9), ConstantKernel(np.zeros(9, int))).solutions
    refused("rhs", "sum to zero", solve, [np.ones(9)])
    refused("rhs", "be finite", solve, [np.full(9, np.nan)])
    # Definite on the range, but a solution has no correct digit: its residual is that of rounding.
    hilbert = 1 / (1.0 + np.add.outer(np.arange(12), np.arange(12)))
    flat = np.eye(12) - 1 / 12
    wrong = sparse.csr_array(flat @ hilbert @ flat)
    rhs = flat @ (-1.0) ** np.arange(12)
    with pytest.raises(InvalidInputError, match="must be nonsingular apart"):
        GroundedCholesky(wrong, ConstantKernel(np.zeros(12, int))).solutions([rhs])


def test_what_it_advises_for_flat_triangles_helps():
    sheet = rectangle(n=400).geometry
    flat = sheet.with_points(sheet.points * [1, 1e-7, 1])
    with pytest.raises(InvalidInputError, match=r"all but flat.*mollify_factor=1e-3"):
        geodesic_distance(flat, 0, solver=Direct())
    mended = geodesic_distance(intrinsic_delaunay(flat, mollify_factor=1e-3), 0, solver=Direct())
    along = np.abs(flat.points[:, 0] - flat.points[0, 0])
    np.testing.assert_allclose(mended.distance, along, atol=0.02)
