"""`farthest_point_sampling`: points spread over a surface, by distances along it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_count
from spectra_kit.geodesics.distance import exact_field
from spectra_kit.geodesics.heat import HeatGeodesics
from spectra_kit.geodesics.sources import FacePoint, SourcesLike
from spectra_kit.geometry import GeometryLike

Source = int | FacePoint


@checked
def farthest_point_sampling(
    geometry: GeometryLike, count: int, *, start: int | None = None
) -> Ints:
    """Pick points one after the other, each the farthest along the surface from those before.

    Gonzalez, *Clustering to Minimize the Maximum Intercluster Distance*, Theoretical Computer
    Science 38, 1985: no point is farther from the nearest of them than twice what the best choice
    of as many could do.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        With n points; each vertex of a mesh has a face.
    count : int
        Number of points, at most n.
    start : int, optional
        The first of them; by default the farthest from point 0.

    Returns
    -------
    ndarray of shape (count,)
        Indices, in the order in which they were picked, by distances as of `geodesic_distance`. A
        component without any comes first.

    See Also
    --------
    spectra_kit.features.farthest_points : By a distance that a spectrum has, which is quicker.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> ball = sk.geometry.sphere(subdivisions=2).geometry
    >>> some = sk.geodesics.farthest_point_sampling(ball, 2, start=0)
    >>> (ball.points[some[0]] + ball.points[some[1]]).round(6) + 0.0
    array([0., 0., 0.])
    """
    n = geometry.n
    check_count("count", count, low=1, high=n)
    if start is not None:
        check_count("start", start, low=0, high=n - 1)
    heat: list[HeatGeodesics] = []

    def distance(some: SourcesLike) -> Floats:
        if (exact := exact_field(geometry, some)) is not None:
            return exact.distance
        heat[:] = heat or [HeatGeodesics(geometry)]
        return heat[0].distance(some).distance

    first = [] if start is None else [start]
    return np.array(with_farthest(first, count - len(first), distance), dtype=np.int64)


def with_farthest(
    sources: Sequence[Source], count: int, distance: Callable[[list[Source]], Floats]
) -> list[Source]:
    """Add `count` points, each the farthest from all before it; in a part not reached, its first.

    Without sources the first is the farthest from point 0, which is none itself.
    """
    chosen = list(sources)
    if count and not chosen:
        chosen, count = [int(np.argmax(distance([0])))], count - 1
    latest, nearest = list(chosen), np.array(np.inf)
    for _ in range(count):
        nearest = np.minimum(nearest, distance(latest))
        latest = [int(np.argmax(nearest))]
        chosen += latest
    return chosen
