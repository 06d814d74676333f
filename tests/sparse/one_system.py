"""One system for all solvers."""

import numpy as np
import pytest
from scipy import sparse

from spectra_kit import delaunay_laplacian, eigensolve
from spectra_kit._sparse import CoarseSpace, ConstantKernel, IncompleteCholesky, pcg
from spectra_kit.errors import ConvergenceError
from spectra_kit.geometry import creature


class Body:
    """A Neumann Laplacian, a right-hand side, its solution, and modes."""

    def __init__(self):
        self.laplacian = delaunay_laplacian(creature(600, seed=0).as_cloud())
        self.A, self.n = self.laplacian.stiffness, self.laplacian.n
        self.kernel = ConstantKernel(self.laplacian.component_labels)
        modes = eigensolve(self.laplacian, 25)
        self.spectrum, self.all_modes = modes.nonzero(), modes.eigenvectors[:, :17]
        self.Y, self.energies = self.all_modes[:, 1:], modes.eigenvalues[1:17]
        self.x = self.kernel.remove(np.linalg.norm(self.laplacian.points, axis=1))
        self.b = self.kernel.remove(self.A @ self.x)
        self.factor = IncompleteCholesky(self.A)
        self.coarse = CoarseSpace(self.spectrum.eigenvectors, energies=self.spectrum.eigenvalues)
        dense = self.A.toarray()
        self.eigenvalues = np.linalg.eigvalsh(dense)
        self.root = np.linalg.cholesky(dense + np.ones(dense.shape) / self.n)


def stopped(*given, **options):
    """What conjugate gradients had found when they gave up."""
    with pytest.raises(ConvergenceError) as error:
        pcg(*given, **options)
    return error.value.partial


def path(n: int, ends: float = 1.0) -> sparse.csr_array:
    """The 1-D Laplacian; singular for ends=1, with zeros beyond both ends for 2."""
    diagonal = np.full(n, 2.0)
    diagonal[[0, -1]] = ends
    off = -np.ones(n - 1)
    return sparse.csr_array(sparse.diags_array([off, diagonal, off], offsets=[-1, 0, 1]))
