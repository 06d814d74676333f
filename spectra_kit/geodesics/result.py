"""`DistanceField`: distances to a set of sources, and how they were found."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from spectra_kit._core.checked import checked
from spectra_kit._core.records import Rebuilt, frozen
from spectra_kit._core.shown import draw
from spectra_kit._core.types import Floats
from spectra_kit._sparse.solution import LinearSolution
from spectra_kit.geodesics.heat_step import Heat
from spectra_kit.geodesics.solvers import Direct, Exact, Iterative
from spectra_kit.geodesics.sources import Sources
from spectra_kit.geometry.shapes import GeometryLike


@checked
@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class DistanceField(Rebuilt):
    """The distance of each point to the nearest source, by the heat method or exact.

    ``np.asarray(field)`` is `distance`.

    Attributes
    ----------
    distance : ndarray of shape (n,)
        In length; infinite on components without a source.
    sources : Sources
        Where it is measured from.
    solver : Direct, Iterative or Exact
        What solved the linear systems; ``coarse="none"`` where no modes served. `Exact` where
        there were none: `exact_distances`.
    reason : str
        Why this one.
    seconds : mapping of str to float
        Wall time of each stage: ``triangulation``, ``setup`` (factors, preconditioners), ``heat``,
        ``directions``, ``poisson``. Triangulation and setup serve further sources too. Or
        ``exact``.
    time_step : float or None
        t of the heat step on the component of the first source, in length^2; None, as the next
        two, where distances are exact.
    heat : Heat or None
        The heat step.
    poisson : LinearSolution or None
        The Poisson step: its residuals, iterations and seconds.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> field = sk.geodesic_distance(sk.geometry.sphere(subdivisions=3).geometry, 0)
    >>> np.asarray(field).shape, bool(field.reached.all())
    ((642,), True)
    """

    distance: Floats
    sources: Sources
    solver: Direct | Iterative | Exact
    reason: str
    seconds: Mapping[str, float]
    time_step: float | None = None
    heat: Heat | None = None
    poisson: LinearSolution | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "distance", frozen(self.distance))
        object.__setattr__(self, "seconds", MappingProxyType(dict(self.seconds)))

    @property
    def choice(self) -> str:
        """The solver and the reason, in words."""
        return f"{self.solver.name}: {self.reason}"

    @property
    def reached(self) -> NDArray[np.bool_]:
        """Points on a component with a source, shape (n,)."""
        return np.isfinite(self.distance)

    def plot(self, geometry: GeometryLike, path: str | os.PathLike[str] | None = None) -> Any:
        """Draw it on its geometry, sources at points marked; see `show.plot_distance`."""
        at = self.sources.vertices[self.sources.offsets == 0]
        sources = geometry.points[at]
        return draw("plot_distance", geometry, self.distance, sources=sources, path=path)

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """Return `distance`."""
        if copy:
            return np.array(self.distance, dtype=dtype)
        return np.asarray(self.distance, dtype=dtype)

    def __repr__(self) -> str:
        farthest = self.distance[self.reached].max()
        iterations = f", iterations={self.poisson.iterations}" if self.poisson else ""
        return (
            f"DistanceField(n={len(self.distance)}, farthest={farthest:.4g},"
            f" unreached={int((~self.reached).sum())}, choice={self.choice!r}"
            f"{iterations})"
        )
