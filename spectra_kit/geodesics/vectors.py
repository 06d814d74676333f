"""`VectorHeat`: vectors and values carried along geodesics by heat, on meshes and clouds."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count, check_positive, quantity, real_array
from spectra_kit._core.warn import warn
from spectra_kit._sparse.ldl import SparseLDL
from spectra_kit.eigen import eigensolve
from spectra_kit.errors import DoubtfulDistanceWarning, InvalidInputError
from spectra_kit.geodesics.heat_step import HeatStep
from spectra_kit.geodesics.sources import FacePoint, spread
from spectra_kit.geometry import GeometryLike
from spectra_kit.geometry.vectors import sums, unit_vectors
from spectra_kit.operators import intrinsic_delaunay, tangent_frames
from spectra_kit.operators.checks import of_shape
from spectra_kit.operators.connection import laplacian_along

_LIFT = 1000  # powers of two by which heat is larger than one at its source, and may fall to
_ROOM = 64  # of these are left to weights of edges
_FLOOR = 1e-290  # before digits are lost
_TANGENT = 1e-6  # share of a vector along the surface, below which it is taken to stand on it

#: What names places of which each has a vector, or a value, of its own.
Places = int | FacePoint | Sequence[int | FacePoint] | NDArray[np.integer | np.bool_]


@checked
class VectorHeat:
    """Vectors and values carried from any places to all points; factors are kept for the next.

    Sharp, Soliman and Crane, *The Vector Heat Method*, ACM TOG 38(3), 2019, with the
    `connection_laplacian`: after a short time, heat that carries vectors is dominated by what came
    along the shortest path, whose direction it has. Lengths are carried as values are.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        Of n points; anything that `intrinsic_delaunay` takes.
    time_coefficient : float, default 1.0
        The time of the heat step over the square of the typical edge of each component. A larger
        one blends what comes from several places more widely.

    Attributes
    ----------
    geometry : TriangleMesh or PointCloud
        As it was given.
    triangulation : IntrinsicTriangulation
        Its Delaunay triangulation.
    frames : TangentFrames
        Its `tangent_frames`.

    Warns
    -----
    DoubtfulDistanceWarning
        If points are so many edges away that no heat arrives there: their vectors are NaN.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> heat = sk.geodesics.VectorHeat(sk.geometry.rectangle(n=200).geometry)
    >>> bool(np.allclose(heat.transport(0, [[3, 4, 0]]), [3, 4, 0]))
    True
    """

    def __init__(self, geometry: GeometryLike, *, time_coefficient: float = 1.0) -> None:
        self.geometry, self._time = geometry, check_positive("time_coefficient", time_coefficient)
        self.triangulation = intrinsic_delaunay(geometry)
        self.frames = tangent_frames(geometry)
        laplacian = self.triangulation.laplacian
        # Each component in a unit of its own, as in `System`.
        self._unit = self.triangulation.spacings[laplacian.component_labels]
        connection = laplacian_along(geometry, self.triangulation, self.frames)
        self._mass = connection.mass / np.repeat(self._unit, 2) ** 2
        step = time_coefficient * connection.stiffness + sparse.diags_array(self._mass)
        self._factor = SparseLDL(sparse.csr_array(step))

    def __repr__(self) -> str:
        return f"VectorHeat(n={self.triangulation.n}, time_coefficient={self._time:g})"

    def transport(self, sources: Places, vectors: ArrayLike) -> Floats:
        """Carry vectors, given at some places, to all points; (n, 3), NaN where none comes.

        `sources` are s vertices or points of faces; `vectors` (s, 3) are taken along the tangent
        planes there: what stands on them is left out. Each point has that of the nearest place, but
        for a blend along the lines between two of them.
        """
        owners, points, shares, _ = spread(sources, self.geometry)
        given = of_shape("vectors", vectors, (int(owners[-1]) + 1, 3))
        along = np.einsum("sra,sa->sr", self.frames.axes[points, :2], given[owners])
        lengths = np.bincount(owners, shares * np.hypot(*along.T))
        if (bad := lengths <= _TANGENT * np.abs(given).max(axis=1)).any():
            raise InvalidInputError(
                "vectors",
                "have a part along the surface",
                f"{given[bad][0]} at place {int(np.argmax(bad))}",
                advice="leave out what is zero, or stands on the surface",
            )
        heat = np.zeros((self.triangulation.n, 2))
        np.add.at(heat, points, along * (shares / np.hypot(*along.T))[:, None])
        carried = self._directions(heat.reshape(-1, 1))[0]
        if np.ptp(lengths) == 0:  # as a rule: one source
            return np.asarray(carried * lengths[0])
        return np.asarray(carried * self.extend(sources, lengths)[:, None])

    def extend(self, sources: Places, values: ArrayLike) -> Floats:
        """Carry values, given at some places, to all points: that of the nearest, NaN without one.

        `values` (s,) or (s, c) become (n,) or (n, c). Between places of about the same distance
        they blend, and none leaves the range of those given.
        """
        owners, points, shares, _ = spread(sources, self.geometry)
        given, count, n = real_array("values", values), int(owners[-1]) + 1, self.triangulation.n
        if given.ndim not in (1, 2) or len(given) != count:
            raise InvalidInputError("values", f"have shape ({count},) or ({count}, c)", given.shape)
        columns = given.reshape(count, -1) / 2  # so that no difference overflows
        low, span = columns.min(axis=0), np.ptp(columns, axis=0)
        share = (columns - low) / np.where(span > 0, span, 1.0)
        weights = [np.ones(count), *(1 + share.T)]
        sides = [np.bincount(points, shares * one[owners], n).astype(np.float64) for one in weights]
        plain, *others = self._heat_step.solve(sides)
        found, warm = np.full((n, len(others)), np.nan), plain.values > 0
        for column, one in enumerate(others):
            ratio = one.values[warm] / plain.values[warm]
            ratio = np.ldexp(ratio, one.exponents[warm] - plain.exponents[warm])
            found[warm, column] = low[column] + span[column] * (ratio - 1).clip(0, 1)
        return (2 * found).reshape(n, *given.shape[1:])

    def logarithm(self, source: int) -> Floats:
        """Return at which tangent vector of a vertex each point lies; (n, 3), NaN beyond reach.

        Who walks straight from the source along the vector of a point, as far as it is long,
        arrives there. Soliman and Sharp, *The Affine Heat Method*, Computer Graphics Forum 44(5),
        2025: beside heat and axes, where the source lies is carried along.
        """
        laplacian, axes, n = self.triangulation.laplacian, self.frames.axes, self.triangulation.n
        vertex = check_count("source", source, low=0, high=n - 1)
        (heat,) = self._heat_step.solve([np.where(np.arange(n) == vertex, 1.0, 0.0)])
        exponents = heat.exponents - heat.exponents[vertex] + _LIFT - _ROOM
        lifted = np.ldexp(heat.values / heat.values[vertex], exponents)
        edges = sparse.coo_array(laplacian.stiffness)
        points = laplacian.points / self._unit[:, None]
        i, j, chords = edges.row, edges.col, points[edges.col] - points[edges.row]
        steps = np.einsum("era,ea->er", axes[i, :2], chords)  # along the plane, as long as in space
        steps = unit_vectors(steps) * np.linalg.norm(chords, axis=1, keepdims=True)
        flow = (self._time * edges.data * lifted[j])[:, None] * steps
        away = self._factor.solve(sums(i, flow, n).ravel()).reshape(n, 2)
        away /= np.where(lifted > _FLOOR, lifted, np.nan)[:, None]
        start = np.zeros((n, 2, 2))
        start[vertex] = np.eye(2)
        carried = self._directions(start.reshape(2 * n, 2))
        turned = np.einsum("cna,nra,nr->nc", carried, axes[:, :2], away)
        return np.asarray(self._unit[vertex] * turned @ axes[vertex, :2])

    def _directions(self, heat: Floats) -> Floats:
        """Return the directions of vector heat, put in as (2n, c); (c, n, 3), NaN without any."""
        n, peak = self.triangulation.n, np.abs(heat / self._mass[:, None]).max(axis=0)
        solved = self._factor.solve(heat / peak * 2.0**_LIFT)
        pairs = np.moveaxis(solved.reshape(n, 2, -1), 2, 0)
        sizes = np.hypot(pairs[:, :, 0], pairs[:, :, 1])
        if (cold := ~(sizes > _FLOOR)).any():
            labels, put = self.triangulation.laplacian.component_labels, heat.reshape(n, -1)
            asked = np.isin(labels, labels[put.any(axis=1)])
            if lost := int((cold & asked).any(axis=0).sum()):
                warn(
                    f"no heat arrives at {quantity(lost, 'point')}, too many edges away: no vector"
                    " is carried there",
                    DoubtfulDistanceWarning,
                    advice="raise `time_coefficient`",
                )
            sizes[cold] = np.nan
        return np.asarray(
            np.einsum("cnr,nra->cna", pairs / sizes[:, :, None], self.frames.axes[:, :2])
        )

    @cached_property
    def _heat_step(self) -> HeatStep:
        """The step that carries values; not needed for vectors of one length."""
        laplacian, unit = self.triangulation.laplacian, self._unit
        points, mass = laplacian.points / unit[:, None], laplacian.mass / unit**2
        return HeatStep(laplacian.stiffness, mass, points, duration=self._time, direct=True)


@checked
def transport_vectors(geometry: GeometryLike, sources: Places, vectors: ArrayLike) -> Floats:
    """Carry vectors from some places to all points along shortest paths, by one `VectorHeat`.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        Of n points.
    sources, vectors
        As of `VectorHeat.transport`: s places, and a vector (s, 3) at each, along the surface.

    Returns
    -------
    ndarray of shape (n, 3)
        Tangent vectors, in the unit of `vectors`; NaN on components without a source.

    Examples
    --------
    North along a meridian of the sphere to the pole:

    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> ball = sk.geometry.sphere(subdivisions=4).geometry
    >>> east, pole = (int(np.argmax(ball.points[:, axis])) for axis in (0, 2))
    >>> sk.geodesics.transport_vectors(ball, east, [[0, 0, 1]])[pole].round(1) + 0.0
    array([-1.,  0.,  0.])
    """
    return VectorHeat(geometry).transport(sources, vectors)


@checked
def smoothest_field(geometry: GeometryLike) -> Floats:
    """Find the tangent vector field that turns and changes least.

    Knöppel, Crane, Pinkall and Schröder, *Globally Optimal Direction Fields*, ACM TOG 32(4), 2013,
    for fields of one direction.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        Of n points.

    Returns
    -------
    ndarray of shape (n, 3)
        Tangent vectors of mean square 1 on each component: its lowest mode, by
        `connection_laplacian`. Which one is arbitrary where several are as smooth.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> field = sk.geodesics.smoothest_field(sk.geometry.rectangle(n=200).geometry)
    >>> bool(np.allclose(np.linalg.norm(field, axis=1), 1))
    True
    """
    triangulation, frames = intrinsic_delaunay(geometry), tangent_frames(geometry)
    laplacian = laplacian_along(geometry, triangulation, frames)
    labels = triangulation.laplacian.component_labels
    coordinates = np.zeros(2 * geometry.n)
    for part in range(triangulation.laplacian.n_components):
        own = np.flatnonzero(np.repeat(labels, 2) == part)
        lowest = laplacian.restricted(own)
        mode = eigensolve(lowest, 1).eigenvectors[:, 0]
        coordinates[own] = mode * np.sqrt(lowest.area / 2)
    return frames.vectors(coordinates)
