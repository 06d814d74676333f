"""Coarse levels of an operator: a well-spread subset of its points, and the way back to all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components, reverse_cuthill_mckee

from spectra_kit._core.records import Brief, frozen
from spectra_kit._core.threads import in_threads, shares
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_count
from spectra_kit._sparse.products import rows_of
from spectra_kit.errors import InvalidInputError
from spectra_kit.operators.laplacian import Laplacian

# Radius of the balls, where the subset has one point per unit of area and all points `c` times as
# many: 0.99 - 0.37 / sqrt(c). Measured on meshes; the first guess is the last one there.
_PACKED, _GRAINY = 0.99, 0.37
_ROUNDS = 6  # of correction of the radius
_FEWEST = 0.9  # of the points asked for that are near enough


class Subset(NamedTuple):
    """Points that represent all others.

    Attributes
    ----------
    indices : ndarray of shape (n_subset,)
        Ascending.
    radius : float
        Every point of the operator is nearer than this to one of them, in a straight line and
        connected to it within the ball, in length.
    """

    indices: Ints
    radius: float


def well_spread(operator: Laplacian | Coarse, n_points: int) -> Subset:
    """Choose about `n_points` points, evenly spread over the surface whatever the sampling.

    Parameters
    ----------
    operator : Laplacian or Coarse
        The off-diagonal pattern of its stiffness says which points are neighbours.
    n_points : int
        At most so many are chosen, and seldom fewer than 0.9 times as many; at least 1.

    Returns
    -------
    Subset
        No two closer than ``radius`` unless two sheets of the surface come as close. Where points
        lie further apart than that, all are taken.

    Notes
    -----
    A maximal packing of balls by an advancing front, in O(n). It is deterministic.

    Examples
    --------
    >>> from spectra_kit import robust_laplacian
    >>> from spectra_kit.geometry import sphere
    >>> from spectra_kit.eigen.multigrid import well_spread
    >>> subset = well_spread(robust_laplacian(sphere(subdivisions=4).geometry), 100)
    >>> 85 <= len(subset.indices) <= 100
    True
    """
    from spectra_kit.eigen.multigrid._kernels import cover

    check_count("n_points", n_points, low=1, high=operator.n)
    graph, points = operator.stiffness, frozen(operator.points)
    starts, neighbours, _ = rows_of(graph)
    power = 1 / operator.dimension
    grain = _GRAINY * (n_points / operator.n) ** power
    radius = (_PACKED - grain) * (operator.area / n_points) ** power
    low, high = 0.0, np.inf  # radii known to give too many and too few
    best: Subset | None = None
    for _ in range(_ROUNDS):
        indices = cover(starts, neighbours, points, radius)
        count = len(indices)
        if count > n_points:
            low = radius
        else:
            high = radius
            if best is None or count > len(best.indices):
                best = Subset(np.sort(indices).astype(np.int64), float(radius))
            if count >= _FEWEST * n_points:
                break
        guess = radius * (count / (0.5 * (1 + _FEWEST) * n_points)) ** power
        inside = low < guess < high
        radius = guess if inside or high == np.inf else 0.5 * (low + high)
    if best is None and n_points < (parts := connected_components(graph, directed=False)[0]):
        raise InvalidInputError(
            "n_points",
            f"be at least {parts}, one for each connected part of the operator",
            n_points,
            advice="ask for more, or treat the parts one by one",
        )
    while best is None:  # thin shapes: their count falls more slowly than the area suggests
        radius *= 1.5
        indices = cover(starts, neighbours, points, radius)
        if len(indices) <= n_points:
            best = Subset(np.sort(indices).astype(np.int64), float(radius))
    return best


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

    Notes
    -----
    Moving least squares (Lancaster and Salkauskas, 1981), linear in the tangent plane, over
    the subset's points within 2.5 radii that the graph connects inside that ball. It
    approximates rather than interpolates: the smoother weights leave a Galerkin operator less
    than half the error in the eigenvalues, at the same number of points, that interpolating ones
    leave. In volumes, too: linear along all three axes, errors were larger in three shapes of four.

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
    dimension : int
        2, or 3 in a volume.
    """

    subset: Subset
    prolongation: sparse.csr_array
    stiffness: sparse.csr_array
    mass: sparse.csr_array
    points: Floats
    lumped: Floats
    eigenvalue_spacing: float
    kernel_dimension: int
    dimension: int = 2

    @property
    def n(self) -> int:
        """Number of points."""
        return len(self.points)

    @property
    def area(self) -> float:
        """Total mass, in length^2; of a volume, in length^3."""
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
        mass, lumped = operator._weights, operator.mass
        if mass is lumped:
            mass = sparse.csr_array(sparse.diags_array(lumped))
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
        operator.dimension,
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


_WORTH = 2  # times nearer: points of a mesh are in a good order as a rule, those of a cloud in none


def gathered(laplacian: Laplacian) -> tuple[Laplacian, Ints | None]:
    """Return the operator with its points in another order, and which they are.

    By reverse Cuthill-McKee; as it came, and None, where this brings neighbours hardly nearer.
    """
    matrix = laplacian.stiffness
    rows = np.repeat(np.arange(laplacian.n), np.diff(matrix.indptr))
    order = np.asarray(reverse_cuthill_mckee(matrix, symmetric_mode=True), dtype=np.int64)
    place = np.empty_like(order)
    place[order] = np.arange(laplacian.n)
    before = np.abs(matrix.indices - rows).sum()
    after = np.abs(place[matrix.indices] - place[rows]).sum()
    if before < _WORTH * after:
        return laplacian, None
    return laplacian.restricted(order), order
