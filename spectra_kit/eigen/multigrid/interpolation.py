"""Sparse interpolation from a subset of points to all, within the surface."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from spectra_kit._core.threads import in_threads, shares
from spectra_kit._core.validate import frozen
from spectra_kit._sparse.products import rows_of
from spectra_kit.eigen.multigrid.subset import Subset
from spectra_kit.errors import InvalidInputError

if TYPE_CHECKING:
    from spectra_kit.eigen.multigrid.coarse import Coarse
    from spectra_kit.operators.laplacian import Laplacian

_REACH = 2.5  # radius of influence of a point, in radii of the subset: some 15 reach each point
_FLAT = 0.02  # share of the widest variance below which neighbours lie on a line


def prolongation(operator: Laplacian | Coarse, subset: Subset) -> sparse.csr_array:
    """Return the matrix that carries values on a subset to all points.

    Parameters
    ----------
    operator : Laplacian or Coarse
        On n points; the off-diagonal pattern of its stiffness says which are neighbours.
    subset : Subset
        From `well_spread`.

    Returns
    -------
    csr_array of shape (n, n_subset)
        Rows sum to one. It reproduces functions that are linear along a plane, carries smooth
        ones with an error of second order in the radius, and smooths what is rougher. Two sheets
        of the surface do not mix, however close, but where they meet within five radii.

    Raises
    ------
    InvalidInputError
        If a point has none of the subset within reach.

    Notes
    -----
    Moving least squares (Lancaster and Salkauskas, 1981), linear in the tangent plane, over
    the subset's points within 2.5 radii that the graph connects inside that ball. It
    approximates rather than interpolates: the smoother weights leave a Galerkin operator less
    than half the error in the eigenvalues, at the same number of points, that interpolating ones
    leave.

    Examples
    --------
    >>> from spectra_kit import robust_laplacian
    >>> from spectra_kit.geometry import sphere
    >>> from spectra_kit.eigen.multigrid import prolongation, well_spread
    >>> laplacian = robust_laplacian(sphere(subdivisions=4).geometry)
    >>> subset = well_spread(laplacian, 500)
    >>> carried = prolongation(laplacian, subset) @ laplacian.points[subset.indices]
    >>> bool(abs(carried - laplacian.points).max() < 0.02)
    True
    """
    from spectra_kit.eigen.multigrid._kernels import balls, interpolate

    points, n = frozen(operator.points), operator.n
    starts, neighbours, _ = rows_of(operator.stiffness)
    reach = _REACH * subset.radius
    m = len(subset.indices)
    around = (starts, neighbours, points, subset.indices, reach)
    parts = in_threads(balls, ((*around, *rows) for rows in shares(m)))
    counts, members = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    ends = np.concatenate([[0], np.cumsum(counts)])
    within = sparse.csr_array((np.ones(len(members), bool), members, ends), (m, n)).tocsc()
    indptr, columns = within.indptr.astype(np.int64), within.indices.astype(np.int32)
    if (empty := np.flatnonzero(np.diff(indptr) == 0)).size:
        raise InvalidInputError(
            "subset",
            f"come within {reach:.3g} of every point",
            f"{empty.size} points out of reach, the first {empty[0]}",
            advice="take it from well_spread of the same operator",
        )
    centres = points[subset.indices]
    weights = np.empty(len(columns))
    fixed = (points, centres, indptr, columns, reach, _FLAT)
    in_threads(interpolate, ((*fixed, *rows, weights) for rows in shares(n)))
    if len(columns) < np.iinfo(np.int32).max:  # half the memory, and what torch wants
        indptr = indptr.astype(np.int32)
    return sparse.csr_array((weights, columns, indptr), shape=(n, m))
