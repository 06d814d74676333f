"""The sources of geodesic distances, as the command line names them."""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np

from spectra_kit._types import Floats
from spectra_kit._validate import check_count, check_indices
from spectra_kit.cli.options import DEMO
from spectra_kit.errors import InvalidInputError
from spectra_kit.geodesics.sources import FacePoint, nearest_source
from spectra_kit.geometry import Geometry, TriangleMesh

Source = int | FacePoint


def check_named(arguments: argparse.Namespace) -> None:
    """Refuse what needs no geometry to be seen wrong; give the demo its source."""
    check_count("--farthest", arguments.farthest, low=0)
    named = arguments.source or arguments.at or arguments.face
    if not named and not arguments.farthest:
        if arguments.file != DEMO:
            raise InvalidInputError(
                "distances need at least one source; name some by --source, --at, --face or"
                " --farthest"
            )
        arguments.farthest = 1
    changed = arguments.repair or arguments.cloud is not None
    if changed and arguments.file != DEMO and (arguments.source or arguments.face):
        raise InvalidInputError(
            "--source and --face number the points and faces of the file, which --repair and"
            " --cloud change; name places by --at instead"
        )
    for face, *_ in arguments.face:
        if not face.is_integer():
            raise InvalidInputError(f"--face must begin with the number of a face, got {face:g}")


def named_sources(arguments: argparse.Namespace, geometry: Geometry) -> list[Source]:
    """Return the points that --source, --at and --face name."""
    check_count("--farthest", arguments.farthest, low=0, high=geometry.n)
    named = arguments.source or np.empty(0, dtype=np.int64)  # of nothing NumPy makes floats
    found: list[Source] = check_indices("--source", named, geometry.n).tolist()
    found += [nearest_source(geometry, place) for place in arguments.at]
    return found + [FacePoint(int(face), (a, b, c)) for face, a, b, c in arguments.face]


def with_farthest(
    sources: list[Source], count: int, distance: Callable[[list[Source]], Floats]
) -> list[Source]:
    """Add `count` points, each the farthest from all before it; in a part not reached, its first.

    Without sources the first is the farthest from point 0, which is none itself.
    """
    if not count:
        return sources
    chosen = list(sources)
    nearest = distance(chosen or [0])
    for i in range(count):
        chosen.append(int(np.argmax(nearest)))
        if i + 1 < count:
            latest = distance(chosen[-1:])
            nearest = latest if len(chosen) == 1 else np.minimum(nearest, latest)
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


def source_records(sources: list[Source]) -> list[dict[str, object]]:
    """What each source is, for the report."""
    return [
        {"face": source.face, "barycentric": source.barycentric}
        if isinstance(source, FacePoint)
        else {"point": source}
        for source in sources
    ]
