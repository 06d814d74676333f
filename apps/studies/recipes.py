"""Geometries by recipe, and `REAL`: the set of real meshes and clouds that figures are given for.

A member of the set is a line of data: files, steps and a seed. The same line makes the same arrays,
whose hash is told beside what was measured on them.
"""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import (
    GaussianDensity,
    Geometry,
    PointCloud,
    TriangleMesh,
    creature,
    sample,
)
from spectra_kit.neo.train.pool import open_pool
from studies.shapes import (
    Shape,
    as_mesh,
    data_folder,
    loop_subdivided,
    mean_edge,
    repaired,
    shape_at,
)

_SIGMA = 0.25  # of the diagonal: an uneven cloud is eight times denser here than half of it away
_PART_FACES = 500  # at least, of a drawn part
_MODEL, _POOL = "creature:", "train_pool:"


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """A mesh or a cloud: what it is made of, and how.

    Meshes are repaired, and where there are several put side by side, at sizes that differ. Then
    come the steps, each a name of `STEPS` and a number.
    """

    name: str  #: For tables.
    #: Files, or paths in ``$SPECTRA_KIT_DATA`` without their ending; "train_pool:40" draws so many
    #: parts there, "creature:2000" makes the demo animal.
    sources: tuple[str, ...]
    steps: tuple[tuple[str, float], ...] = ()
    seed: int = 0  #: Of all that is drawn.
    traits: tuple[str, ...] = ()  #: What is hard about it; a member of the set has some.
    held_back: bool = False  #: Whether no constant may be tuned on it.

    def __str__(self) -> str:
        return self.name

    @property
    def kind(self) -> str:
        """Mesh or cloud."""
        return "cloud" if {"sample", "uneven"} & {name for name, _ in self.steps} else "mesh"

    @property
    def told(self) -> str:
        """The recipe in a line."""
        steps = (f"{name} {value:g}" for name, value in self.steps)
        return ", ".join([" + ".join(self.sources), *steps])

    @property
    def missing(self) -> str:
        """Which of its files is not there, or nothing."""
        gone = [source for source in self.sources if not all(p.is_file() for p in _files(source))]
        return f"no data: {gone[0]}; set SPECTRA_KIT_DATA" if gone else ""

    @cached_property
    def facts(self) -> dict[str, object]:
        """All that decides the geometry, as JSON: the recipe, and the hash of every file."""
        found = hashlib.blake2b(digest_size=12)
        for source in self.sources:
            for path in _files(source):
                found.update(path.read_bytes() if path.is_file() else b"missing")
        made_of = [source if ":" in source else "file" for source in self.sources]
        return {"of": made_of, "files": found.hexdigest(), "steps": self.steps, "seed": self.seed}

    def make(self) -> Geometry:
        """Make it; the same on every call."""
        if self.missing:
            raise InvalidInputError("sources", "be files", self.missing)
        rng = np.random.default_rng(self.seed)
        meshes = [mesh for source in self.sources for mesh in _meshes(source, rng)]
        geometry: Geometry = meshes[0] if len(meshes) == 1 else _side_by_side(meshes, rng)
        for name, value in self.steps:
            geometry = STEPS[name](geometry, value, rng)
        return geometry


# --- steps ---


def _midpoint(mesh: Geometry, times: float, rng: np.random.Generator) -> Geometry:
    """Split every triangle in four that are flat: corners stay sharp, triangles as they are."""
    import trimesh

    subdivide: Any = trimesh.remesh.subdivide
    points, faces = mesh.points, as_mesh(mesh).faces
    for _ in range(int(times)):
        points, faces = subdivide(points, faces)
    return TriangleMesh(points, faces)


def _loop(mesh: Geometry, times: float, rng: np.random.Generator) -> Geometry:
    return loop_subdivided(as_mesh(mesh), int(times))


def _graded(mesh: Geometry, times: float, rng: np.random.Generator) -> Geometry:
    """Split at its centroid each triangle of the third of the surface next to a random vertex."""
    points, faces = mesh.points, as_mesh(mesh).faces
    centre = points[rng.integers(len(points))]
    for _ in range(int(times)):
        centroids = points[faces].mean(axis=1)
        distance = np.linalg.norm(centroids - centre, axis=1)
        inside = distance < np.quantile(np.linalg.norm(mesh.points - centre, axis=1), 1 / 3)
        a, b, c = faces[inside].T
        new = len(points) + np.arange(inside.sum())
        thirds = [np.column_stack(corners) for corners in ((a, b, new), (b, c, new), (c, a, new))]
        faces = np.vstack([faces[~inside], *thirds])
        points = np.vstack([points, centroids[inside]])
    return TriangleMesh(points, faces)


def _stretch(geometry: Geometry, factor: float, rng: np.random.Generator) -> Geometry:
    """Make it longer along one axis: triangles of a high aspect ratio."""
    return geometry.with_points(geometry.points * [1.0, 1.0, factor])


def _noise(geometry: Geometry, share: float, rng: np.random.Generator) -> Geometry:
    """Move every point at random, by that share of the mean edge or distance of neighbours."""
    points = geometry.points
    if isinstance(geometry, TriangleMesh):
        spacing = mean_edge(geometry)
    else:
        spacing = cKDTree(points).query(points, k=2)[0][:, 1].mean()
    moved = points + share * spacing * rng.standard_normal(points.shape)
    return geometry.with_points(moved)


def _sample(mesh: Geometry, count: float, rng: np.random.Generator) -> PointCloud:
    """Draw so many points uniformly, in no order."""
    return sample(as_mesh(mesh), int(count), seed=int(rng.integers(2**31)))


def _uneven(mesh: Geometry, count: float, rng: np.random.Generator) -> PointCloud:
    """Draw so many points, denser around one spot; half of them uniformly, so that none is bare."""
    even = int(count) // 2
    dense = sample(
        as_mesh(mesh),
        int(count) - even,
        seed=int(rng.integers(2**31)),
        density=GaussianDensity(sigma=_SIGMA),
    )
    points = np.vstack([_sample(mesh, even, rng).points, dense.points])
    return PointCloud(rng.permutation(points))


#: Name -> what it does to a geometry, with a number and a generator. Keys of measurements hold the
#: recipe, not this code: where it changes, raise `Preparation.version` of the study.
STEPS: dict[str, Callable[[Geometry, float, np.random.Generator], Geometry]] = {
    "midpoint": _midpoint,
    "loop": _loop,
    "graded": _graded,
    "stretch": _stretch,
    "noise": _noise,
    "sample": _sample,
    "uneven": _uneven,
}


# --- sources ---


def _files(source: str) -> list[Path]:
    """Return the files of a source, there or not."""
    if source.startswith(_MODEL):
        return []
    if source.startswith(_POOL):
        pool = data_folder("train_pool") or Path("train_pool")
        return [pool / "manifest.csv", *sorted(pool.glob("pool_*.npz"))]
    path = Path(source)
    return [path if path.is_file() else data_folder(f"{source}.npz") or path]


def _meshes(source: str, rng: np.random.Generator) -> list[TriangleMesh]:
    count = source.partition(":")[2]
    if source.startswith(_MODEL):
        return [creature(int(count), seed=0)]
    if source.startswith(_POOL):
        return _parts(int(count), rng)
    return [shape_at(_files(source)[0]).mesh]


def _parts(count: int, rng: np.random.Generator) -> list[TriangleMesh]:
    """Draw connected meshes of the pool's validation split, without replacement."""
    manifest = _files(_POOL)[0]
    with manifest.open(newline="") as file:
        rows = [
            row
            for row in csv.DictReader(file)
            if row["split"] == "val"
            and row["n_components"] == "1"
            and row["nonmanifold_edges"] == "0"
            and int(row["n_faces"]) >= _PART_FACES
        ]
    drawn = [rows[i] for i in rng.choice(len(rows), count, replace=False)]
    pool = open_pool(manifest.parent, "val")
    return [repaired(pool.mesh(pool.names.index(row["id"]))) for row in drawn]


def _side_by_side(meshes: Sequence[TriangleMesh], rng: np.random.Generator) -> TriangleMesh:
    """Join meshes in a row, the largest four times as large as the smallest, none touching."""
    points, faces, end, count = [], [], 0.0, 0
    for mesh, size in zip(meshes, 2.0 ** rng.uniform(-1, 1, len(meshes)), strict=True):
        scaled = (mesh.points - mesh.points.min(axis=0)) * (size / np.sqrt(mesh.area))
        points.append(scaled + [end, 0.0, 0.0])
        faces.append(mesh.faces + count)
        end += 1.1 * float(np.ptp(scaled[:, 0])) + 0.1
        count += len(scaled)
    return TriangleMesh(np.vstack(points), np.vstack(faces))


# --- the set ---


def _member(name: str, traits: str, sources: str, steps: str, seed: int, held: bool) -> Recipe:
    """Return a line of the table below as a recipe."""
    words = [step.split() for step in steps.split(",") if step]
    return Recipe(
        name=name,
        sources=tuple(sources.split()),
        steps=tuple((step, float(value)) for step, value in words),
        seed=seed,
        traits=tuple(traits.split(", ")),
        held_back=held,
    )


_OOD = "ood_public/"
_PUBLIC = "cow spot fandisk homer teapot camelhead 3holes trim_star plane penguin"
# Name, traits, sources, steps, seed, held back: half of each kind, and no source on both sides.
_REAL = (
    ("hippo", "scanned, many parts", _OOD + "hippo", "", 0, False),
    ("bunny", "scanned, with boundary", _OOD + "bunny", "", 0, False),
    ("armadillo noisy", "scanned, noisy", _OOD + "armadillo", "noise 0.2", 1, False),
    ("40 parts", "CAD, many parts", "train_pool:40", "", 2, False),
    ("body anisotropic", "smooth, uneven", "scape_a/mesh052", "midpoint 2", 0, False),
    ("casting 80k", "CAD", _OOD + "casting", "midpoint 2", 0, False),
    ("amo", "smooth", _OOD + "amo", "", 0, False),
    ("laurana 100k", "scanned, with boundary", _OOD + "laurana", "loop 1", 0, False),
    ("cheburashka 427k", "smooth", _OOD + "cheburashka", "loop 3", 0, False),
    ("horse", "smooth", _OOD + "horse", "", 0, True),
    ("koala noisy", "smooth, noisy", _OOD + "koala", "noise 0.2", 3, True),
    ("lucy graded", "scanned, uneven", _OOD + "lucy", "graded 2", 4, True),
    ("12 parts", "CAD, many parts", " ".join(_OOD + x for x in _PUBLIC.split()), "", 5, True),
    ("beetle 78k", "CAD, with boundary, uneven", _OOD + "beetle", "midpoint 1", 0, True),
    ("hammer stretched", "CAD, uneven", _OOD + "hammer", "midpoint 1, stretch 4", 0, True),
    ("igea", "scanned", _OOD + "igea", "", 0, True),
    ("boot 319k", "CAD", _OOD + "boot", "midpoint 2", 0, True),
    ("bunny cloud", "scanned, with boundary", _OOD + "bunny", "sample 50000", 6, False),
    ("armadillo cloud", "scanned, uneven", _OOD + "armadillo", "uneven 60000", 7, False),
    ("casting cloud", "CAD, noisy", _OOD + "casting", "sample 100000, noise 0.2", 8, False),
    ("koala cloud", "smooth", _OOD + "koala", "sample 64000", 9, True),
    ("beetle cloud", "CAD, with boundary, uneven", _OOD + "beetle", "uneven 80000", 10, True),
    ("igea cloud", "scanned, noisy", _OOD + "igea", "sample 150000, noise 0.2", 11, True),
    ("lucy cloud 500k", "scanned", _OOD + "lucy", "sample 500000", 12, True),
)
#: Name -> member: meshes, then clouds.
REAL: dict[str, Recipe] = {line[0]: _member(*line) for line in _REAL}
_MADE = (
    ("animal", "smooth", "creature:20000", "", 0, False),
    ("animal graded", "uneven", "creature:5000", "graded 2", 1, False),
    ("animals", "many parts", " ".join(f"creature:{n}000" for n in (2, 3, 4, 5, 6)), "", 2, False),
    ("animal cloud", "noisy", "creature:20000", "sample 30000, noise 0.2", 3, False),
)
#: The same, of animals that anybody can make: to look at a machine, not to draw figures from.
MADE: dict[str, Recipe] = {line[0]: _member(*line) for line in _MADE}
MEMBERS = REAL | MADE


def model_sources() -> tuple[str, ...]:
    """Name the well-known models in ``$SPECTRA_KIT_DATA/ood_public`` as sources, by their names."""
    folder = data_folder("ood_public")
    found = sorted(folder.glob("*.npz")) if folder else []
    if not found:
        raise InvalidInputError(
            f"no models in {folder or 'ood_public'}; set SPECTRA_KIT_DATA, or take the demo"
        )
    return tuple(_OOD + path.stem for path in found)


def meshes_of(names: Iterable[str]) -> tuple[Shape, ...]:
    """Make members of both sets that are meshes, without those whose data are missing."""
    members = [MEMBERS[name] for name in names]
    return tuple(
        Shape(member.name, as_mesh(member.make()))
        for member in members
        if member.kind == "mesh" and not member.missing
    )
