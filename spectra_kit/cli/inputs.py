"""What the commands begin with: geometries from files, and their operators."""

from __future__ import annotations

import dataclasses
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from spectra_kit._types import Ints
from spectra_kit._validate import check_count, quantity
from spectra_kit.cli.options import DEMO, FORMATS, OnOne, Operator, Reading
from spectra_kit.cli.progress import say, step
from spectra_kit.errors import InvalidFileError, InvalidInputError
from spectra_kit.geometry import Geometry, TriangleMesh, creature, read, repair, sample, without_nan
from spectra_kit.operators import Laplacian, laplacian

_REMOVED = {
    "merged_points": "merged point",
    "degenerate_faces": "degenerate face",
    "duplicate_faces": "duplicate face",
    "unreferenced_vertices": "unreferenced vertex",
    "nan_points": "NaN point",
}


def load(file: str, asked: Reading, *, pose: int = 0) -> tuple[Geometry, Ints | None]:
    """Read or make a geometry; repair and sample it where that was asked for.

    Where it was repaired, the new number of each point of the file is returned too.
    """
    geometry: Geometry
    numbers = found = None
    if file == DEMO:
        with step("making the demo"):
            geometry = creature(asked.points, seed=asked.seed, pose=pose)
    else:
        _check_there(Path(file))
        with step(f"reading {file}"):
            found = without_nan(file) if asked.repair else None
            geometry = read(file) if found is None else found.geometry
    if asked.repair:
        with step("repairing"):
            repaired = repair(geometry)
        geometry, numbers = repaired.geometry, repaired.new_index
        counts = dataclasses.asdict(repaired.report)
        if found is not None:
            counts["nan_points"] = found.report.nan_points
            numbers = np.where(found.new_index < 0, -1, numbers[found.new_index])
        done = ", ".join(quantity(n, _REMOVED[what]) for what, n in counts.items() if n)
        say(f"repaired: {done or 'nothing to do'}")
    if asked.cloud is not None:
        if not isinstance(geometry, TriangleMesh):
            raise InvalidInputError("--cloud", "sample a mesh", "a file that holds a point cloud")
        check_count("--cloud", asked.cloud, low=1)
        with step(f"sampling {asked.cloud:,} points"):
            geometry = sample(geometry, asked.cloud, seed=asked.seed)
    return geometry, numbers


def _check_there(path: Path) -> None:
    """Refuse what is no file, or not there, and name the likeliest of those that are."""
    if path.is_dir():
        folder = InvalidInputError("this is a folder, expected a file", advice="name one in it")
        raise InvalidFileError(path, folder)
    if str(path) == "/dev/stdin" or (path.exists() and not path.is_file()):
        pipe = InvalidInputError(
            f"pipes are not read, expected a file whose name ends in its format ({FORMATS})",
            advice="save the data as one",
        )
        raise InvalidFileError(path, pipe)
    if path.exists() or not path.parent.is_dir():
        return
    for near in get_close_matches(path.name, [other.name for other in path.parent.iterdir()], n=1):
        absent = InvalidInputError("there is no such file", advice=f"did you mean {near!r}?")
        raise InvalidFileError(path, absent)


def prepare(asked: OnOne) -> tuple[Geometry, Laplacian]:
    """Read a geometry and assemble its operator."""
    geometry, _ = load(asked.file, asked)
    with step(f"assembling the Laplacian of {geometry.n:,} points"):
        assembled = assemble(asked, geometry)
    if assembled.n_components > 1:
        # Corners that are not joined make a part of every face: each mode then lives on one.
        joined = geometry.n - len(np.unique(geometry.points, axis=0))
        if joined:
            say(
                f"warning: {quantity(joined, 'point')} lie exactly on earlier ones, and the surface"
                f" has {assembled.n_components:,} parts; --repair joins such points"
            )
    return geometry, assembled


def assemble(asked: Operator, geometry: Geometry) -> Laplacian:
    """Assemble the operator with its boundary condition."""
    return laplacian(geometry, operator=asked.operator, boundary=asked.boundary)  # type: ignore[arg-type]
