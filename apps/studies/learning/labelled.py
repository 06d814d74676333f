"""Sets of labelled meshes, as `shared/data/tasks` packs them, and one that is made."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.files import parsing
from spectra_kit._core.fingerprint import arrays_digest
from spectra_kit._core.types import Bools, Ints
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import TriangleMesh, creature, sphere, torus
from studies.shapes import given_folder

_HELD = 0.1

#: Sets by their names on command lines.
CLASSIFIED = {"shrec11": "shrec16_meshcnn.npz"}
SEGMENTED = {
    "human": "human_seg_meshcnn.npz",
    "aliens": "coseg_aliens_meshcnn.npz",
    "chairs": "coseg_chairs_meshcnn.npz",
    "vases": "coseg_vases_meshcnn.npz",
}


@dataclass(frozen=True, eq=False)
class LabelledSet:
    """Meshes with classes, of the whole or of vertices and faces, and the official split."""

    name: str
    meshes: tuple[TriangleMesh, ...]
    is_train: Bools  #: (s,)
    classes: tuple[str, ...]  #: Their names.
    labels: Ints | None = None  #: (s,): what each shape is.
    vertex_labels: tuple[Ints, ...] = ()  #: Of the vertices of each shape.
    face_labels: tuple[Ints, ...] = ()
    sources: tuple[str, ...] = ()  #: Where each shape is from, if from several places.

    @cached_property
    def digest(self) -> str:
        """Hash of it all."""
        arrays: list[NDArray[np.generic]] = [self.is_train]
        arrays += [array for mesh in self.meshes for array in (mesh.points, mesh.faces)]
        arrays += [] if self.labels is None else [self.labels]
        return arrays_digest(*arrays, *self.vertex_labels, *self.face_labels)

    @property
    def train(self) -> Ints:
        """Numbers of the shapes of the training split."""
        return np.flatnonzero(self.is_train)

    @property
    def test(self) -> Ints:
        """Numbers of the others."""
        return np.flatnonzero(~self.is_train)

    def held_out(self, seed: int) -> Ints:
        """Numbers of the shapes of the training split to choose by: a tenth, or those of a source.

        Shapes of a source are poses of a few bodies: among others of these, nothing new is seen.
        """
        if not self.sources:
            order = np.random.default_rng(seed).permutation(self.train)
            return order[: round(_HELD * len(order))]
        held = self.held_source(seed)
        return np.array([i for i in self.train if self.sources[i] == held])

    def held_source(self, seed: int) -> str:
        """Name the source that is held out, nothing if all shapes are from one."""
        names = sorted({self.sources[i] for i in self.train}) if self.sources else [""]
        return names[seed % len(names)]


def read_set(name: str, path: Path) -> LabelledSet:
    """Read a packed set: vertices, faces, offsets of both, labels and split."""
    with parsing(path, "labelled set", remedy="see the README of the data"), np.load(path) as file:
        vertices, faces = file["V"].astype(np.float64), file["F"].astype(np.int64)
        v, f = file["voff"], file["foff"]
        meshes = tuple(
            TriangleMesh(vertices[v[i] : v[i + 1]], faces[f[i] : f[i + 1]])
            for i in range(len(v) - 1)
        )
        if "label" in file:
            classes = tuple(map(str, file["classes"]))
            labels = file["label"].astype(np.int64)
            return LabelledSet(name, meshes, file["is_train16"], classes, labels)
        known = np.unique(file["face_label"])
        sources = [str(name).split("__")[0] for name in file["names"]] if "names" in file else []
        points, sides = (
            np.searchsorted(known, file[key]).astype(np.int64)
            for key in ("vert_label", "face_label")
        )
        return LabelledSet(
            name,
            meshes,
            file["is_train"],
            tuple(str(number) for number in known),
            vertex_labels=tuple(np.split(points, v[1:-1])),
            face_labels=tuple(np.split(sides, f[1:-1])),
            sources=tuple(sources) if len(set(sources)) < len(sources) else (),
        )


def labelled_set(name: str, folder: Path | None, files: dict[str, str]) -> LabelledSet:
    """Return a set by its name, ``demo`` without any data."""
    if name == "demo":
        return demo_set()
    place = given_folder(folder, "tasks")
    path = place / files[name]
    if not path.is_file():
        raise InvalidInputError("data", f"hold {files[name]}", f"no such file in {place}")
    return read_set(name, path)


def demo_set() -> LabelledSet:
    """Make animals, rings and balls; two halves of each are its parts."""
    kinds = {
        "animal": [creature(700, seed=seed, pose=pose) for seed in (0, 1) for pose in range(3)],
        "ring": [torus(n=700, minor=0.2 + 0.06 * i).geometry for i in range(6)],
        "egg": [_egg(1 + 0.15 * i) for i in range(6)],
    }
    meshes = tuple(mesh for some in kinds.values() for mesh in some)
    low = [mesh.points[:, 2] < np.median(mesh.points[:, 2]) for mesh in meshes]
    return LabelledSet(
        "demo",
        meshes,
        np.tile(np.arange(6) < 4, 3),
        tuple(kinds),
        np.repeat(np.arange(3), 6),
        tuple(half.astype(np.int64) for half in low),
        tuple(
            (half[mesh.faces].sum(axis=1) > 1).astype(np.int64)
            for half, mesh in zip(low, meshes, strict=True)
        ),
    )


def _egg(stretch: float) -> TriangleMesh:
    ball = sphere(subdivisions=3).geometry
    return TriangleMesh(ball.points * [1.0, 1.0, stretch], ball.faces)
