"""Dense and sparse linear algebra on bare arrays; nothing here knows about geometry."""

from spectra_kit._sparse.coarse_space import (
    AdditiveTwoLevel,
    CoarseSpace,
    Preconditioner,
    ProjectedTwoLevel,
)
from spectra_kit._sparse.conjugate_gradients import pcg
from spectra_kit._sparse.constant_kernel import ConstantKernel
from spectra_kit._sparse.grounded import GroundedCholesky
from spectra_kit._sparse.incomplete_cholesky import IncompleteCholesky
from spectra_kit._sparse.ldl import Inertia, SparseLDL
from spectra_kit._sparse.orthonormal import orthonormalize
from spectra_kit._sparse.products import spmm
from spectra_kit._sparse.solution import LinearSolution

__all__ = [
    "AdditiveTwoLevel",
    "CoarseSpace",
    "ConstantKernel",
    "GroundedCholesky",
    "IncompleteCholesky",
    "Inertia",
    "LinearSolution",
    "Preconditioner",
    "ProjectedTwoLevel",
    "SparseLDL",
    "orthonormalize",
    "pcg",
    "spmm",
]
