"""What the commands begin with: geometries from files, and their operators."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np

import spectra_kit as sk
from spectra_kit._core.types import Ints
from spectra_kit._core.validate import check_count, check_indices, quantity
from spectra_kit.cli.options import DEMO, FORMATS, OnOne, Operator, Reading
from spectra_kit.cli.progress import say, step
from spectra_kit.errors import InvalidFileError, InvalidInputError

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

    new: Ints  # (n,), -1 where a point was left out
    n_new: int

    @property
    def n(self) -> int:
        """Number of points in the file."""
        return len(self.new)

    @property
    def first(self) -> Ints:
        """The first point of the file that each matched one is, shape (n_new,)."""
        found = np.arange(self.n_new)
        kept = np.flatnonzero(self.new >= 0)[::-1]
        found[self.new[kept]] = kept  # the last one written is the first in the file
        return found

    def number(self, points: Ints) -> Ints:
        """Return what points of the file are called now; -1 where they are not known."""
        return np.where(points < 0, -1, self.new[points])

    def named(self, option: str, points: Sequence[int]) -> list[int]:
        """Return what points of the file are called now that an option names, all of them known."""
        given = check_indices(option, np.array(points, dtype=object), self.n)
        numbers = self.number(given)
        if (numbers < 0).any():
            raise InvalidInputError(
                option,
                "name points that --repair and --largest keep",
                f"{', '.join(map(str, given[numbers < 0]))}, which no face has, or none of that"
                " part",
                advice="name others, or places by --at",
            )
        return list(numbers.tolist())

    def spread(self, values: Any, lacking: float) -> Any:
        """Return values at matched points at all points of the file."""
        return np.where(self.new < 0, lacking, values[self.new]).astype(values.dtype)


def load(file: str, asked: Reading, *, pose: int = 0) -> tuple[sk.geometry.Geometry, Numbering]:
    """Read or make a geometry; repair it, take its largest part, sample it, as was asked for.

    What has become of the points of the file is returned too; nothing of it where it was sampled.
    """
    geometry: sk.geometry.Geometry
    found = None
    if file == DEMO:
        with step("making the demo"):
            geometry = sk.geometry.creature(asked.points, seed=asked.seed, pose=pose)
    else:
        check_there(Path(file))
        with step(f"reading {file}"):
            found = sk.geometry.without_nan(file) if asked.repair else None
            geometry = sk.read(file) if found is None else found.geometry
    numbers = np.arange(geometry.n)
    if asked.repair:
        with step("repairing"):
            repaired = sk.geometry.repair(geometry)
        geometry, numbers = repaired.geometry, repaired.new_index
        counts = dataclasses.asdict(repaired.report)
        if found is not None:
            counts["nan_points"] = found.report.nan_points
            numbers = np.where(found.new_index < 0, -1, numbers[found.new_index])
        done = ", ".join(quantity(n, _REMOVED[what]) for what, n in counts.items() if n)
        say(f"repaired: {done or 'nothing to do'}")
    if asked.largest and isinstance(geometry, sk.TriangleMesh):
        part, n = sk.geometry.largest_component(geometry), geometry.n
        kept = np.full(n + 1, -1)  # the last is of what a repair removed
        kept[part.vertex_index] = np.arange(part.mesh.n)
        geometry, numbers = part.mesh, kept[numbers]
        if left := n - part.mesh.n:
            say(f"the largest part: {geometry.n:,} points; {left:,} left out")
    if asked.cloud is not None:
        if not isinstance(geometry, sk.TriangleMesh):
            raise InvalidInputError("--cloud", "sample a mesh", "a file that holds a point cloud")
        check_count("--cloud", asked.cloud, low=1)
        with step(f"sampling {asked.cloud:,} points"):
            geometry = sk.geometry.sample(geometry, asked.cloud, seed=asked.seed)
        numbers = np.arange(geometry.n)
    return geometry, Numbering(numbers, geometry.n)


def check_there(path: Path) -> None:
    """Refuse what is no file, or not there, and name the likeliest of those that are."""
    with of_file(path):
        if path.is_dir():
            raise InvalidInputError("this is a folder, expected a file", advice="name one in it")
        if str(path) == "/dev/stdin" or (path.exists() and not path.is_file()):
            raise InvalidInputError(
                f"pipes are not read, expected a file whose name ends in its format ({FORMATS})",
                advice="save the data as one",
            )
        if path.exists() or not path.parent.is_dir():
            return
        others = [other.name for other in path.parent.iterdir()]
        for near in get_close_matches(path.name, others, n=1):
            raise InvalidInputError("there is no such file", advice=f"did you mean {near!r}?")


@contextmanager
def of_file(path: str | Path) -> Iterator[None]:
    """Begin what is refused inside the block with the name of a file."""
    try:
        yield
    except InvalidInputError as error:
        raise InvalidFileError(path, error) from error


def prepare(asked: OnOne) -> tuple[sk.geometry.Geometry, sk.Laplacian]:
    """Read a geometry and assemble its operator."""
    geometry, _ = load(asked.file, asked)
    with step(f"assembling the Laplacian of {geometry.n:,} points"):
        return geometry, assemble(asked, geometry)


def assemble(asked: Operator, geometry: sk.geometry.Geometry) -> sk.Laplacian:
    """Assemble the operator with its boundary condition."""
    return sk.laplacian(
        geometry,
        operator=asked.operator,  # type: ignore[arg-type]
        boundary=asked.boundary,
        mass=asked.mass,
    )
