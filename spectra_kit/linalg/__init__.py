"""Dense and sparse linear algebra on bare arrays; nothing here knows about geometry."""

from spectra_kit.linalg.cholesky import SparseCholesky
from spectra_kit.linalg.orthonormal import orthonormalize

__all__ = ["SparseCholesky", "orthonormalize"]
