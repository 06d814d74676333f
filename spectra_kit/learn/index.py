"""Search: which shapes of a folder are like this one."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from spectra_kit._core.checked import checked
from spectra_kit._core.fingerprint import facts_digest, shape_digest
from spectra_kit._core.records import Brief
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count
from spectra_kit._core.version import VERSION
from spectra_kit.errors import InvalidInputError, SpectraKitError
from spectra_kit.geometry import Geometry, GeometryLike, PointCloud, TriangleMesh, read
from spectra_kit.geometry.io import READERS, readable_files
from spectra_kit.learn import files
from spectra_kit.learn.examples import Recipe


class Neighbour(NamedTuple):
    """A shape of an index, and how far it is.

    Attributes
    ----------
    name : str
        Of its file.
    distance : float
        Mean difference of the embeddings' columns, in standard deviations over the index; as it is
        where no column varies, as with a single shape.
    """

    name: str
    distance: float


@checked
@dataclass(frozen=True, eq=False)
class ShapeIndex(Brief):
    """Embeddings of whole shapes, to be searched; `index_folder` makes one.

    Parameters
    ----------
    recipe : Recipe
        How shapes become numbers.
    names : tuple of str
        Of s files.
    digests : tuple of str
        Of what each vector was made of: a shape that changed is embedded anew.
    vectors : ndarray of shape (s, c)
        The embeddings.
    failures : mapping of str to SpectraKitError
        Why other files are not in it.
    """

    recipe: Recipe
    names: tuple[str, ...]
    digests: tuple[str, ...]
    vectors: Floats
    failures: Mapping[str, SpectraKitError] = field(default_factory=dict)

    def __post_init__(self) -> None:
        rows = np.shape(self.vectors)
        if len(rows) != 2 or not rows[0] == len(self.names) == len(self.digests):
            n = len(self.names)
            raise InvalidInputError(
                "vectors", f"have {n} rows, as there are names, and digests", rows
            )

    def nearest(self, shape: GeometryLike, *, count: int = 8) -> tuple[Neighbour, ...]:
        """Return the shapes that are most like one in any unit, the nearest first.

        They are fewer than `count` where the index holds fewer.
        """
        check_count("count", count, low=1)
        if not self.names:
            raise InvalidInputError("index", "hold a shape at least", "none")
        vector = self.recipe.vector(shape)
        if len(vector) != (columns := self.vectors.shape[1]):
            raise InvalidInputError(
                "recipe", f"give as many numbers as the index has columns, {columns}", len(vector)
            )
        gaps = np.abs(self.vectors - vector)
        spread = self.vectors.std(axis=0)
        varies = spread > 1e-9 * np.maximum(np.abs(self.vectors).max(axis=0), 1e-300)
        gaps = gaps[:, varies] / spread[varies] if varies.any() else gaps
        distances = gaps.mean(axis=1)
        order = np.argsort(distances, kind="stable")[:count]
        return tuple(Neighbour(self.names[i], float(distances[i])) for i in order)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write it, whole or not at all; `load` reads it."""
        content = {
            "kind": "ShapeIndex",
            "names": self.names,
            "digests": self.digests,
            "recipe": files.as_json(self.recipe),
        }
        files.write(path, content, {"vectors": torch.tensor(self.vectors)})

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> ShapeIndex:
        """Read what `save` wrote; of release 0.2.0, files that name no class renamed since."""

        def made(content: dict[str, Any], tensors: dict[str, Tensor]) -> ShapeIndex:
            names, digests = map(files.from_json, (content["names"], content["digests"]))
            recipe, vectors = files.from_json(content["recipe"]), tensors["vectors"].numpy()
            return cls(recipe, names, digests, vectors)

        return files.read(path, "index", made)


@checked
def index_folder(
    folder: str | os.PathLike[str],
    recipe: Recipe,
    *,
    known: ShapeIndex | None = None,
    load: Callable[[str], Geometry] = read,
    progress: Callable[[int, int], object] | None = None,
) -> ShapeIndex:
    """Embed the shapes of a folder.

    Parameters
    ----------
    folder : path
        With meshes and clouds, of any format that `geometry.read` knows.
    recipe : Recipe
        How they become numbers.
    known : ShapeIndex, optional
        What of it was made of the same points and faces, by the same recipe, weights and release,
        is taken over.
    load : callable, default geometry.read
        From the path of a file to a geometry.
    progress : callable, optional
        Told how many files of how many are done.

    Returns
    -------
    ShapeIndex
        Files that could not be embedded are in its ``failures``.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import spectra_kit as sk
    >>> from spectra_kit import learn
    >>> folder = Path(tempfile.mkdtemp())
    >>> for pose in (0, 1):
    ...     sk.geometry.write(sk.geometry.creature(600, pose=pose), folder / f"animal{pose}.off")
    >>> sk.geometry.write(sk.geometry.torus(n=600).geometry, folder / "ring.off")
    >>> recipe = learn.Recipe(embeddings=(sk.features.ShapeDNA(),), k=40)
    >>> index = learn.index_folder(folder, recipe)
    >>> [near.name for near in index.nearest(sk.geometry.creature(900, pose=2), count=2)]
    ['animal0.off', 'animal1.off']
    """
    folder = Path(folder)
    paths = readable_files(folder.iterdir()) if folder.is_dir() else []
    if not paths:
        raise InvalidInputError(
            "folder",
            f"hold meshes or clouds ({', '.join(sorted(READERS))})",
            f"none in {str(folder)!r}",
        )
    old = {} if known is None else dict(zip(known.digests, known.vectors, strict=True))
    made: dict[str, tuple[str, Floats]] = {}
    failures: dict[str, SpectraKitError] = {}
    for i, path in enumerate(paths):
        try:
            shape = load(str(path))
            if not isinstance(shape, TriangleMesh | PointCloud):
                raise InvalidInputError("load", "return a geometry", f"a {type(shape).__name__}")
            digest = _digest(shape, recipe)
            made[path.name] = digest, old[digest] if digest in old else recipe.vector(shape)
        except SpectraKitError as error:
            failures[path.name] = error.with_traceback(None)  # else it keeps the shape
        if progress is not None:
            progress(i + 1, len(paths))
    vectors = [vector for _, vector in made.values()]
    digests = tuple(digest for digest, _ in made.values())
    rows = np.array(vectors) if vectors else np.empty((0, 0))
    return ShapeIndex(recipe, tuple(made), digests, rows, failures)


def _digest(shape: Geometry, recipe: Recipe) -> str:
    """Hash of a shape as it was read, of how it is embedded, and of the release that does it."""
    return facts_digest({"shape": shape_digest(shape), "recipe": repr(recipe), "release": VERSION})
