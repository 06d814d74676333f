"""Straight on over a cloud: from fitted quadric to fitted quadric."""

from __future__ import annotations

import numpy as np

from spectra_kit._core.records import latest
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count
from spectra_kit.errors import InvalidInputError
from spectra_kit.geodesics.paths import SurfacePath
from spectra_kit.geodesics.sources import FacePoint
from spectra_kit.geometry import PointCloud
from spectra_kit.geometry.vectors import frames_of, unit_vectors
from spectra_kit.operators import oriented_triangles
from spectra_kit.operators.checks import unit_of
from spectra_kit.operators.curvature import REACH, Surroundings, surroundings_of

_STEP = 0.25  # of the spacing of points: errors of steps are well below those of the quadrics
_MOST = 2**20  # steps that are a path, and not a length in another unit
_ROUNDING = 1e-12  # of a length
_OFF = 2.0  # spacings from the nearest point, beyond which nothing is known of the surface
_SLACK = 0.5  # spacings beyond the outermost points that are still on the surface


def traced_on_cloud(
    cloud: PointCloud, source: int | FacePoint, towards: Floats, length: float | None
) -> tuple[SurfacePath, float, float]:
    """Return the straightest path from a point, how long it was to be, and what is missing."""
    from spectra_kit.operators._curvature_kernels import land

    if isinstance(source, FacePoint):
        raise InvalidInputError("source", "be a point of the cloud, which has no faces", source)
    near = check_count("source", source, low=0, high=cloud.n - 1)
    points, around, unit = latest(cloud, _around, ())
    given = (points, *around[:4], np.ones(cloud.n, bool))
    place, normal, reach = points[near], around.normals[near].copy(), REACH * around.spacings[near]
    found, _ = land(*given, near, place.copy(), normal, np.zeros(3), reach)
    if found < 0:
        raise InvalidInputError(
            "source", "have five neighbours or more, not all on a curve", f"point {near}"
        )
    along = towards - (towards @ normal) * normal
    tangent = tangent_length(towards, along)
    along = unit_vectors(along / np.abs(along).max())  # squares of any length are numbers
    wanted = tangent if length is None else float(length)
    missing, step = wanted / unit, _STEP * around.spacings[near]
    if missing > _MOST * step:
        raise InvalidInputError(
            "length",
            f"take fewer than {_MOST} steps",
            f"{wanted:.3g} where points are {step / _STEP * unit:.3g} apart",
            advice="is the unit the same?",
        )
    _, bends = land(*given, near, place.copy(), normal, along, reach)
    way = [place]
    while missing > 0:
        step = min(_STEP * around.spacings[near], missing)
        turn = step * bends / 2  # of the chord from what is tangent
        following = place + step * (np.cos(turn) * along + np.sin(turn) * normal)
        found, bends = land(*given, near, following, normal, along, reach)
        if found < 0 or _beyond(points, around, found, following, normal):
            break
        near, reach = found, REACH * around.spacings[found]
        along /= np.linalg.norm(along)
        chord = float(np.linalg.norm(following - place))
        if step == missing or chord > missing:
            following, chord = place + (following - place) * (missing / chord), missing
        way.append(following)
        place, missing = following, missing - chord
    path = SurfacePath(np.array(way) * unit, np.zeros(0, np.int64), np.zeros((0, 3)))
    return path, wanted, missing * unit


def _around(cloud: PointCloud, _: object) -> tuple[Floats, Surroundings, float]:
    """Return the points in a unit in which squares are numbers, what is around them, and it."""
    unit = unit_of(cloud)
    points = cloud.points / unit
    return points, surroundings_of(points, oriented_triangles(cloud).faces), unit


def tangent_length(towards: Floats, along: Floats) -> float:
    """Return the length of the tangent part of a direction, if it has one."""
    tangent = float(np.linalg.norm(along))
    if not tangent > _ROUNDING * np.linalg.norm(towards):
        raise InvalidInputError(
            "direction",
            "have a part in the tangent plane",
            f"{towards.tolist()}, along the normal" if towards.any() else "the zero vector",
        )
    return tangent


def _beyond(points: Floats, around: Surroundings, near: int, place: Floats, normal: Floats) -> bool:
    """Tell whether a place is beyond the outermost points of a cloud.

    The triangles at the nearest point, `near`, then leave half a turn or more open, the place lies
    in it, and away from the sides next to it. Or that point is far.
    """
    first = 2 * around.starts[near]
    beside = around.rings[first : first + around.sizes[near]]
    spacing = np.median(around.spacings[beside])
    if np.linalg.norm(place - points[near]) > _OFF * spacing:
        return True
    ring = points[beside] - points[near]
    plane = frames_of(normal)[:2].T @ [1, 1j]
    sides, at = ring @ plane, (place - points[near]) @ plane
    sides = sides[np.abs(sides) > _ROUNDING * spacing]  # not those along the normal
    if not len(sides):
        return False
    sides = sides[np.argsort(np.angle(sides))]
    gaps = np.angle(np.roll(sides, -1) / sides) % (2 * np.pi)
    widest = int(np.argmax(gaps))
    rim = sides[[widest, (widest + 1) % len(sides)]]
    if gaps[widest] < np.pi or np.angle(at / rim[0]) % (2 * np.pi) > gaps[widest]:
        return False
    share = (at / rim).real.clip(0, 1)
    return bool(np.abs(at - share * rim).min() > _SLACK * spacing)
