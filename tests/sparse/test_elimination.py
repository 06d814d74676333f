"""The complete factor, its order and what factors of one pattern share, against LAPACK."""

import numpy as np
import pytest
from conftest import refused
from scipy import sparse
from scipy.sparse.linalg import splu

from spectra_kit import InvalidInputError
from spectra_kit._sparse import SparseLDL
from spectra_kit._sparse.elimination import Elimination, minimum_degree
from spectra_kit.geometry import sphere
from spectra_kit.operators import intrinsic_delaunay


def laplacian(graph: sparse.sparray) -> sparse.csr_array:
    """Return that of a graph plus the identity: symmetric positive definite."""
    links = sparse.csr_array(graph + graph.T)
    links = sparse.csr_array((np.ones(links.nnz), links.indices, links.indptr), links.shape)
    return sparse.csr_array(sparse.csgraph.laplacian(links) + sparse.eye_array(links.shape[0]))


def grid(side: int) -> sparse.csr_array:
    line = sparse.diags_array([1.0], offsets=[1], shape=(side, side))
    eye = sparse.eye_array(side)
    return laplacian(sparse.kron(line, eye) + sparse.kron(eye, line))


def star(n: int) -> sparse.csr_array:
    spokes = (np.ones(n - 1), (np.zeros(n - 1, int), np.arange(1, n)))
    return laplacian(sparse.coo_array(spokes, shape=(n, n)))


def scattered(n: int, density: float) -> sparse.csr_array:
    rng = np.random.default_rng(0)
    return laplacian(sparse.triu(sparse.random_array((n, n), density=density, rng=rng), 1))


GRAPHS = {
    "one point": sparse.csr_array([[2.0]]),
    "no links": sparse.csr_array(sparse.diags_array(np.arange(1.0, 301.0))),
    "path": laplacian(sparse.diags_array([1.0], offsets=[1], shape=(500, 500))),
    "grid": grid(25),
    "parts": sparse.csr_array(sparse.block_diag([grid(9), grid(12), star(3), grid(1)])),
    "star": star(400),
    "all linked": laplacian(sparse.csr_array(np.triu(np.ones((150, 150)), 1))),
    "sparse, scattered": scattered(400, 0.005),
    "dense, scattered": scattered(200, 0.2),
    "ball": sparse.csr_array(
        intrinsic_delaunay(sphere(subdivisions=3).geometry).laplacian.stiffness
        + sparse.eye_array(642)
    ),
}


@pytest.mark.parametrize("A", GRAPHS.values(), ids=GRAPHS)
def test_solves_like_lapack_whatever_the_graph(A: sparse.csr_array) -> None:
    n = A.shape[0]
    assert np.array_equal(np.sort(minimum_degree(A)), np.arange(n))
    b = np.random.default_rng(1).standard_normal((n, 3))
    b[:, 1] = 0
    b[n // 2, 1] = 1.0  # most of the first sweep has nothing to do
    x = SparseLDL(A).solve(b)
    np.testing.assert_allclose(x, np.linalg.solve(A.toarray(), b), rtol=1e-10, atol=1e-12)
    for column in range(3):
        assert np.array_equal(SparseLDL(A).solve(b[:, column]), x[:, column])
    assert SparseLDL(A).solve(b[:, :0]).shape == (n, 0)


def test_factors_of_one_pattern_share_what_it_decides() -> None:
    A = grid(30)
    shared = Elimination.of(A)
    rng = np.random.default_rng(0)
    for _ in range(3):
        scale = rng.uniform(0.5, 2.0, 900)
        B = sparse.csr_array((A.data * np.repeat(scale, np.diff(A.indptr)), A.indices, A.indptr))
        B.data *= scale[B.indices]
        factor = SparseLDL(B, elimination=shared)
        assert factor.fill == shared.fill
        b = rng.standard_normal(900)
        assert np.array_equal(factor.solve(b), SparseLDL(B).solve(b))
    refused("elimination", "have the pattern of `matrix`", SparseLDL, star(9), elimination=shared)


@pytest.mark.parametrize("A", [grid(64), GRAPHS["ball"], GRAPHS["sparse, scattered"], star(400)])
def test_fill_is_that_of_minimum_degree(A: sparse.csr_array) -> None:
    """That of SuperLU's multiple minimum degree, whose degrees are exact, and a tenth more.

    Runs of columns that nearly share their rows hold zeros besides, up to 44 % here.
    """
    options = {"SymmetricMode": True}
    theirs = splu(
        sparse.csc_array(A), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options
    )
    order = minimum_degree(A)
    ours = splu(
        sparse.csc_array(A[order][:, order]),
        permc_spec="NATURAL",
        diag_pivot_thresh=0.0,
        options=options,
    )
    assert ours.L.nnz <= 1.1 * theirs.L.nnz
    assert ours.L.nnz <= Elimination.of(A).fill + A.shape[0] <= 1.5 * ours.L.nnz


def test_patterns_that_are_not_symmetric():
    """Loops go by one triangle and by the other: rounding in one is taken out, more is refused."""
    A = sparse.csr_array(sparse.diags_array([-1.0, 3.0, -1.0], offsets=[-1, 0, 1], shape=(50, 50)))
    loose = sparse.coo_array(([1e-17, -1e-17], ([3, 40], [30, 7])), shape=A.shape)
    b = np.arange(50.0)
    found = SparseLDL(sparse.csr_array(A + loose)).solve(b)
    np.testing.assert_allclose(A @ found, b, atol=1e-12)
    for half in (sparse.triu(A), sparse.tril(A)):
        with pytest.raises(InvalidInputError, match="be symmetric"):
            SparseLDL(sparse.csr_array(half))
