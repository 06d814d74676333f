"""The sources of geodesic distances, as the command line names them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from spectra_kit._types import Floats, Ints
from spectra_kit._validate import check_count, check_indices, quantity
from spectra_kit.cli import program
from spectra_kit.cli.options import DEMO
from spectra_kit.cli.progress import say
from spectra_kit.errors import InvalidInputError
from spectra_kit.geodesics.sources import FacePoint, nearest_source
from spectra_kit.geometry import Geometry, TriangleMesh

Source = int | FacePoint


def check_named(asked: program.Geodesic) -> int:
    """Refuse what needs no geometry to be seen wrong; return how many farthest points to add."""
    check_count("--farthest", asked.farthest, low=0)
    if asked.file != DEMO:
        if not (asked.source or asked.at or asked.face or asked.farthest):
            raise InvalidInputError(
                "distances need at least one source; name some by --source, --at, --face or"
                " --farthest"
            )
        sampled = asked.cloud is not None and (asked.source or asked.face)
        if sampled or (asked.repair and asked.face):
            raise InvalidInputError(
                "--source and --face number the points and faces of the file, which --cloud"
                " changes, and --repair the faces; name places by --at instead"
            )
    for face, *_ in asked.face:
        if not face.is_integer():
            raise InvalidInputError(f"--face must begin with the number of a face, got {face:g}")
    return asked.farthest or int(not (asked.source or asked.at or asked.face))


def named_sources(
    asked: program.Geodesic, geometry: Geometry, numbers: Ints | None
) -> list[Source]:
    """Return the points that --source, --at and --face name.

    `numbers` has the new number of each point of the file, where a repair changed them.
    """
    check_count("--farthest", asked.farthest, low=0, high=geometry.n)
    n = geometry.n if numbers is None else len(numbers)
    points = check_indices("--source", np.array(asked.source, dtype=object), n)
    if numbers is not None:
        points = _renumbered(points, numbers)
    found: list[Source] = points.tolist()
    found += [nearest_source(geometry, place) for place in asked.at]
    return found + [FacePoint(int(face), (a, b, c)) for face, a, b, c in asked.face]


def _renumbered(points: Ints, numbers: Ints) -> Ints:
    """Return points of a file as those of the repaired one, and tell where these differ."""
    new = numbers[points]
    if (new < 0).any():
        lost = ", ".join(map(str, points[new < 0]))
        raise InvalidInputError(
            f"--source names points that --repair drops, as no face has them: {lost}; name others,"
            " or places by --at"
        )
    if moved := [f"{a} is now {b}" for a, b in zip(points, new, strict=True) if a != b]:
        say(f"{quantity(len(moved), 'source')} renumbered by the repair: {', '.join(moved)}")
    return new


def with_farthest(
    sources: list[Source], count: int, distance: Callable[[list[Source]], Floats]
) -> list[Source]:
    """Add `count` points, each the farthest from all before it; in a part not reached, its first.

    Without sources the first is the farthest from point 0, which is none itself.
    """
    if count and not sources:
        first = int(np.argmax(distance([0])))
        return with_farthest([first], count - 1, distance)
    chosen, latest = list(sources), list(sources)
    nearest: Floats = np.array(np.inf)
    for _ in range(count):
        nearest = np.minimum(nearest, distance(latest))
        latest = [int(np.argmax(nearest))]
        chosen += latest
    return chosen


def positions(sources: list[Source], geometry: Geometry) -> Floats:
    """Coordinates (s, 3)."""
    found = []
    for source in sources:
        if isinstance(source, int):
            found.append(geometry.points[source])
        elif isinstance(geometry, TriangleMesh):
            found.append(source.position(geometry))
    return np.array(found)
