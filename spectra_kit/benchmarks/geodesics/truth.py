"""`ExactCache`: exact distances that are computed once, and errors against them."""

from __future__ import annotations

import hashlib
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from spectra_kit._files import atomic_path, parsing
from spectra_kit._types import Floats
from spectra_kit.benchmarks.code import code_digest
from spectra_kit.geodesics import exact_distances
from spectra_kit.geometry import TriangleMesh


class ExactCache:
    """Exact distances, each in a file of its own, named by mesh, source and what computes them.

    Parameters
    ----------
    folder : Path
        Made if it is not there.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._code = code_digest(sources=("geodesics/*exact*.py",)).encode()
        self.seconds: list[float] = []  # of those that were not there

    def distances(self, mesh: TriangleMesh, source: int) -> Floats:
        """Return the exact distances of all vertices to one of them, shape (n,)."""
        digest = hashlib.blake2b(self._code, digest_size=16)
        for array in (mesh.points, mesh.faces, np.array([source], dtype=np.int64)):
            digest.update(np.ascontiguousarray(array).data)
        path = self._folder / f"{digest.hexdigest()}.npy"
        if not path.exists():
            start = time.perf_counter()
            found = exact_distances(mesh, source)
            self.seconds.append(time.perf_counter() - start)
            with atomic_path(path) as part:
                np.save(part, found)
        with parsing(path, "field of distances", remedy="delete it"):
            return np.asarray(np.load(path))


@dataclass(frozen=True)
class Errors:
    """Relative errors ``|d - d*| / d*`` of distances d to one source.

    Attributes
    ----------
    mean : float
        Over the vertices.
    weighted : float
        Over the surface: vertices weigh as their mass.
    largest : float
        Of all vertices.
    """

    mean: float
    weighted: float
    largest: float


def relative_errors(distance: Floats, exact: Floats, mass: Floats) -> Errors:
    """Compare distances with exact ones; sources, and what is out of reach, do not count.

    Parameters
    ----------
    distance, exact : ndarray of shape (n,)
        In length.
    mass : ndarray of shape (n,)
        In length^2.

    Returns
    -------
    Errors
        NaN where a distance is missing.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.benchmarks.geodesics.truth import relative_errors
    >>> relative_errors(np.array([0, 1.1, 2.0]), np.array([0, 1.0, 2.0]), np.array([1, 1, 3.0]))
    Errors(mean=0.05, weighted=0.025, largest=0.1)
    """
    counted = (exact > 0) & np.isfinite(exact)
    error = np.abs(distance[counted] - exact[counted]) / exact[counted]
    weights = mass[counted]
    return Errors(float(error.mean()), float(error @ weights / weights.sum()), float(error.max()))
