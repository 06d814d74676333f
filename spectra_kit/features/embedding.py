"""What an embedding is, and the one call that makes it of any surface."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count
from spectra_kit.eigen import Automatic, Eigensolver, Spectrum, eigensolve
from spectra_kit.errors import InvalidInputError
from spectra_kit.features._spectra import Change, Solvable
from spectra_kit.operators import Laplacian, laplacian

_LEVELS = (np.arange(10) + 0.5) / 10  # of the quantiles


@checked
@dataclass(frozen=True, eq=False)
class Surface:
    """A surface, with what embeddings ask of it: made at the first time, and kept.

    Parameters
    ----------
    given : TriangleMesh, PointCloud, path, Laplacian or Spectrum
        With n points.
    k : int
        Modes of its spectrum.
    solver : Eigensolver
        Who computes them, where it is not given.
    """

    given: Solvable
    k: int
    solver: Eigensolver

    @cached_property
    def laplacian(self) -> Laplacian:
        """The operator, which a bare spectrum does not have."""
        if isinstance(self.given, Laplacian):
            return self.given
        if isinstance(self.given, Spectrum):
            raise InvalidInputError(
                "surface",
                "have points, of which this embedding is a function",
                "a Spectrum",
                advice="give the mesh, the cloud or its Laplacian",
            )
        return laplacian(self.given)

    @cached_property
    def spectrum(self) -> Spectrum:
        """Its k lowest modes, in the unit of length in which area, or volume, is one."""
        found = self.given
        if not isinstance(found, Spectrum):
            found = eigensolve(self.laplacian, self.k, self.solver)
        if found.k < self.k:
            raise InvalidInputError("surface", f"have k = {self.k} modes or more", found.k)
        return found.truncate(self.k)._of_size_one()

    @property
    def mass(self) -> Floats:
        """Share of each point in the area, (n,)."""
        source = self.given if isinstance(self.given, Spectrum) else self.laplacian
        return np.asarray(source.mass / source.mass.sum())


@runtime_checkable
class Embedding(Protocol):
    """Numbers for each point of a surface, or for all of it: a frozen dataclass of its options."""

    @property
    def invariant_to(self) -> frozenset[Change]:
        """What leaves it as it is, but for errors of discretisation and of the solver."""
        ...

    def of_points(self, surface: Surface) -> Floats:
        """Return (n, c)."""
        ...

    def of_all(self, surface: Surface) -> Floats:
        """Return (c,), which does not depend on the order of the points."""
        ...


class Pooled:
    """How values spread over the area: what embeddings of points say of all of it.

    Of each column ten quantiles by area, from the lowest twentieth to the highest, evenly. The sum
    of their differences between two surfaces is, but for a factor, the Wasserstein distance between
    the distributions; a place where parts of a cloud touch, or are lost, changes few of them.
    """

    def of_points(self, surface: Surface) -> Floats:
        """Return (n, c)."""
        raise NotImplementedError

    def of_all(self, surface: Surface) -> Floats:
        """Return the quantiles, (10 c,): those of the first column, then those of the second."""
        values = self.of_points(surface)
        order = np.argsort(values, axis=0, kind="stable")
        mass = surface.mass[order]
        below = np.cumsum(mass, axis=0) - mass / 2  # share of the area, half of the point's own
        sorted_values = np.take_along_axis(values, order, axis=0)
        columns = zip(below.T, sorted_values.T, strict=True)
        return np.concatenate([np.interp(_LEVELS, share, column) for share, column in columns])


@checked
def embed(
    surface: Solvable,
    embedding: Embedding,
    *,
    k: int = 64,
    solver: Eigensolver = Automatic(),  # noqa: B008
) -> Floats:
    """Return numbers for each point of a surface that tell where on it the point is.

    Parameters
    ----------
    surface : TriangleMesh, PointCloud, path, Laplacian or Spectrum
        With n points. Embeddings that are functions of the points refuse a bare spectrum.
    embedding : Embedding
        `HeatKernelSignature`, `WaveKernelSignature`, `GlobalPointSignature`, `Coordinates`,
        `PositionalEncoding`, `BasisFunctions`, or one of your own.
    k : int, default 64
        Modes that spectral ones are made of, zero modes included.
    solver : Eigensolver, default Automatic()
        Who computes them: ``Neo()`` predicts them. Not asked where a spectrum is given.

    Returns
    -------
    ndarray of shape (n, c)
        Dimensionless: shapes are brought to unit area, or to the unit box.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> cloud = sk.geometry.creature(800)
    >>> sk.features.embed(cloud, sk.features.HeatKernelSignature(count=8), k=32).shape
    (800, 8)
    """
    return finite(embedding.of_points(Surface(surface, check_count("k", k, low=1), solver)))


@checked
def embed_shape(
    surface: Solvable,
    embedding: Embedding,
    *,
    k: int = 64,
    solver: Eigensolver = Automatic(),  # noqa: B008
) -> Floats:
    """Return numbers for the whole of a surface, to compare it with others.

    Parameters
    ----------
    surface : TriangleMesh, PointCloud, path, Laplacian or Spectrum
        As of `embed`.
    embedding : Embedding
        `ShapeDNA`, or one of points, whose distribution over the area is returned.
    k, solver
        As of `embed`.

    Returns
    -------
    ndarray of shape (c,)
        Dimensionless; the same for any order of the points.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> dna = sk.features.ShapeDNA(count=20)
    >>> still, moved = (sk.geometry.creature(1500, pose=pose) for pose in (0, 1))
    >>> near = sk.features.embed_shape(still, dna) - sk.features.embed_shape(moved, dna)
    >>> far = sk.features.embed_shape(sk.geometry.torus(n=1500).geometry, dna)
    >>> far = far - sk.features.embed_shape(still, dna)
    >>> bool(np.linalg.norm(near) < np.linalg.norm(far))
    True
    """
    return finite(embedding.of_all(Surface(surface, check_count("k", k, low=1), solver)))


def finite(values: Floats) -> Floats:
    """Return numbers of an embedding, or refuse it."""
    if not np.isfinite(values).all():
        raise InvalidInputError("embedding", "give finite numbers", "some that are not")
    return values
