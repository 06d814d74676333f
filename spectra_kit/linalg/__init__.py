"""Dense and sparse linear algebra on bare arrays; nothing here knows about geometry."""

from spectra_kit.linalg.coarse_space import (
    AdditiveTwoLevel,
    CoarseSpace,
    Preconditioner,
    ProjectedTwoLevel,
)
from spectra_kit.linalg.conjugate_gradients import pcg
from spectra_kit.linalg.constant_kernel import ConstantKernel
from spectra_kit.linalg.grounded import GroundedCholesky
from spectra_kit.linalg.incomplete_cholesky import IncompleteCholesky
from spectra_kit.linalg.ldl import Inertia, SparseLDL
from spectra_kit.linalg.orthonormal import orthonormalize
from spectra_kit.linalg.products import spmm
from spectra_kit.linalg.solution import LinearSolution

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
