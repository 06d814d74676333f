"""Eigenproblems: points on a shape, and an operator on the points."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import special_ortho_group

from spectra_kit._core.validate import check_count
from spectra_kit.catalogue import OPERATORS
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import Geometry, sample
from spectra_kit.geometry.sampling import GaussianDensity
from spectra_kit.neo.train.families import FAMILIES
from spectra_kit.neo.train.samples import CorpusConfig, draw_source, make_surface
from spectra_kit.operators import Laplacian
from studies.shapes import Shape, repaired


@dataclass(frozen=True, kw_only=True)
class Case:
    """One eigenproblem, by its recipe: `points` sampled on a shape, or None: its own vertices."""

    shape: Shape
    points: int | None
    #: Width of the spot around which samples crowd, see `GaussianDensity`; None samples uniformly.
    sigma: float | None = None
    #: The first is the Delaunay one on sampled points, where there is no second.
    operator: str = "robust"
    #: Seed of a random rotation of the points, and of nothing else: the exact modes stay.
    rotation: int | None = None
    seed: int = 0

    def __str__(self) -> str:
        return f"{self.shape}, {self.n:,} points"

    @property
    def n(self) -> int:
        """Number of points."""
        return self.shape.mesh.n if self.points is None else self.points

    def facts(self) -> dict[str, Any]:
        """Return everything that decides the eigenproblem, as JSON."""
        return {
            "shape": self.shape.digest,
            "points": self.points,
            "sigma": self.sigma,
            "operator": self.operator,
            "rotation": self.rotation,
            "seed": None if self.points is None else self.seed,  # vertices are not drawn
        }

    def unrotated(self) -> Case:
        """Return the case that has the same exact modes."""
        return replace(self, rotation=None)

    def geometry(self) -> Geometry:
        """Return the points, or the mesh, before any rotation."""
        if self.points is None:
            return self.shape.mesh
        return sample(
            self.shape.mesh,
            self.points,
            seed=self.seed,
            density=GaussianDensity(sigma=self.sigma) if self.sigma is not None else "uniform",
        )

    def laplacian(self) -> Laplacian:
        """Assemble the operator, before any rotation."""
        assembled: Laplacian = OPERATORS[self.operator](self.geometry())
        return assembled

    def turned(self, laplacian: Laplacian) -> Laplacian:
        """Rotate the points of the operator by this case's rotation, if it has one."""
        if self.rotation is None:
            return laplacian
        rotation = special_ortho_group.rvs(3, random_state=np.random.default_rng(self.rotation))
        return replace(laplacian, points=laplacian.points @ rotation.T)


def procedural_shapes(n: int, *, seed: int) -> tuple[Shape, ...]:
    """Draw surfaces from the families that networks are trained on, in the same proportions.

    With the `seed` of a corpus that no network was trained on; they are those of its samples.
    """
    check_count("n", n, low=1)
    config = CorpusConfig(seed=seed)
    return tuple(_procedural(config, index) for index in range(n))


def _procedural(config: CorpusConfig, index: int) -> Shape:
    for attempt in itertools.count():
        source = draw_source(config, index, attempt)
        try:
            mesh = repaired(make_surface(config, source, index, attempt))
        except InvalidInputError:  # an empty surface: documented, rare, and not a sample either
            continue
        return Shape(f"{list(FAMILIES)[source['family']]} {index}", mesh)
    raise AssertionError
