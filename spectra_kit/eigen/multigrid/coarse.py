"""The Galerkin operator of a coarse level."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from spectra_kit._core.threads import in_threads, shares
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import Brief
from spectra_kit._sparse.products import rows_of
from spectra_kit.eigen.multigrid.interpolation import prolongation
from spectra_kit.eigen.multigrid.subset import Subset, well_spread
from spectra_kit.operators.laplacian import Laplacian


@dataclass(frozen=True, eq=False)
class Coarse(Brief):
    """An operator restricted to functions that a subset of its points determines.

    A function u on the subset stands for ``prolongation @ u`` on all points: energies and inner
    products of these are exact, so Ritz values and M-orthonormality here are those on all
    points.

    Attributes
    ----------
    subset : Subset
        Indices of the points in the finer operator, and how far they are apart.
    prolongation : csr_array of shape (n_fine, n)
        P; see `eigen.multigrid.prolongation`.
    stiffness : csr_array of shape (n, n)
        ``P^T L P``.
    mass : csr_array of shape (n, n)
        ``P^T M P``, not diagonal: with its row sums instead, the eigenvalues would be off by more
        than all else.
    points : ndarray of shape (n, 3)
        Coordinates of the subset, in length.
    lumped : ndarray of shape (n,)
        Area that each point stands for; positive, with the total of M.
    eigenvalue_spacing : float
        That of the `Laplacian` at the finest level.
    kernel_dimension : int
        That of the `Laplacian` too: constants are carried to constants.
    """

    subset: Subset
    prolongation: sparse.csr_array
    stiffness: sparse.csr_array
    mass: sparse.csr_array
    points: Floats
    lumped: Floats
    eigenvalue_spacing: float
    kernel_dimension: int

    @property
    def n(self) -> int:
        """Number of points."""
        return len(self.points)

    @property
    def area(self) -> float:
        """Total mass, in length^2."""
        return float(self.lumped.sum())


def coarsen(operator: Laplacian | Coarse, n_points: int) -> Coarse:
    """Restrict an operator to about `n_points` of its points.

    Parameters
    ----------
    operator : Laplacian or Coarse
        On more points than that; a coarse level can be coarsened again.
    n_points : int
        At most so many; see `well_spread`.

    Returns
    -------
    Coarse
        With the interpolation that leads back to all points of `operator`.

    Raises
    ------
    InvalidInputError
        If `n_points` is not in [1, n].

    Notes
    -----
    The subspace of Nasikun, Brandt and Hildebrandt, *Fast Approximation of Laplace-Beltrami
    Eigenproblems*, 2018, with basis functions from moving least squares.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit import robust_laplacian
    >>> from spectra_kit.geometry import sphere
    >>> from spectra_kit.eigen.multigrid import coarsen
    >>> laplacian = robust_laplacian(sphere(subdivisions=4).geometry)
    >>> level = coarsen(laplacian, 500)
    >>> bool(np.isclose(level.mass.sum(), laplacian.area))
    True
    """
    subset = well_spread(operator, n_points)
    lift = prolongation(operator, subset)
    restrict = sparse.csr_array(lift.T)
    if isinstance(operator, Laplacian):
        mass, lumped = sparse.csr_array(sparse.diags_array(operator.mass)), operator.mass
    else:
        mass, lumped = operator.mass, operator.lumped
    share = np.asarray(abs(restrict) @ lumped)
    return Coarse(
        subset,
        lift,
        *_galerkin(restrict, operator.stiffness, mass, lift),
        operator.points[subset.indices],
        share * (operator.area / share.sum()),
        operator.eigenvalue_spacing,
        operator.kernel_dimension,
    )


def _galerkin(
    restrict: sparse.csr_array,
    stiffness: sparse.csr_array,
    mass: sparse.csr_array,
    lift: sparse.csr_array,
) -> tuple[sparse.csr_array, sparse.csr_array]:
    """Return ``P^T L P`` and ``P^T M P``, symmetric to the last bit.

    In threads and in one pass over both, which SciPy's products take six times as long for.
    """
    from spectra_kit.eigen.multigrid._kernels import galerkin_rows

    fixed = [part for matrix in (restrict, stiffness, mass, lift) for part in rows_of(matrix)]
    m = lift.shape[1]
    parts = in_threads(galerkin_rows, ((*fixed, *rows) for rows in shares(m)))
    counts, columns, *both = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
    upper = (sparse.csr_array((data, columns, starts), shape=(m, m)) for data in both)
    energy, weight = (sparse.csr_array(half + sparse.triu(half, 1).T) for half in upper)
    return energy, weight
