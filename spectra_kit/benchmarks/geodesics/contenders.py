"""What is compared: ways to distances, from the arrays of a geometry on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np

from spectra_kit._types import Floats, Ints
from spectra_kit.geodesics import Automatic, Direct, HeatGeodesics, Iterative
from spectra_kit.geodesics.solvers import Solver
from spectra_kit.geometry import PointCloud, TriangleMesh
from spectra_kit.spectra import Spectrum

#: Modes of the two-level solvers, as the paper takes them; that of `Iterative()` has its own.
MODES = 96


@dataclass(frozen=True, eq=False)
class Found:
    """Distances to one source, and what the solver tells of them.

    Attributes
    ----------
    distance : ndarray of shape (n,)
        In length.
    iterations : int or None
        Of the Poisson step; None where nothing is iterated, or nothing told.
    choice : str
        Which solver, and why.
    stages : mapping of str to float
        Seconds, as the solver books them.
    """

    distance: Floats
    iterations: int | None = None
    choice: str = ""
    stages: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))


Measure = Callable[[Sequence[int]], list[Found]]


#: Make ready for sources, from points (n, 3), faces (f, 3) or None for a cloud, the modes, and
#: whether all sources come at once.
Build = Callable[[Floats, Ints | None, Spectrum | None, bool], Measure]


@dataclass(frozen=True, kw_only=True)
class Contender:
    """One way to distances.

    Attributes
    ----------
    build : callable
        Everything before the first source.
    spectrum : str
        Which modes it is given: "exact", "neo", "neo-polished", or "" for none.
    clouds : bool
        Whether it takes points without faces.
    """

    build: Build
    spectrum: str = ""
    clouds: bool = False


def _ours(
    points: Floats, faces: Ints | None, spectrum: Spectrum | None, many: bool, *, solver: Solver
) -> Measure:
    geometry = PointCloud(points) if faces is None else TriangleMesh(points, faces)
    geodesics = HeatGeodesics(geometry, spectrum, solver=solver)

    def measure(sources: Sequence[int]) -> list[Found]:
        # `distances` lets their number decide; one by one they are first fields each.
        fields = geodesics.distances(sources) if many else [geodesics.distance(s) for s in sources]
        return [
            Found(
                f.distance,
                None if f.solver == Direct() else f.poisson.iterations,
                f.choice,
                f.seconds,
            )
            for f in fields
        ]

    return measure


def _potpourri3d(
    points: Floats, faces: Ints | None, spectrum: Spectrum | None, many: bool, *, robust: bool
) -> Measure:
    import potpourri3d

    solver: Any
    if faces is None:
        solver = potpourri3d.PointCloudHeatSolver(points)
    else:
        solver = potpourri3d.MeshHeatMethodDistanceSolver(points, faces, use_robust=robust)
    return lambda sources: [Found(np.asarray(solver.compute_distance(s))) for s in sources]


def _libigl(points: Floats, faces: Ints | None, spectrum: Spectrum | None, many: bool) -> Measure:
    import igl

    data = igl.HeatGeodesicsData()
    igl.heat_geodesics_precompute(points, faces, data)
    return lambda sources: [
        Found(np.asarray(igl.heat_geodesics_solve(data, np.array([s], dtype=np.int64))))
        for s in sources
    ]


def _contender(solver: Solver, spectrum: str = "", *, clouds: bool = False) -> Contender:
    return Contender(build=partial(_ours, solver=solver), spectrum=spectrum, clouds=clouds)


# The paper's solvers have an incomplete factor of level 0, nothing of it relaxed.
_ICPCG = Iterative(coarse="none", drop=None, relaxation=0.0)
_ADDITIVE = Iterative(coarse="additive", drop=None, relaxation=0.0, modes=MODES)
_PROJECTED = Iterative(coarse="projected", drop=None, relaxation=0.0, modes=MODES)

ICPCG, DIRECT = "ICPCG", "direct"
AUTOMATIC, UNAIDED = "automatic, exact modes", "automatic, no modes"
ROBUST, PLAIN, LIBIGL = "potpourri3d, robust", "potpourri3d, not robust", "libigl"

#: By name, in the order of the tables.
CONTENDERS: Mapping[str, Contender] = MappingProxyType(
    {
        ICPCG: _contender(_ICPCG),
        f"additive, {MODES} exact modes": _contender(_ADDITIVE, "exact"),
        f"additive, {MODES} NEO modes": _contender(_ADDITIVE, "neo"),
        f"additive, {MODES} NEO modes, polished": _contender(_ADDITIVE, "neo-polished"),
        f"projected, {MODES} exact modes": _contender(_PROJECTED, "exact"),
        f"projected, {MODES} NEO modes": _contender(_PROJECTED, "neo"),
        "threshold IC": _contender(Iterative(coarse="none", drop=1e-2, relaxation=0.0)),
        "relaxed threshold IC": _contender(Iterative(coarse="none")),
        AUTOMATIC: _contender(Automatic(), "exact"),
        "automatic, NEO modes": _contender(Automatic(), "neo"),
        "automatic, NEO modes, polished": _contender(Automatic(), "neo-polished"),
        UNAIDED: _contender(Automatic(), clouds=True),
        DIRECT: _contender(Direct(), clouds=True),
        ROBUST: Contender(build=partial(_potpourri3d, robust=True), clouds=True),
        PLAIN: Contender(build=partial(_potpourri3d, robust=False)),
        LIBIGL: Contender(build=_libigl),
    }
)
