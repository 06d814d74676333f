"""`Subject`: a mesh with points that correspond to those of other subjects."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from spectra_kit._files import parsing
from spectra_kit._types import Ints
from spectra_kit._validate import Rebuilt, check_count, check_indices, frozen
from spectra_kit.correspondence import Truth
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import TriangleMesh, creature

_KEYS = ("V", "F", "corres")


@dataclass(frozen=True, eq=False)
class Subject(Rebuilt):
    """A mesh, and the vertex of each landmark that all subjects of a class share.

    Parameters
    ----------
    name : str
        Letters name the class, digits the subject within it: ``cat0`` and ``cat10`` are of one.
    mesh : TriangleMesh
        With n vertices.
    landmarks : array_like of shape (c,), integers
        Entry i is the same place of the body in every subject of a class.
    mirrored : array_like of shape (c,), integers, optional
        The place on the other side of the body.

    Raises
    ------
    InvalidInputError
        If a landmark is no vertex, or `mirrored` has another shape than `landmarks`.
    """

    name: str
    mesh: TriangleMesh
    landmarks: Ints
    mirrored: Ints | None = None

    def __post_init__(self) -> None:
        for name in ("landmarks", "mirrored"):
            values = getattr(self, name)
            if values is not None:
                array = check_indices(f"{name} of {self.name}", values, self.mesh.n)
                if array.ndim != 1 or array.shape != np.shape(self.landmarks):
                    raise InvalidInputError(
                        f"`{name}` of {self.name} must have shape ({np.size(self.landmarks)},),"
                        f" got {array.shape}"
                    )
                object.__setattr__(self, name, frozen(array))

    @property
    def kind(self) -> str:
        """The name without its digits."""
        return self.name.rstrip("0123456789")

    @cached_property
    def digest(self) -> str:
        """Hash of mesh and landmarks: what it is, wherever its file lies."""
        digest = hashlib.blake2b(digest_size=16)
        for array in (self.mesh.points, self.mesh.faces, self.landmarks, self.mirrored):
            digest.update(b"" if array is None else np.ascontiguousarray(array).data)
        return digest.hexdigest()


def truth_between(source: Subject, target: Subject) -> Truth:
    """Tell which points of two subjects of one class correspond.

    Parameters
    ----------
    source, target : Subject
        With the same landmarks in the same order.

    Returns
    -------
    Truth
        With the mirror images, if those of the source are known.

    Raises
    ------
    InvalidInputError
        If they have different numbers of landmarks.
    """
    if len(source.landmarks) != len(target.landmarks):
        raise InvalidInputError(
            f"`source` and `target` must share their landmarks, got {len(source.landmarks)} of"
            f" {source.name} and {len(target.landmarks)} of {target.name}; match within a class"
        )
    return Truth(source.landmarks, target.landmarks, source.mirrored)


def subjects_in(folder: str | os.PathLike[str]) -> dict[str, Subject]:
    """Read the subjects of a folder, by name.

    Parameters
    ----------
    folder : path
        Of ``NAME.npz`` files with vertices ``V`` (n, 3), faces ``F`` (f, 3), ``corres`` (c,) and,
        where there is a symmetry, ``corres_sym`` (c,), all counted from 0. Other files, and npz
        files without ``corres``, are left alone.

    Returns
    -------
    dict of str to Subject
        By file name.

    Raises
    ------
    InvalidInputError
        If there is none, or a file cannot be read.
    """
    root = Path(folder)
    found = (_read(path) for path in sorted(root.glob("*.npz")))
    subjects = {subject.name: subject for subject in found if subject is not None}
    if not subjects:
        raise InvalidInputError(
            f"`folder` must hold .npz files with {', '.join(_KEYS)}, found none in {root};"
            " check the path, or set SPECTRA_KIT_DATA"
        )
    return subjects


def demo_subjects(n_points: int = 1000, *, poses: int = 4) -> dict[str, Subject]:
    """Make one demo animal in several poses, for trials without any data.

    Parameters
    ----------
    n_points : int, default 1000
        Vertices of each, about; the same triangles in every pose.
    poses : int, default 4
        How many, at least 2.

    Returns
    -------
    dict of str to Subject
        By name; every vertex is a landmark.

    Examples
    --------
    >>> from spectra_kit.evaluation.matching import demo_subjects
    >>> list(demo_subjects(600, poses=2))
    ['creature0', 'creature1']
    """
    check_count("poses", poses, low=2)
    meshes = [creature(n_points, pose=pose) for pose in range(poses)]
    return {
        f"creature{i}": Subject(f"creature{i}", mesh, np.arange(mesh.n))
        for i, mesh in enumerate(meshes)
    }


def _read(path: Path) -> Subject | None:
    with (
        parsing(path, "subject", remedy="copy it there again"),
        path.open("rb") as raw,  # which np.load would not close if it cannot read it
        np.load(raw, allow_pickle=False) as file,
    ):
        if not set(_KEYS) <= set(file.files):
            return None
        arrays = dict(file.items())
        mesh = TriangleMesh(arrays["V"].astype(np.float64), arrays["F"].astype(np.int64))
        return Subject(path.stem, mesh, arrays["corres"], arrays.get("corres_sym"))
