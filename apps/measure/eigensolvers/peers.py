"""How other packages solve the same eigenproblem, as backends.

Each makes the call that its package makes, with that package's own options, on our (L, M); nothing
is tuned, for better or worse. Absolute shifts such as -0.01 suit surfaces of about unit area, so
`problems` scales every geometry to that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import eigsh

from spectra_kit._core.types import Floats
from spectra_kit.operators import Laplacian

Pairs = tuple[Floats, Floats]


@dataclass(frozen=True, kw_only=True)
class ScipyEigsh:
    """``scipy.sparse.linalg.eigsh`` with its SuperLU factor.

    As called by pyFM 1.3.1 (``mesh/laplacian.py``) and geomfum 1.0.0 (``numerics/eig.py`` from
    ``LaplacianSpectrumFinder``): everything is scipy's default but ``sigma=-0.01``. These packages
    leave ``tol`` at 0, machine precision; ours do not go that far, so it is measured loosened too.
    """

    sigma: float = -0.01
    tol: float = 0.0

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Pairs:
        """See `Eigensolver`."""
        L, M = _csc(laplacian)
        values, vectors = eigsh(L, k=k, M=M, sigma=self.sigma, tol=self.tol)
        return values, vectors


@dataclass(frozen=True, kw_only=True)
class DiffusionNetEigsh:
    """The same function as DiffusionNet calls it (``geometry.py``, ``compute_operators``).

    It adds eps to the diagonal of L, eps of the mean mass to M, and shifts by eps, towards the
    spectrum. Its eigenvalues carry the first, eps * n / area on average; negative ones are clipped.
    """

    eps: float = 1e-8

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Pairs:
        """See `Eigensolver`."""
        mass = laplacian.mass + self.eps * laplacian.mass.mean()
        L = (laplacian.stiffness + self.eps * sparse.eye_array(laplacian.n)).tocsc()
        values, vectors = eigsh(L, k=k, M=sparse.diags_array(mass), sigma=self.eps)
        return np.clip(values, 0.0, None), vectors


@dataclass(frozen=True, kw_only=True)
class LapySolver:
    """``lapy.Solver(...).eigs``, version 1.7.0, with its Cholesky factor (``use_cholmod=True``).

    LaPy assembles finite elements of its own from a mesh; here it is given our (L, M) instead.
    """

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Pairs:
        """See `Eigensolver`."""
        from lapy import Solver, TriaMesh

        # The constructor wants a mesh; its matrices are replaced at once.
        corners = np.eye(3), np.array([[0, 1, 2]])
        solver = Solver(TriaMesh(*corners), lump=True, use_cholmod=True)
        solver.stiffness, solver.mass = _csc(laplacian)
        values, vectors = solver.eigs(k=k)
        return values, vectors


@dataclass(frozen=True, kw_only=True)
class LibiglSpectra:
    """``igl.spectra.eigs`` for the smallest magnitudes: Lanczos of the Spectra library.

    As in libigl's tutorial, ``igl.spectra.eigs(-igl.cotmatrix(V, F), mass, k, EIGS_TYPE_SM)``; our
    L has that sign already. It shifts by 1e-8 and does not subtract that again.
    """

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Pairs:
        """See `Eigensolver`."""
        from igl import spectra

        L, M = _csc(laplacian)
        vectors, values = spectra.eigs(L, M, k, spectra.EIGS_TYPE_SM)
        return values, vectors


def _csc(laplacian: Laplacian) -> tuple[sparse.csc_array, sparse.csc_array]:
    """Return L and M as these packages hold them."""
    mass = sparse.diags_array(laplacian.mass)
    return sparse.csc_array(laplacian.stiffness), sparse.csc_array(mass)
