"""The sparse factor and the compiled products, against LAPACK, SuperLU and scipy."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import refused
from scipy import sparse
from scipy.sparse.linalg import spsolve
from threadpoolctl import threadpool_limits

from spectra_kit import InvalidInputError, robust_laplacian
from spectra_kit._sparse import Inertia, SparseLDL, ldl, products, spmm
from spectra_kit._sparse.elimination import Elimination
from spectra_kit.geometry import sphere


def grid(side: int, shift: float = 0.0) -> sparse.csr_array:
    """The five-point Laplacian of a square with Dirichlet sides, minus `shift`."""
    path = sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(side, side))
    eye = sparse.eye_array(side)
    laplacian = sparse.kron(path, eye) + sparse.kron(eye, path)
    return sparse.csr_array(laplacian - shift * sparse.eye_array(side**2))


@pytest.mark.parametrize("columns", [(), (0,), (3,), (131,)])
@pytest.mark.parametrize("shift", [0.0, 0.3])
def test_solves_like_lu(columns: tuple[int, ...], shift: float) -> None:
    A = grid(20, shift)
    b = np.random.default_rng(0).standard_normal((400, *columns))
    factor = SparseLDL(A, definite=shift == 0)
    x = factor.solve(b)
    assert x.shape == b.shape
    if b.size:
        assert x == pytest.approx(spsolve(sparse.csc_array(A), b), rel=1e-8, abs=1e-9)
        assert np.abs(A @ x - b).max() < 1e-13 * abs(A).sum(axis=1).max() * np.abs(x).max()
    assert factor.solve(np.ones(400, dtype=int)) == pytest.approx(factor.solve(np.ones(400)))
    assert factor.fill >= (A.nnz - 400) / 2


def test_float32_is_as_accurate_as_its_rounding() -> None:
    A = grid(30)
    b = np.random.default_rng(0).standard_normal((900, 20))
    factor = SparseLDL(A)
    exact, single = factor.solve(b), factor.solve(b, dtype=np.float32)
    assert single.dtype == np.float32
    condition = np.linalg.cond(A.toarray())
    assert 0 < np.abs(single - exact).max() < 6e-8 * condition * np.abs(exact).max()


@pytest.mark.parametrize("side", [30, 130])  # the larger has subtrees for threads
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_bits_depend_neither_on_threads_nor_on_neighbours(monkeypatch, side, dtype) -> None:
    A = grid(side)
    b = np.random.default_rng(0).standard_normal((side**2, 90)).astype(dtype)
    monkeypatch.setattr(products, "_SMALL", 0)
    monkeypatch.setattr(ldl, "WORTH_SHARING", 0)
    results = []
    for threads in (1, 5):
        monkeypatch.setenv("NUMBA_NUM_THREADS", str(threads))
        factor = SparseLDL(A)
        some, one = factor.solve(b[:, :7], dtype=dtype), factor.solve(b[:, 7], dtype=dtype)
        results.append((factor.solve(b, dtype=dtype), some, one, factor.pivots, spmm(A, b)))
    for one, other in zip(*results, strict=True):
        assert np.array_equal(one, other)
    everything, some, one, *_ = results[0]
    assert np.array_equal(some, everything[:, :7])
    assert np.array_equal(one, everything[:, 7])
    assert np.array_equal(factor.solve(np.asfortranarray(b), dtype=dtype), everything)
    if dtype is np.float64:
        assert np.array_equal(factor.solve_rows(np.ascontiguousarray(b.T)).T, everything)
        assert np.abs(A @ everything - b).max() < 1e-10


def test_subtrees_are_all_there_and_do_not_meet() -> None:
    """What one needs of the rest are rows above it; two threads have about the same to do."""
    for matrix in (grid(130), sparse.csr_array(sparse.block_diag([grid(40)] * 9))):
        elimination = Elimination.of(matrix)
        subtrees, above = elimination.subtrees, elimination.above
        assert len(subtrees) > 3
        assert (subtrees[:-1, 1] <= subtrees[1:, 0]).all()
        for begin, end in subtrees:
            assert (above[begin : end - 1] > np.arange(begin, end - 1)).all()
            assert (above[begin : end - 1] < end).all()
            assert not np.isin(above[:begin], np.arange(begin, end)).any()
        for threads in (1, 2, 5):
            hands = [subtrees[hand] for hand in elimination.side_by_side(threads)]
            hands = np.concatenate([*hands, elimination.rest])
            hands = hands[np.lexsort(hands.T[::-1])]
            assert (hands[1:, 0] == hands[:-1, 1]).all()  # each run once


def test_inertia_counts_the_signs_of_the_eigenvalues() -> None:
    for seed in range(5):
        rng = np.random.default_rng(seed)
        A = sparse.random_array((80, 80), density=0.05, rng=rng)
        A = sparse.csr_array(A + A.T + sparse.diags_array(rng.standard_normal(80)))
        values = np.linalg.eigvalsh(A.toarray())
        expected = Inertia(int((values < 0).sum()), 0, int((values > 0).sum()))
        assert SparseLDL(A, definite=False).inertia == expected


def test_factors_refuse_what_they_cannot_factorise() -> None:
    indefinite = sparse.csr_array([[1.0, 2.0], [2.0, 1.0]])
    third = sparse.csr_array([[1 / 3, -1 / 3], [-1 / 3, 1 / 3 + 1e-17]])  # the last pivot is noise
    huge = sparse.csr_array([[1e-200, 1e150], [1e150, 1e-200]])
    message = r"\(the pivot of row \d is zero or not finite\); it is singular, or needs another"
    for rows in ([[1.0, -1.0], [-1.0, 1.0]], [[0.0, 1.0], [1.0, 0.0]], huge.toarray()):
        for definite in (True, False):
            with pytest.raises(InvalidInputError, match=message):
                SparseLDL(sparse.csr_array(rows), definite=definite)
    with pytest.raises(InvalidInputError, match="must be symmetric positive definite, got 1 of 2"):
        SparseLDL(indefinite)
    with pytest.raises(InvalidInputError, match=r"singular|positive definite"):
        SparseLDL(third)
    nan = sparse.csr_array([[1.0, np.nan], [np.nan, 1.0]])
    refused("matrix", "be finite", SparseLDL, nan)
    refused("matrix", "be symmetric", SparseLDL, sparse.csr_array([[2.0, 1.0], [0.5, 2.0]]))
    solve = SparseLDL(grid(3)).solve
    refused("rhs", "have shape (9,)", solve, np.ones(8))
    refused("rhs", "be real", solve, np.ones(9) + 1j)
    nothing = SparseLDL(sparse.csr_array(np.ones((0, 0))))
    assert nothing.solve(np.ones(0)).shape == (0,)
    refused("dtype", "be float32 or", solve, np.ones(9), dtype=np.int64)


@pytest.mark.parametrize("subdivisions", [2, 3, 4, 5])
def test_a_laplacian_is_singular_to_rounding(subdivisions) -> None:
    L = robust_laplacian(sphere(subdivisions=subdivisions).geometry).stiffness
    with pytest.raises(InvalidInputError, match="positive definite, got 1 of"):
        SparseLDL(L)
    assert SparseLDL(L, definite=False).inertia == (0, 1, L.shape[0] - 1)


STARVED = """
import resource
import numpy as np
from scipy import sparse
from spectra_kit._sparse import SparseLDL

SparseLDL(sparse.csr_array(np.eye(2)))  # what it imports is not to be counted
path = sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(30, 30))
square = sparse.kron(path, sparse.eye_array(30)) + sparse.kron(sparse.eye_array(30), path)
cube = sparse.kron(square, sparse.eye_array(30)) + sparse.kron(sparse.eye_array(900), path)
pages = int(open("/proc/self/statm").read().split()[0])
limit = pages * resource.getpagesize() + 20 * 2**20
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
SparseLDL(sparse.csr_array(cube))
"""


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="counts memory as Linux does")
def test_want_of_memory_is_an_error_of_its_own() -> None:
    command = [sys.executable, "-c", STARVED]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "OutOfMemoryError: the factor of 27000 unknowns does not fit" in done.stderr


@pytest.mark.parametrize("given", [np.float64, np.float32])
@pytest.mark.parametrize("result", [None, np.float64, np.float32])
def test_product_is_that_of_scipy(given, result) -> None:
    rng = np.random.default_rng(0)
    A = sparse.csr_array(sparse.random_array((700, 500), density=0.02, rng=rng))
    dense = rng.standard_normal((500, 37)).astype(given)
    Y = spmm(A, dense, dtype=result)
    assert Y.dtype == (result or given)
    tolerance = 1e-14 if Y.dtype == np.float64 else 3e-6
    assert np.abs(Y - A @ dense.astype(float)).max() < tolerance
    assert np.array_equal(spmm(sparse.csc_array(A), np.asfortranarray(dense), dtype=result), Y)


def test_product_refuses_what_does_not_fit() -> None:
    A = grid(3)
    refused("dense", "have shape (9,", spmm, A, np.ones((8, 2)))
    refused("dense", "have shape (9,", spmm, A, np.ones(9))
    refused("dense", "be float32 or", spmm, A, np.ones((9, 2), dtype=int), dtype=np.float64)
    refused("dtype", "be float32 or", spmm, A, np.ones((9, 2)), dtype=np.float16)


def test_no_bit_of_large_fronts_depends_on_threads_of_blas() -> None:
    # On a grid of points in space fronts have hundreds of rows, which BLAS multiplies: on this one
    # also a single row, the last of a front.
    n, square = 21, grid(21)
    across = sparse.kron(sparse.eye_array(n), square)
    path = sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n))
    along = sparse.kron(path, sparse.eye_array(n * n))
    matrix = sparse.csr_array(across + along)
    factors = []
    for threads in (1, 2, 4):
        with threadpool_limits(threads, user_api="blas"):
            factors.append(SparseLDL(matrix))
    assert all(np.array_equal(factors[0].pivots, other.pivots) for other in factors[1:])
    assert all((factors[0].lower != other.lower).nnz == 0 for other in factors[1:])
    rhs = np.random.default_rng(0).standard_normal(n**3)
    assert matrix @ factors[0].solve(rhs) == pytest.approx(rhs, abs=1e-10)
