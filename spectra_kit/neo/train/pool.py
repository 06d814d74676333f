"""Real meshes as raw material: packed in npz files, opened by split, drawn by number.

A pool is a folder of chunks (``pool_*.npz``: points ``V``, faces ``F``, their offsets ``voff`` and
``foff``, names ``ids``) with a ``manifest.csv`` that says which mesh is in which split; or one such
chunk that `pack_pool` wrote, where the manifest cannot come along.
"""

from __future__ import annotations

import csv
import hashlib
import os
import zipfile
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.files import atomic_path, parsing
from spectra_kit._core.validate import check_count
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import TriangleMesh
from spectra_kit.neo.train import surfaces as s

_KEYS = ("V", "F", "voff", "foff", "ids")
# Longest edge of a mesh before it is bent, its half size being 1. Bends and twists of at most 1.8
# radians are then off by 0.005, where 1,024 points are about 0.08 apart.
_EDGE = 0.2
_WARP = 0.7  # then three of ten stay as they are


@dataclass(frozen=True, eq=False)
class MeshPool:
    """Meshes of one split, numbered through in the order of their names; see `open_pool`.

    Parameters
    ----------
    points : list of ndarray of shape (n, 3), float16
        Of each mesh.
    faces : list of ndarray of shape (f, 3), uint16
        Of each mesh.
    names : tuple of str
        Of each mesh in the manifest.
    split : str
        The split that all of them belong to.
    """

    points: list[NDArray[np.float16]]
    faces: list[NDArray[np.uint16]]
    names: tuple[str, ...]
    split: str

    def __len__(self) -> int:
        return len(self.names)

    def mesh(self, index: int) -> TriangleMesh:
        """Return mesh number `index`, as it was packed."""
        check_count("index", index, low=0, high=len(self) - 1)
        points, faces = self.points[index], self.faces[index]
        return TriangleMesh(points.astype(np.float64), faces.astype(np.int64))

    @property
    def arrays(self) -> dict[str, NDArray[Any]]:
        """All meshes one after the other, and where each begins, as a file packs them."""
        return {
            "V": np.concatenate(self.points),
            "F": np.concatenate(self.faces),
            "voff": np.cumsum([0, *map(len, self.points)]),
            "foff": np.cumsum([0, *map(len, self.faces)]),
        }

    @cached_property
    def digest(self) -> str:
        """Hash of all meshes and their order: equal pools have equal digests, packed or not."""
        digest = hashlib.blake2b(self.split.encode(), digest_size=16)
        digest.update("\n".join(self.names).encode())
        for array in self.arrays.values():
            digest.update(np.ascontiguousarray(array).data)
        return digest.hexdigest()


def open_pool(path: str | os.PathLike[str], split: str) -> MeshPool:
    """Read the meshes of one split; a second call reads nothing unless files have changed.

    Parameters
    ----------
    path : path
        A folder of chunks with its manifest, or a file of `pack_pool`.
    split : str
        As in the manifest, e.g. ``"train"`` or ``"val"``. A packed file holds one split only.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from spectra_kit.neo.train.pool import open_pool
    >>> file = Path(tempfile.mkdtemp()) / "pool.npz"
    >>> arrays = {"V": np.eye(3), "F": [[0, 1, 2]], "voff": [0, 3], "foff": [0, 1]}
    >>> np.savez(file, **arrays, ids=["triangle"], split="train")
    >>> open_pool(file, "train").mesh(0).area
    0.87
    """
    root = Path(path)
    files = [*sorted(root.glob("pool_*.npz")), root / "manifest.csv"] if root.is_dir() else [root]
    stats = {file.name: file.stat() for file in files if file.is_file()}
    stamps = tuple((name, stat.st_size, stat.st_mtime_ns) for name, stat in stats.items())
    return _open(root, split, stamps)


@lru_cache(maxsize=4)
def _open(root: Path, split: str, stamps: tuple[tuple[str, int, int], ...]) -> MeshPool:
    """Pick the meshes of a split from all chunks, in the order of their names."""
    if not root.is_dir():
        chunks = [_read(root)]
        wanted = set(map(str, chunks[0]["ids"])) if chunks[0].get("split", "") == split else set()
    else:
        chunks = [_read(file) for file in sorted(root.glob("pool_*.npz"))]
        if not chunks or not (root / "manifest.csv").is_file():
            raise InvalidInputError(
                "path", "hold chunks pool_*.npz and a manifest.csv", f"the folder {root}"
            )
        with (root / "manifest.csv").open(newline="") as file:
            wanted = {row["id"] for row in csv.DictReader(file) if row["split"] == split}
    parts = {
        str(name): (
            chunk["V"][slice(*chunk["voff"][i : i + 2])].astype(np.float16),
            chunk["F"][slice(*chunk["foff"][i : i + 2])].astype(np.uint16),
        )
        for chunk in chunks
        for i, name in enumerate(chunk["ids"])
    }
    names = sorted(parts.keys() & wanted)
    if not names:
        raise InvalidInputError("split", f"be one that meshes of {root} are in", repr(split))
    points, faces = zip(*(parts[name] for name in names), strict=True)
    return MeshPool(list(points), list(faces), tuple(names), split)


def varied(
    mesh: TriangleMesh, rng: np.random.Generator, *, own_vertices: bool = False
) -> TriangleMesh:
    """Return `mesh` in the unit box, and mostly stretched, bent, twisted or tapered at random.

    Long edges are halved before, that they may bend too, unless it is to keep its `own_vertices`.
    """
    points = mesh.points - (mesh.points.min(axis=0) + mesh.points.max(axis=0)) / 2
    unit = mesh.with_points(points / max(float(np.abs(points).max()), 1e-12))
    fine = unit if own_vertices else s.bisected(unit, _EDGE)
    return fine.with_points(s.warped(fine.points, rng, _WARP))


def pack_pool(path: str | os.PathLike[str], target: str | os.PathLike[str], split: str) -> MeshPool:
    """Write one split of a pool into a single small file, for machines that get only files.

    Returns what was written, equal to `open_pool` of `target`.

    Parameters
    ----------
    path : path
        The pool.
    target : path
        The file to write, ``.npz``; smaller than the chunks, because it is packed with LZMA.
    split : str
        Which meshes.
    """
    if Path(target).suffix != ".npz":
        raise InvalidInputError("target", "end in .npz", repr(os.fspath(target)))
    pool = open_pool(path, split)
    arrays = pool.arrays | {"ids": np.array(pool.names), "split": np.array(split)}
    with (
        atomic_path(target) as temporary,
        zipfile.ZipFile(temporary, "w", compression=zipfile.ZIP_LZMA) as archive,
    ):
        for key, array in arrays.items():
            with archive.open(f"{key}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
    return pool


def _read(path: Path) -> dict[str, NDArray[Any]]:
    with (
        parsing(path, "mesh pool", remedy="copy it there again"),
        path.open("rb") as raw,  # which np.load would not close if it cannot read it
        np.load(raw, allow_pickle=False) as file,
    ):
        chunk = dict(file.items())
    if missing := [key for key in _KEYS if key not in chunk]:
        raise InvalidInputError("path", "be a mesh pool", f"{path} without {missing}")
    return chunk
