"""Dense and sparse linear algebra on bare arrays; nothing here knows about geometry."""

from spectra_kit.linalg.cholesky import SparseCholesky
from spectra_kit.linalg.ldl import Inertia, SparseLDL
from spectra_kit.linalg.orthonormal import orthonormalize
from spectra_kit.linalg.products import spmm

__all__ = ["Inertia", "SparseCholesky", "SparseLDL", "orthonormalize", "spmm"]
