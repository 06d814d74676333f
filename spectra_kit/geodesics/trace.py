"""Exponential and logarithmic map of a surface: `trace_geodesic` and `logarithmic_map`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.checked import checked
from spectra_kit._core.records import Rebuilt
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_count, check_positive
from spectra_kit._core.warn import warn
from spectra_kit.errors import DoubtfulDistanceWarning, InvalidInputError
from spectra_kit.geodesics.cloud_trace import tangent_length, traced_on_cloud
from spectra_kit.geodesics.exact import propagated, soup_of
from spectra_kit.geodesics.paths import SurfacePath, path_of
from spectra_kit.geodesics.sources import FacePoint, points_named
from spectra_kit.geodesics.splits import split_at
from spectra_kit.geodesics.vectors import VectorHeat
from spectra_kit.geometry import GeometryLike, TriangleMesh
from spectra_kit.geometry.vectors import frames_of, unit_vectors
from spectra_kit.operators.checks import of_shape

if TYPE_CHECKING:
    from spectra_kit.geodesics._exact_kernels import Soup

_ROUNDING = 1e-12  # of a length
_ALONG = 1e-9  # of a turn off a boundary, a path that runs along it


class Fan(NamedTuple):
    """The corners around a vertex, one after the other, and the angles they begin at."""

    sides: Ints  # (d,), corners, as the side that begins there
    forward: Ints  # 1 where the turn is from that side to the one before, or -1
    angles: Floats  # of each corner
    begins: Floats  # the sums of those before
    closed: bool

    @property
    def total(self) -> float:
        """All of it: a full turn where the surface is flat."""
        return float(self.angles.sum())

    @property
    def scale(self) -> float:
        """What directions are turned by for each of these angles: all around is a full turn."""
        return 2 * np.pi / self.total if self.closed else 1.0

    def turned(self, i: Any, angle: Any) -> Any:
        """Return angles from the side of corner i as angles from where it begins, or back."""
        return np.where(self.forward[i] > 0, angle, self.angles[i] - angle)


@checked
@dataclass(frozen=True, eq=False)
class LogarithmicMap(Rebuilt):
    """Where points of a surface lie, seen from one of them: direction and distance.

    Attributes
    ----------
    coordinates : ndarray of shape (n, 2)
        Of each point in the tangent plane of the source: its norm is the distance. NaN where no
        path leads.
    axes : ndarray of shape (2, 3)
        Unit axes of that plane: ``coordinates @ axes`` are vectors that `trace_geodesic` takes.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> mesh = sk.geometry.rectangle(n=200).geometry
    >>> found = sk.geodesics.logarithmic_map(mesh, 50)
    >>> bool(abs(found.coordinates @ found.axes - mesh.points + mesh.points[50]).max() < 1e-9)
    True
    """

    coordinates: Floats
    axes: Floats


@checked
def trace_geodesic(
    geometry: GeometryLike,
    source: int | FacePoint,
    direction: ArrayLike,
    *,
    length: float | None = None,
) -> SurfacePath:
    """Follow the straightest path from a point in a direction: the exponential map.

    Polthier and Schmies, *Straightest geodesics on polyhedral surfaces*, Mathematical
    Visualization, 1998; on clouds over quadrics fitted to the points around, as by `curvature`.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        Of any winding.
    source : int or FacePoint
        Where it begins; a point of a cloud.
    direction : array_like of shape (3,)
        In space; what of it is tangent counts. At a vertex, angles are stretched to fill a turn,
        which is turned to where edges fit best, as in `logarithmic_map`.
    length : float, optional
        How far (default: the length of the tangent part of `direction`).

    Returns
    -------
    SurfacePath
        Straight across edges; at a vertex it leaves as much angle on its left as on its right. On
        a cloud its steps are a quarter of the spacing of the points: where it ends is off by about
        the square of that spacing.

    Warns
    -----
    DoubtfulDistanceWarning
        If it is shorter than `length`, as it meets the boundary, or an edge or vertex where more
        than two sheets meet, so that straight on has no meaning; of a cloud, the boundary to half
        a spacing, or where triangles do not agree on the side that is out.

    Examples
    --------
    Once around a sphere:

    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> ball = sk.geometry.sphere(subdivisions=4).geometry
    >>> for one in (ball, ball.as_cloud()):
    ...     path = sk.geodesics.trace_geodesic(one, 0, [0, 0, 1], length=2 * np.pi)
    ...     print(bool(np.linalg.norm(path.points[-1] - ball.points[0]) < 0.05))
    True
    True
    """
    if length is not None:
        check_positive("length", length)
    towards = of_shape("direction", direction, (3,))
    if isinstance(geometry, TriangleMesh):
        path, wanted, missing = _traced_on_mesh(geometry, source, towards, length)
    else:
        path, wanted, missing = traced_on_cloud(geometry, source, towards, length)
    if missing > 0:
        warn(
            f"the path from {source} ends after {wanted - missing:.6g} of {wanted:.6g}, at the"
            " boundary, or where sheets meet or sides clash",
            DoubtfulDistanceWarning,
            advice="take the path as it is, or another direction",
        )
    return path


@checked
def logarithmic_map(geometry: GeometryLike, source: int | FacePoint) -> LogarithmicMap:
    """Return direction and distance of all points, seen from one: inverse of tracing.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        With n points.
    source : int or FacePoint
        Where they are seen from; on a mesh, with one fan of faces around.

    Returns
    -------
    LogarithmicMap
        Of a mesh exact, of the shortest paths: it jumps where two of these are as short, and all
        that is behind a saddle or a hole lies in one direction. Of a cloud by heat, as is
        `VectorHeat.logarithm`, which large meshes may take too: far away it falls short, on a unit
        sphere by 3 % at distances of 2 to 2.8, by a third beyond.

    Warns
    -----
    DoubtfulDistanceWarning
        If the paths to some vertices are lost in triangles that are extremely thin; NaN there.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> mesh = sk.geometry.sphere(subdivisions=3).geometry
    >>> found = sk.geodesics.logarithmic_map(mesh, 0)
    >>> path = sk.geodesics.trace_geodesic(mesh, 0, found.coordinates[100] @ found.axes)
    >>> bool(abs(path.points[-1] - mesh.points[100]).max() < 1e-9)
    True
    """
    from spectra_kit.geodesics._walk_kernels import backtrace

    if not isinstance(geometry, TriangleMesh):
        if isinstance(source, FacePoint):
            raise InvalidInputError("source", "be a point of the cloud, which has no faces", source)
        point = check_count("source", source, low=0, high=geometry.n - 1)
        heat = VectorHeat(geometry)
        vectors, axes = heat.logarithm(point), heat.frames.axes[point, :2]
        return LogarithmicMap(vectors @ axes.T, axes)
    mesh = geometry
    split = split_at(mesh, points_named("source", source, mesh))
    v, n = split.vertices[0], split.mesh.n
    known = propagated(split.mesh, np.array([v]), np.arange(n))
    fan = fan_of(known.soup, v, "source")
    left = [backtrace(known.soup, known.front, w)[3:] for w in range(n)]
    sides, inside = (np.array(column) for column in zip(*left, strict=True))
    reached = np.flatnonzero(sides >= 0)
    place = np.zeros(3 * len(split.mesh.faces), dtype=np.int64)
    place[fan.sides] = np.arange(len(fan.sides))
    i = place[sides[reached]]
    angle = (fan.begins[i] + fan.turned(i, inside[reached])) * fan.scale
    coordinates = np.full((n, 2), np.nan)
    distance = known.distances[reached, None]
    coordinates[reached] = distance * np.column_stack([np.cos(angle), np.sin(angle)])
    coordinates[v] = 0.0
    lost = int((np.isfinite(known.distances[: mesh.n]) & np.isnan(coordinates[: mesh.n, 0])).sum())
    if lost:
        warn(
            f"the paths to {lost} of {mesh.n} vertices are lost in triangles that are extremely"
            " thin; they are NaN",
            DoubtfulDistanceWarning,
            advice="remesh",
        )
    return LogarithmicMap(coordinates[: mesh.n], _axes(split.mesh, fan))


def fan_of(soup: Soup, v: int, name: str) -> Fan:
    """Return the fan of faces around a vertex, if it is one."""
    corners = soup.corners[soup.first[v] : soup.first[v + 1]]
    face, c = corners - corners % 3, corners % 3
    after, before = (soup.tails[face + (c + i) % 3].tolist() for i in (1, 2))
    beside: dict[int, list[int]] = {}
    for i, (one, other) in enumerate(zip(after, before, strict=True)):
        beside.setdefault(one, []).append(i)
        beside.setdefault(other, []).append(i)
    rim = [w for w, corners_there in beside.items() if len(corners_there) == 1]
    at = next((w for w in rim if w in after), after[0])  # where the turn begins
    places, ways, left = list[int](), list[int](), set(range(len(corners)))
    while here := [i for i in beside[at] if i in left]:
        places.append(here[0])
        left.remove(here[0])
        ways.append(1 if after[here[0]] == at else -1)
        at = before[here[0]] if ways[-1] > 0 else after[here[0]]
    several = max(map(len, beside.values())) > 2
    if several or left:
        got = "an edge of more than two faces" if several else "several fans of faces around it"
        raise InvalidInputError(
            name,
            "lie on one sheet",
            f"vertex {v} with {got}, so that directions have no order",
            advice="take a point beside it",
        )
    sides = corners[places]
    angles = np.arctan2(soup.apex_y[sides], soup.apex_x[sides])
    return Fan(sides, np.array(ways), angles, np.append(0.0, np.cumsum(angles)[:-1]), not rim)


def _axes(mesh: TriangleMesh, fan: Fan) -> Floats:
    """Return the axes (2, 3) of the tangent plane, turned so that edges fit their angles best."""
    rows, corner = fan.sides // 3, fan.sides % 3
    at, after, before = (mesh.points[mesh.faces[rows, (corner + i) % 3]] for i in range(3))
    ways = np.stack([after - at, before - at])
    ways /= np.abs(ways).max()  # powers of a length in any unit are in range
    normal = (fan.forward * fan.angles) @ unit_vectors(np.cross(*ways))
    axes = frames_of(unit_vectors(normal))[:2]
    # In any axes of that plane, edges as complex numbers, and what turns them to their angles.
    seen = np.where(fan.forward[:, None] > 0, ways, ways[::-1]) @ axes.T @ [1, 1j]
    angles = np.stack([fan.begins, fan.begins + fan.angles]) * fan.scale
    turn = np.exp(1j * (np.angle(seen) - angles)).sum()
    turn /= abs(turn)
    return np.asarray([[turn.real, turn.imag], [-turn.imag, turn.real]] @ axes)


def _traced_on_mesh(
    mesh: TriangleMesh, source: int | FacePoint, towards: Floats, length: float | None
) -> tuple[SurfacePath, float, float]:
    """Return the straightest path from a point, how long it was to be, and what is missing."""
    split = split_at(mesh, points_named("source", source, mesh))
    v, (soup, unit) = split.vertices[0], soup_of(split.mesh)
    fan = fan_of(soup, v, "source")
    along = _axes(split.mesh, fan) @ towards
    tangent = tangent_length(towards, along)
    turn = float(np.arctan2(*along[::-1])) % (2 * np.pi)
    angle = turn / fan.scale if turn < 2 * np.pi - _ALONG else 0.0
    if angle > fan.total + _ALONG:  # which closed fans have not
        raise InvalidInputError(
            "direction", "lead onto the surface from the boundary", f"{towards.tolist()}"
        )
    wanted = tangent if length is None else float(length)
    faces, ends, missing = _traced(soup, fan, angle, wanted / unit[v])
    return path_of(split, faces, ends, v), wanted, float(missing * unit[v])


def _traced(soup: Soup, fan: Fan, angle: float, length: float) -> tuple[Ints, Floats, float]:
    """Return faces and ends of the segments of a straightest path, and how much is missing."""
    from spectra_kit.geodesics._walk_kernels import CORNER, ENDLESS, MOST, trace

    parts, missing = [], length
    while True:
        i = min(int(np.searchsorted(fan.begins, angle, side="right")) - 1, len(fan.sides) - 1)
        inside = fan.turned(i, min(angle - fan.begins[i], fan.angles[i]))
        side = int(fan.sides[i])
        faces, ends, count, how, met, back, missing = trace(soup, side, float(inside), missing)
        if how == ENDLESS:
            raise InvalidInputError(
                "length",
                f"cross fewer than {MOST} edges",
                f"{length:.3g} times the extent of the surface",
                advice="is the unit the same?",
            )
        parts.append((faces[:count], ends[:count]))
        if how != CORNER or missing <= _ROUNDING * length:
            break
        try:
            fan = fan_of(soup, int(soup.tails[met]), "source")
        except InvalidInputError:  # straight on has no meaning there
            break
        if not fan.closed:
            break
        i = int(np.flatnonzero(fan.sides == met)[0])
        angle = (fan.begins[i] + fan.turned(i, back) + fan.total / 2) % fan.total
    faces, ends = (np.concatenate(column) for column in zip(*parts, strict=True))
    return faces, ends, missing if missing > _ROUNDING * length else 0.0
