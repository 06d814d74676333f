"""What all solvers owe to what they are given."""

import numpy as np
from one_system import path
from scipy import sparse

from spectra_kit._sparse import (
    AdditiveTwoLevel,
    CoarseSpace,
    ConstantKernel,
    GroundedCholesky,
    IncompleteCholesky,
    ProjectedTwoLevel,
    SparseLDL,
    orthonormalize,
    pcg,
    spmm,
)


def test_nothing_that_is_given_is_written_to() -> None:
    """Neither matrices nor right-hand sides nor starts; read-only ones are taken as well."""
    n, rng = 60, np.random.default_rng(0)
    A, kernel = path(n), ConstantKernel(np.zeros(n, int))
    held = sparse.csr_array(A + sparse.eye_array(n))
    b, start = kernel.remove(rng.standard_normal(n)), rng.standard_normal(n)
    Y, mass = rng.standard_normal((n, 5)), rng.uniform(1, 2, n)
    given = [A.data, A.indices, A.indptr, held.data, held.indices, held.indptr, b, start, Y, mass]
    before = [array.copy() for array in given]
    base, coarse = IncompleteCholesky(held), CoarseSpace(Y, matrix=held, dtype=np.float64)
    additive, projected = AdditiveTwoLevel(base, coarse), ProjectedTwoLevel(base, coarse, held)
    solvers = [
        lambda: pcg(A, b, start=start, kernel=kernel).x,
        lambda: pcg(held, b, start=start).x,
        lambda: pcg(held, b, start=start, preconditioner=additive).x,
        lambda: pcg(held, b, start=start, preconditioner=projected).x,
        lambda: GroundedCholesky(A, kernel).solutions([b])[0].x,
        lambda: SparseLDL(held).solve(b),
        lambda: SparseLDL(held).solve(Y),
        lambda: IncompleteCholesky(held, drop=0.01, relaxation=0.5).solve(b),
        lambda: coarse.solve(b),
        lambda: additive.solve(b),
        lambda: projected.solve(b),
        lambda: spmm(held, Y),
        lambda: orthonormalize(Y, mass),
    ]
    found = [solve() for solve in solvers]
    for array, old in zip(given, before, strict=True):
        np.testing.assert_array_equal(array, old)
        array.flags.writeable = False
    for solve, first in zip(solvers, found, strict=True):
        np.testing.assert_array_equal(solve(), first)
        assert not any(np.shares_memory(first, array) for array in given)
