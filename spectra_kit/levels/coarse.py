"""The Galerkin operator of a coarse level."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from spectra_kit.levels.interpolation import prolongation
from spectra_kit.levels.subset import Subset, well_spread
from spectra_kit.operators.laplacian import Laplacian

Floats = NDArray[np.float64]


class Coarse(NamedTuple):
    """An operator restricted to functions that a subset of the points determines.

    A function u on the subset stands for ``prolongation @ u`` on all points: energies and inner
    products of these are exact, so Ritz values and M-orthonormality here are those on all
    points.

    Attributes
    ----------
    subset : Subset
        Indices of the points, and how far they are apart.
    prolongation : csr_array of shape (n, n_subset)
        P; see `levels.prolongation`.
    stiffness : csr_array of shape (n_subset, n_subset)
        ``P^T L P``.
    mass : csr_array of shape (n_subset, n_subset)
        ``P^T M P``, not diagonal: with its row sums instead, the eigenvalues would be off by more
        than all else.
    points : ndarray of shape (n_subset, 3)
    lumped : ndarray of shape (n_subset,)
        Area that each point stands for; positive, with the total of M.
    """

    subset: Subset
    prolongation: sparse.csr_array
    stiffness: sparse.csr_array
    mass: sparse.csr_array
    points: Floats
    lumped: Floats


def coarsen(laplacian: Laplacian, n_points: int) -> Coarse:
    """Restrict an operator to about `n_points` of its points.

    Parameters
    ----------
    laplacian : Laplacian
        On n points.
    n_points : int
        At most so many; see `well_spread`.

    Returns
    -------
    Coarse

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
    >>> from spectra_kit import robust_laplacian
    >>> from spectra_kit.geometry import sphere
    >>> laplacian = robust_laplacian(sphere(subdivisions=4).geometry)
    >>> level = coarsen(laplacian, 500)
    >>> bool(np.isclose(level.mass.sum(), laplacian.area))
    True
    """
    subset = well_spread(laplacian, n_points)
    lift = prolongation(laplacian, subset)
    restrict = sparse.csr_array(lift.T)
    share = np.asarray(abs(restrict) @ laplacian.mass)
    return Coarse(
        subset,
        lift,
        sparse.csr_array(restrict @ (laplacian.stiffness @ lift)),
        sparse.csr_array(restrict @ (sparse.diags_array(laplacian.mass) @ lift)),
        laplacian.points[subset.indices],
        share * (laplacian.area / share.sum()),
    )
