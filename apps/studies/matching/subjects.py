"""`Subject`: a geometry with points that correspond to those of other subjects."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.files import parsing
from spectra_kit._core.fingerprint import arrays_digest
from spectra_kit._core.records import Rebuilt, frozen
from spectra_kit._core.types import Ints
from spectra_kit._core.validate import check_count, check_indices
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import Geometry, TriangleMesh, creature, largest_component, repair
from spectra_kit.maps import Truth

#: A landmark that a subject lacks.
LACKING = -1
_KEYS = ("V", "F", "corres")
_PAIRS = "pairs.npz"


@dataclass(frozen=True, eq=False)
class Subject(Rebuilt):
    """A geometry, and the point of each landmark that all subjects of a class share."""

    #: Letters name the class, digits the subject within it: ``cat0`` and ``cat10`` are of one.
    name: str
    geometry: Geometry  #: With n points; a cloud can be a target alone.
    #: (c,): entry i is the same place of the body in every subject of a class; -1 where this one
    #: lacks it.
    landmarks: Ints
    mirrored: Ints | None = None  #: (c,): the place on the other side of the body.
    #: By the names of others, (c,): their points at the landmarks of this one, which are its own.
    images: Mapping[str, Ints] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("landmarks", "mirrored"):
            values = getattr(self, name)
            if values is not None:
                given = np.asarray(values)
                there = np.where(given == LACKING, 0, given)
                check_indices(f"{name} of {self.name}", there, self.geometry.n)
                array = given.astype(np.int64)
                if array.ndim != 1 or array.shape != np.shape(self.landmarks):
                    raise InvalidInputError(
                        f"{name} of {self.name}",
                        f"have shape ({np.size(self.landmarks)},)",
                        f"{array.shape}",
                    )
                object.__setattr__(self, name, frozen(array))

    @property
    def mesh(self) -> TriangleMesh:
        """The geometry of a source: errors are distances along it."""
        if not isinstance(self.geometry, TriangleMesh):
            raise InvalidInputError(
                self.name, "be a mesh, to measure distances along it", "a cloud"
            )
        return self.geometry

    @property
    def species(self) -> str:
        """The name without its digits: what it shares with the others of its class."""
        return self.name.rstrip("0123456789")

    @cached_property
    def digest(self) -> str:
        """Hash of geometry and landmarks: what it is, wherever its file lies."""
        faces = [self.geometry.faces] if isinstance(self.geometry, TriangleMesh) else []
        mirrored = np.empty(0) if self.mirrored is None else self.mirrored
        images = [self.images[name] for name in sorted(self.images)]
        return arrays_digest(self.geometry.points, *faces, self.landmarks, mirrored, *images)


def truth_between(source: Subject, target: Subject) -> Truth:
    """Tell which points of two subjects of one class correspond, with mirror images if known.

    Landmarks that one of them lacks are left out.
    """
    if source.name in target.images:
        there = target.images[source.name]
        return Truth(there[there != LACKING], target.landmarks[there != LACKING])
    if len(source.landmarks) != len(target.landmarks):
        raise InvalidInputError(
            f"`source` and `target` must share their landmarks, got {len(source.landmarks)} of"
            f" {source.name} and {len(target.landmarks)} of {target.name}; match within a class"
        )
    places = [source.landmarks, target.landmarks]
    if source.mirrored is not None:
        places.append(source.mirrored)
    both = np.all([place != LACKING for place in places], axis=0)
    return Truth(*(place[both] for place in places))


def subjects_in(folder: str | os.PathLike[str]) -> dict[str, Subject]:
    """Read the subjects of a folder, by name.

    They are ``NAME.npz`` files with vertices ``V`` (n, 3), faces ``F`` (f, 3), ``corres`` (c,) and,
    where there is a symmetry, ``corres_sym`` (c,), all counted from 0. A ``corres_sym`` that equals
    ``corres`` states none, as in sets without mirrored truth. Other files, and npz files without
    ``corres``, are left alone.

    Or, where truth is told pair by pair, with ``evaluated`` (c,) for ``corres``, and beside them
    ``pairs.npz`` with an array ``A_B`` for each pair: the vertex of B that corresponds to each of
    A. Such scans come as they are: what `repair` leaves of the largest component is taken.
    """
    root = Path(folder)
    if (root / _PAIRS).is_file():
        return _in_pairs(root)
    found = (_read(path) for path in sorted(root.glob("*.npz")))
    subjects = {subject.name: subject for subject in found if subject is not None}
    if not subjects:
        raise InvalidInputError(
            "folder",
            f"hold .npz files with {', '.join(_KEYS)}",
            f"none in {root}",
            advice="check the path, or set SPECTRA_KIT_DATA",
        )
    return subjects


def demo_subjects(n_points: int = 1000, *, poses: int = 4) -> dict[str, Subject]:
    """Make one demo animal in several poses: every vertex is a landmark."""
    check_count("poses", poses, low=2)
    meshes = {f"creature{pose}": creature(n_points, pose=pose) for pose in range(poses)}
    return {name: Subject(name, mesh, np.arange(mesh.n)) for name, mesh in meshes.items()}


def _in_pairs(root: Path) -> dict[str, Subject]:
    """Read subjects whose truth is that of `_PAIRS`."""
    known = _arrays(root / _PAIRS)
    pairs = {tuple(name.split("_", 1)): there for name, there in known.items()}
    made: dict[str, tuple[TriangleMesh, Ints, Ints]] = {}
    for name in sorted({name for pair in pairs for name in pair}):
        file = _arrays(root / f"{name}.npz")
        scan = TriangleMesh(file["V"].astype(np.float64), file["F"].astype(np.int64))
        repaired = repair(scan)
        part = largest_component(cast("TriangleMesh", repaired.geometry))
        kept = np.full(repaired.geometry.n + 1, LACKING)  # the last is of what was removed
        kept[part.vertex_index] = np.arange(part.mesh.n)
        new = np.append(kept[repaired.new_index], LACKING)  # that is -1, the last
        made[name] = part.mesh, new, file["evaluated"].astype(np.int64)
    subjects = {}
    for name, (mesh, new, evaluated) in made.items():
        mine = evaluated[new[evaluated] != LACKING]
        images = {b: made[b][1][there[mine]] for (a, b), there in pairs.items() if a == name}
        subjects[name] = Subject(name, mesh, new[mine], images=images)
    return subjects


def _arrays(path: Path) -> dict[str, NDArray[Any]]:
    with (
        parsing(path, "subject", remedy="copy it there again"),
        path.open("rb") as raw,  # which np.load would not close if it cannot read it
        np.load(raw, allow_pickle=False) as file,
    ):
        return dict(file.items())


def _read(path: Path) -> Subject | None:
    arrays = _arrays(path)
    if not set(_KEYS) <= set(arrays):
        return None
    with parsing(path, "subject", remedy="copy it there again"):
        mesh = TriangleMesh(arrays["V"].astype(np.float64), arrays["F"].astype(np.int64))
        landmarks, mirrored = arrays["corres"], arrays.get("corres_sym")
        if mirrored is not None and np.array_equal(landmarks, mirrored):
            mirrored = None
        return Subject(path.stem, mesh, landmarks, mirrored)
