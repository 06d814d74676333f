"""The surfaces that an evaluation runs on: real meshes, unseen procedural ones, a demo."""

from __future__ import annotations

import hashlib
import itertools
import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from spectra_kit._validate import check_count
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import TriangleMesh, creature, read, repair
from spectra_kit.geometry.io import READERS
from spectra_kit.training.families import FAMILIES
from spectra_kit.training.samples import CorpusConfig, draw_source, make_surface


@dataclass(frozen=True, eq=False)
class Model:
    """A surface and what to call it.

    Attributes
    ----------
    name : str
        For tables and pictures.
    mesh : TriangleMesh
        Clean: no duplicate vertices, no degenerate faces.
    """

    name: str
    mesh: TriangleMesh

    @cached_property
    def digest(self) -> str:
        """Hash of the mesh: what it is, wherever its file lies."""
        digest = hashlib.blake2b(digest_size=16)
        for array in (self.mesh.points, self.mesh.faces):
            digest.update(np.ascontiguousarray(array).data)
        return digest.hexdigest()


def models_in(folder: str | os.PathLike[str], limit: int | None = None) -> tuple[Model, ...]:
    """Read the meshes of a folder, by name.

    Parameters
    ----------
    folder : path
        Other files in it are left alone.
    limit : int, optional
        Read the first so many.

    Returns
    -------
    tuple of Model
        Repaired: see `geometry.repair`.

    Raises
    ------
    InvalidInputError
        If there is no mesh, or one that cannot be read.
    """
    root = Path(folder)
    entries = sorted(root.iterdir()) if root.is_dir() else []
    paths = [path for path in entries if path.suffix.lower() in READERS][:limit]
    if not paths:
        raise InvalidInputError(
            f"`folder` must hold meshes ({', '.join(sorted(READERS))}), found none in {root};"
            " check the path, or set SPECTRA_KIT_DATA"
        )
    return tuple(Model(path.stem, _clean(read(path, kind="mesh"))) for path in paths)


def procedural_models(n: int, *, seed: int) -> tuple[Model, ...]:
    """Draw surfaces from the families that networks are trained on.

    Parameters
    ----------
    n : int
        How many.
    seed : int
        Of a corpus that no network was trained on: the surfaces are those of its samples.

    Returns
    -------
    tuple of Model
        In the proportions of the corpus.

    Examples
    --------
    >>> from spectra_kit.evaluation import procedural_models
    >>> len(procedural_models(2, seed=3))
    2
    """
    check_count("n", n, low=1)
    config = CorpusConfig(seed=seed)
    return tuple(_procedural(config, index) for index in range(n))


def demo_models(n: int = 1) -> tuple[Model, ...]:
    """Make demo animals, for trials without any data.

    Parameters
    ----------
    n : int, default 1
        How many, all different.

    Returns
    -------
    tuple of Model
        Of 3,000 vertices.
    """
    return tuple(Model(f"creature {seed}", creature(3000, seed=seed)) for seed in range(n))


def _procedural(config: CorpusConfig, index: int) -> Model:
    attempts = itertools.count()
    while True:
        attempt = next(attempts)
        source = draw_source(config, index, attempt)
        try:
            mesh = _clean(make_surface(config, source, index, attempt))
        except InvalidInputError:  # an empty surface: documented, rare, and not a sample either
            continue
        return Model(f"{list(FAMILIES)[source['family']]} {index}", mesh)


def _clean(mesh: object) -> TriangleMesh:
    assert isinstance(mesh, TriangleMesh)
    cleaned = repair(mesh).geometry
    assert isinstance(cleaned, TriangleMesh)
    return cleaned
