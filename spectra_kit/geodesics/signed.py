"""`signed_distance`: how far points are from curves, and on which side of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_indices
from spectra_kit.errors import InvalidInputError
from spectra_kit.geodesics.vectors import VectorHeat
from spectra_kit.geometry import GeometryLike
from spectra_kit.geometry.vectors import unit_vectors
from spectra_kit.operators import oriented_triangles
from spectra_kit.operators.tangent import outward
from spectra_kit.operators.triangle_calculus import opposite_cotangents

_CANCELLED = 1e-9  # of a step along a curve


@checked
def signed_distance(geometry: GeometryLike, curves: ArrayLike | Sequence[ArrayLike]) -> Floats:
    """Measure how far all points are from oriented curves, and on which side.

    Feng and Crane, *A Heat Method for Generalized Signed Distance*, ACM TOG 43(4), 2024: normals of
    the curves are carried away by `VectorHeat`, and the distance is the function whose slopes along
    the edges are nearest to the unit vectors, with the weights of the Laplacian.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        Of n points, with an outside: see `oriented_triangles`, which tells where there is none.
    curves : array_like of shape (m,), or sequence of these
        Vertices along each curve, which is closed if it ends where it began. Those that follow each
        other need not be neighbours, but near.

    Returns
    -------
    ndarray of shape (n,)
        In length, zero on the curves; negative to the left of them, seen from outside: inside of
        what is walked around counter-clockwise. Around the ends of an open curve the sign changes
        gradually. NaN on components without a curve.

    Examples
    --------
    Of the equator of the unit sphere, walked eastwards, to its north pole:

    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> ball = sk.geometry.sphere(subdivisions=4).geometry
    >>> x, y, z = ball.points.T
    >>> east = np.flatnonzero(abs(z) < 1e-9)
    >>> east = east[np.argsort(np.arctan2(y, x)[east])]
    >>> distance = sk.geodesics.signed_distance(ball, [*east, east[0]])
    >>> bool(abs(distance[np.argmax(z)] + np.pi / 2) < 0.05)
    True
    """
    chains = _check_curves(curves, geometry.n)
    heat = VectorHeat(geometry)
    triangulation, axes = heat.triangulation, heat.frames.axes
    points = triangulation.points / heat._unit[:, None]
    normals = outward(axes, points, oriented_triangles(geometry))[:, 2]
    put = np.zeros((geometry.n, 3))
    for chain in chains:
        steps = np.diff(points[chain], axis=0)
        for end in (chain[:-1], chain[1:]):
            np.add.at(put, end, np.cross(steps, normals[end]) / 2)
    heated = np.einsum("nra,na->nr", axes[:, :2], put)
    if not np.abs(heated).max() > _CANCELLED * np.abs(np.diff(points[chains[0]], axis=0)).max():
        raise InvalidInputError(
            "curves", "have a left and a right", "some that are walked there and back"
        )
    vectors = np.nan_to_num(heat._directions(heated.reshape(-1, 1))[0])
    # The rise along each side, by the vectors at both its ends.
    i = triangulation.corners.astype(np.int64).ravel()
    j = np.roll(triangulation.corners, -1, axis=1).astype(np.int64).ravel()
    chords, slope = points[j] - points[i], np.zeros(len(i))
    for end in (i, j):
        straight = np.einsum("era,ea->er", axes[end, :2], chords)
        straight = np.einsum("er,era->ea", unit_vectors(straight), axes[end, :2])
        slope += np.einsum("ea,ea->e", straight, vectors[end]) / 2
    weights = triangulation.share / 2 * opposite_cotangents(triangulation.lengths)
    rise = slope * (weights * triangulation.lengths).ravel()
    flow = np.subtract(*(np.bincount(end, rise, geometry.n) for end in (j, i)), dtype=np.float64)
    held, labels = np.unique(np.concatenate(chains)), triangulation.laplacian.component_labels
    distance = triangulation.laplacian.solve(flow, fixed=held)
    distance[~np.isin(labels, labels[held])] = np.nan
    return distance


def _check_curves(curves: Any, n: int) -> list[Ints]:
    """Return the vertices along each curve, none after itself."""
    several = isinstance(curves, Sequence) and len(curves) > 0 and np.ndim(curves[0]) > 0
    chains = [check_indices("curves", curve, n) for curve in (curves if several else [curves])]
    for chain in chains:
        if chain.ndim != 1 or len(chain) < 2 or (np.diff(chain) == 0).any():
            expected = "have two vertices or more each, none twice in a row"
            raise InvalidInputError("curves", expected, f"{chain.ravel()[:9].tolist()}")
    return chains
