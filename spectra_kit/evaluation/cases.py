"""What is measured on: a model, points on it, and an operator on the points."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.stats import special_ortho_group

from spectra_kit.errors import InvalidInputError
from spectra_kit.evaluation.models import Model
from spectra_kit.geometry import Geometry, sample
from spectra_kit.geometry.sampling import GaussianDensity
from spectra_kit.operators import Laplacian, cotan_laplacian, knn_laplacian, robust_laplacian

_OPERATORS = ("robust", "cotan", "knn")


@dataclass(frozen=True, eq=False, kw_only=True)
class Case:
    """One eigenproblem, by its recipe.

    Attributes
    ----------
    model : Model
        The surface.
    points : int or None
        Points to sample on it; None takes the mesh itself with its vertices.
    sigma : float or None
        Width of the spot around which the samples crowd, as a share of the diagonal of the
        bounding box (see `geometry.GaussianDensity`); None samples uniformly.
    operator : {"robust", "cotan", "knn"}
        Which Laplacian; the first is the Delaunay one on sampled points, where there is no second.
    rotation : int or None
        Seed of a random rotation of the points. Stiffness and mass are left alone, so the exact
        modes are those of the case without it.
    seed : int
        Of the samples.

    Raises
    ------
    InvalidInputError
        If the operator is unknown, or `cotan` is asked for on sampled points.

    Examples
    --------
    >>> from spectra_kit.evaluation import Case, demo_models
    >>> case = Case(model=demo_models()[0], points=500, rotation=3)
    >>> case.laplacian().n, case.n
    (500, 500)
    """

    model: Model
    points: int | None
    sigma: float | None = None
    operator: Literal["robust", "cotan", "knn"] = "robust"
    rotation: int | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if self.operator not in _OPERATORS:
            raise InvalidInputError(f"`operator` must be one of {_OPERATORS}, got {self.operator}")
        if self.operator == "cotan" and self.points is not None:
            raise InvalidInputError(
                f"`operator` cotan needs a mesh, got {self.points} sampled points; take points=None"
            )

    @property
    def n(self) -> int:
        """Number of points."""
        return self.model.mesh.n if self.points is None else self.points

    @property
    def _is_delaunay(self) -> bool:
        return self.operator == "robust" and self.points is not None

    def key(self) -> dict[str, object]:
        """Everything that decides the eigenproblem, as JSON."""
        return {
            "model": self.model.digest,
            "points": self.points,
            "sigma": self.sigma,
            # As records of the tufted operator, which sampled points had once, say "robust".
            "operator": "delaunay" if self._is_delaunay else self.operator,
            "rotation": self.rotation,
            # Vertices are not drawn.
            "seed": None if self.points is None else self.seed,
        }

    def unrotated(self) -> Case:
        """Return the case that has the same exact modes."""
        return self if self.rotation is None else replace(self, rotation=None)

    def geometry(self) -> Geometry:
        """Return the points, or the mesh, before any rotation."""
        if self.points is None:
            return self.model.mesh
        return sample(
            self.model.mesh,
            self.points,
            seed=self.seed,
            density="uniform" if self.sigma is None else GaussianDensity(sigma=self.sigma),
        )

    def laplacian(self) -> Laplacian:
        """Assemble the operator, on rotated points where that is asked for."""
        return self.turned(self.assembled())

    def assembled(self) -> Laplacian:
        """Assemble the operator without the rotation."""
        if self.operator == "cotan":
            return cotan_laplacian(self.model.mesh)
        geometry = self.geometry()
        return knn_laplacian(geometry) if self.operator == "knn" else robust_laplacian(geometry)

    def turned(self, assembled: Laplacian) -> Laplacian:
        """Rotate the points of an operator by this case's rotation, if it has one."""
        if self.rotation is None:
            return assembled
        rotation = special_ortho_group.rvs(3, random_state=np.random.default_rng(self.rotation))
        return replace(assembled, points=assembled.points @ rotation.T)
