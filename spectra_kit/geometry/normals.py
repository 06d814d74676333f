"""Normals of point clouds: estimated from neighbours, then turned outwards together."""

from __future__ import annotations

from heapq import heapify, heappop, heappush

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_count, real_array
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import PointCloud, box_unit

_OPEN = 0.25  # mean size of the winding number, below which a surface encloses nothing; 1/2 if all
_PASSES = 3  # of winding numbers; the first turns nearly all that will be turned
_ROUNDS = 5  # of votes
_APART = 1e-9  # distance of the nearest points over their extent, below which nothing winds


@checked
def estimate_normals(cloud: PointCloud, *, n_neighbors: int = 12) -> Floats:
    """Fit a plane to the neighbours of each point.

    Parameters
    ----------
    cloud : PointCloud
        With n points, at least three.
    n_neighbors : int, default 12
        Of the point itself, which counts too; capped at n - 1. More smooth noise and round edges.

    Returns
    -------
    ndarray of shape (n, 3)
        Unit vectors, each with one of its two signs; see `orient_normals`.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.geometry import estimate_normals, sphere
    >>> cloud = sphere(subdivisions=3).geometry.as_cloud()
    >>> normals = estimate_normals(cloud)
    >>> bool(np.allclose(np.abs(np.sum(normals * cloud.points, axis=1)), 1, atol=0.01))
    True
    """
    points = _check_cloud(cloud)
    _, near = _neighbors(points, n_neighbors)
    offsets = points[np.column_stack([np.arange(len(points)), near])]
    offsets = offsets - offsets.mean(axis=1, keepdims=True)
    _, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets))
    return np.asarray(axes[:, :, 0])


@checked
def orient_normals(cloud: PointCloud, normals: ArrayLike, *, n_neighbors: int = 12) -> Floats:
    """Turn normals such that they agree with each other and point outwards.

    Parameters
    ----------
    cloud : PointCloud
        With n points, at least three.
    normals : array_like of shape (n, 3)
        Unit vectors of any sign, such as those of `estimate_normals`.
    n_neighbors : int, default 12
        Points that agree with a point on the side.

    Returns
    -------
    ndarray of shape (n, 3)
        `normals` times 1 or -1. Each component of the neighbour graph is turned outwards on its
        own; on an open sheet, away from its centroid.

    Notes
    -----
    Neighbours vote for the side with the inner product of their normals (Hoppe et al. 1992), and
    groups that agree vote together; parts that came out inside out are found by their winding
    number (Barill et al. 2018). Fails where two sheets are nearer to each other than the points
    of one.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.geometry import estimate_normals, orient_normals, torus
    >>> cloud = torus(n=600).geometry.as_cloud()
    >>> normals = orient_normals(cloud, estimate_normals(cloud))
    >>> outer = np.hypot(*cloud.points[:, :2].T) > 1
    >>> bool((np.sum(normals * cloud.points, axis=1)[outer] > 0).all())
    True
    """
    points = _check_cloud(cloud)
    vectors = real_array("normals", normals)
    if vectors.shape != points.shape:
        raise InvalidInputError(
            "normals", f"have shape {points.shape} like the points", vectors.shape
        )
    if not np.allclose(np.linalg.norm(vectors, axis=1), 1, atol=1e-6):
        raise InvalidInputError("normals", "be unit vectors", advice="divide them by their length")
    distances, near = _neighbors(points, n_neighbors)
    n, k = near.shape
    i, j = np.repeat(np.arange(n), k), near.ravel()
    votes = symmetric_votes(n, i, j, np.einsum("er,er->e", vectors[i], vectors[j]))
    signs, labels = agree_on_signs(votes)
    # The disc that reaches the last neighbour holds k points besides this one.
    areas = np.pi * distances[:, -1:] ** 2 / k
    return vectors * turn_outwards(points, vectors * areas, signs, labels, votes)[:, None]


def _check_cloud(cloud: PointCloud) -> Floats:
    if cloud.n < 3:
        raise InvalidInputError("cloud", "have at least 3 points", cloud.n)
    return np.asarray(cloud.points / box_unit(cloud.points))


def _neighbors(points: Floats, n_neighbors: int) -> tuple[Floats, Ints]:
    from scipy.spatial import cKDTree  # slow to import

    k = min(check_count("n_neighbors", n_neighbors, low=2), len(points) - 1)
    distances, near = cKDTree(points).query(points, k + 1)
    return distances[:, 1:], near[:, 1:]


def symmetric_votes(n: int, i: Ints, j: Ints, votes: Floats) -> sparse.csr_array:
    """Return the (n, n) sums of `votes` on the pairs (i, j), both ways round."""
    one_way = sparse.coo_array((votes, (i, j)), shape=(n, n)).tocsr()
    both = one_way + one_way.T
    both.eliminate_zeros()
    return both


def agree_on_signs(votes: sparse.csr_array) -> tuple[Floats, Ints]:
    """Give the points signs that most of the symmetric `votes` agree with, the clearest first.

    Returns the signs, arbitrary for each component as a whole, and the component of each point.

    Hoppe, DeRose, Duchamp, McDonald and Stuetzle, *Surface Reconstruction from Unorganized
    Points*, SIGGRAPH 1992, propagate along a spanning tree, where one wrong edge turns all behind
    it. Here groups that were joined add up their votes before they decide about a third: greedy
    contraction, as Keuper et al., *Efficient Decomposition of Image and Mesh Graphs by Lifted
    Multicuts*, ICCV 2015.
    """
    n = votes.shape[0]
    rows = sparse.triu(votes, 1).tocoo()
    others: list[dict[int, float]] = [{} for _ in range(n)]
    queue = []
    for i, j, vote in zip(*(c.tolist() for c in rows.coords), rows.data.tolist(), strict=True):
        others[i][j] = others[j][i] = vote
        queue.append((-abs(vote), i, j))
    heapify(queue)
    signs = np.ones(n)
    members = [[i] for i in range(n)]
    while queue:
        strength, i, j = heappop(queue)
        if abs(others[i].get(j, 0.0)) != -strength:
            continue  # one of the groups has been joined to another, or their vote has changed
        if len(others[i]) < len(others[j]):
            i, j = j, i
        sign = 1.0 if others[i][j] > 0 else -1.0
        signs[members[j]] *= sign
        members[i] += members[j]
        for third, vote in others[j].items():
            del others[third][j]
            if third != i:
                total = others[i].get(third, 0.0) + sign * vote
                others[i][third] = others[third][i] = total
                if total != 0:
                    heappush(queue, (-abs(total), i, third))
        others[j], members[j] = {}, []
    labels = np.empty(n, dtype=np.int64)
    for label, group in enumerate(filter(None, members)):
        labels[group] = label
    return signs, labels


def turn_outwards(
    points: Floats, vectors: Floats, signs: Floats, labels: Ints, votes: sparse.csr_array
) -> Floats:
    """Turn the signs so that signed normals point out of the body that the points enclose.

    `vectors` (n, 3) are normals as long as their areas are large; the others are those of
    `agree_on_signs`. Each component is turned such that it encloses a positive volume, taken from
    its centroid. If it winds round anything, points of negative winding number are turned first,
    and then those whose neighbours outvote them: the winding number at a point of a body's surface
    is the mean of 1 inside and 0 outside, whatever the sign of the point's own normal; on a limb
    whose normals all point inwards it is the mean of -1 and 0.
    """
    from scipy.spatial import cKDTree  # slow to import

    signs = signs.copy()
    groups = np.split(np.argsort(labels, kind="stable"), np.cumsum(np.bincount(labels))[:-1])
    for group in groups:
        unit = box_unit(points[group])
        p, v = (points[group] - points[group[0]]) / unit, vectors[group] / unit / unit
        signs[group] *= _outward(p, v, signs[group])
        if len(group) > 1 and cKDTree(p).query(p, 2)[0][:, 1].min() < _APART:
            continue  # libigl would halve boxes without end to tell such points apart, and crash
        for _ in range(_PASSES):
            winding = winding_numbers(p, v * signs[group, None])
            inside_out = winding < 0
            if np.abs(winding).mean() < _OPEN or not inside_out.any():
                break
            signs[group[inside_out]] *= -1
    for _ in range(_ROUNDS):
        outvoted = signs * (votes @ signs) < 0
        signs[outvoted] *= -1
    for group in groups:
        signs[group] *= _outward(points[group], vectors[group], signs[group])
    return signs


def winding_numbers(points: Floats, vectors: Floats) -> Floats:
    """Return how often the surface elements wind round each of their own points, shape (n,).

    A point's own element does not count. Barill, Dickson, Schmidt, Levin and Jacobson, *Fast
    Winding Numbers for Soups and Clouds*, SIGGRAPH 2018.
    """
    import igl

    areas = np.linalg.norm(vectors, axis=1)
    here = areas > 0
    normals = vectors[here] / areas[here, None]
    out = np.zeros(len(points))
    if here.sum() < 2:
        return out
    # To both sides of the point, where what its own element adds cancels out.
    step = 0.5 * np.sqrt(areas[here])[:, None] * normals
    queries = np.concatenate([points[here] + step, points[here] - step])
    both = igl.fast_winding_number(points[here], normals, areas[here], queries)
    out[here] = 0.5 * (both[: len(step)] + both[len(step) :])
    return out


def _outward(points: Floats, vectors: Floats, signs: Floats) -> float:
    """Return the sign of the volume that signed surface elements enclose, from their centroid."""
    heights = np.einsum("nr,nr->n", points - points.mean(axis=0), vectors)
    return -1.0 if heights @ signs < 0 else 1.0
