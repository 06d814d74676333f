"""What the commands begin with: geometries from files, and their operators."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np

from spectra_kit._core.types import Ints
from spectra_kit._core.validate import check_count, quantity
from spectra_kit.cli.options import DEMO, FORMATS, OnOne, Operator, Reading
from spectra_kit.cli.progress import say, step
from spectra_kit.errors import InvalidFileError, InvalidInputError
from spectra_kit.geometry import (
    Geometry,
    TriangleMesh,
    creature,
    largest_component,
    read,
    repair,
    sample,
    without_nan,
)
from spectra_kit.operators import Laplacian, laplacian

_REMOVED = {
    "merged_points": "merged point",
    "near_points": "nearly coincident point",
    "degenerate_faces": "degenerate face",
    "duplicate_faces": "duplicate face",
    "unreferenced_vertices": "unreferenced vertex",
    "nan_points": "NaN point",
    "turned_faces": "turned face",
    "hanging_vertices": "vertex inside a cut edge",
}


@dataclass(frozen=True, eq=False)
class Numbering:
    """The points of a file, and which of those that are matched each has become."""

    new: Ints | None  # (n,), -1 where a point was left out; None where all are as they were
    n_new: int

    @property
    def n(self) -> int:
        """Number of points in the file."""
        return self.n_new if self.new is None else len(self.new)

    @property
    def first(self) -> Ints:
        """The first point of the file that each matched one is, shape (n_new,)."""
        found = np.arange(self.n_new)
        if self.new is not None:
            kept = np.flatnonzero(self.new >= 0)[::-1]
            found[self.new[kept]] = kept  # the last one written is the first in the file
        return found

    def number(self, points: Ints) -> Ints:
        """Return what points of the file are called now; -1 where they are not known."""
        return points if self.new is None else np.where(points < 0, -1, self.new[points])

    def spread(self, values: Any, lacking: float) -> Any:
        """Return values at matched points at all points of the file."""
        if self.new is None:
            return values
        return np.where(self.new < 0, lacking, values[self.new]).astype(values.dtype)


def load(file: str, asked: Reading, *, pose: int = 0) -> tuple[Geometry, Numbering]:
    """Read or make a geometry; repair it, take its largest part, sample it, as was asked for.

    What has become of the points of the file is returned too; nothing of it where it was sampled.
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
    if asked.largest and isinstance(geometry, TriangleMesh):
        part, n = largest_component(geometry), geometry.n
        kept = np.full(n + 1, -1)  # the last is of what a repair removed
        kept[part.vertex_index] = np.arange(part.mesh.n)
        numbers = kept[:n] if numbers is None else kept[numbers]
        geometry = part.mesh
        if left := n - part.mesh.n:
            say(f"the largest part: {geometry.n:,} points; {left:,} left out")
    if asked.cloud is not None:
        if not isinstance(geometry, TriangleMesh):
            raise InvalidInputError("--cloud", "sample a mesh", "a file that holds a point cloud")
        check_count("--cloud", asked.cloud, low=1)
        with step(f"sampling {asked.cloud:,} points"):
            geometry = sample(geometry, asked.cloud, seed=asked.seed)
    return geometry, Numbering(None if asked.cloud else numbers, geometry.n)


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
        return geometry, assemble(asked, geometry)


def assemble(asked: Operator, geometry: Geometry) -> Laplacian:
    """Assemble the operator with its boundary condition."""
    return laplacian(geometry, operator=asked.operator, boundary=asked.boundary)  # type: ignore[arg-type]
