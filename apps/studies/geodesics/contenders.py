"""What is compared: ways to distances, from the arrays of a geometry on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import version
from typing import Any

import numpy as np

from spectra_kit._core.types import Floats, Ints
from spectra_kit.eigen import Spectrum
from spectra_kit.geodesics import Direct, HeatGeodesics, Iterative, WithinMemory
from spectra_kit.geodesics.solvers import Solver
from spectra_kit.geometry import PointCloud, TriangleMesh

#: Modes of the two-level solvers, as the paper takes them; that of `Iterative()` has its own.
MODES = 96


@dataclass(frozen=True, eq=False)
class Found:
    """Distances to one source, and what the solver tells of them."""

    distance: Floats  #: (n,): in length.
    #: Of the Poisson step; None where nothing is iterated, or nothing told.
    iterations: int | None = None
    solver: str = ""  #: Which one was chosen, "" if there is no choice.
    stages: Mapping[str, float] = field(default_factory=dict)  #: Seconds, as the solver books them.


Measure = Callable[[Sequence[int]], list[Found]]
#: Make ready for sources, from points (n, 3), faces (f, 3) or None for a cloud, and the modes.
Build = Callable[[Floats, Ints | None, Spectrum | None], Measure]


@dataclass(frozen=True, kw_only=True)
class Contender:
    """One way to distances."""

    build: Build  #: Everything before the first source.
    options: str  #: All that decides what it does.
    modes: str = ""  #: Which it is given: a name in `EIGENSOLVERS`, or "" for none.


def _heat(
    points: Floats, faces: Ints | None, spectrum: Spectrum | None, *, solver: Solver
) -> Measure:
    geometry = PointCloud(points) if faces is None else TriangleMesh(points, faces)
    geodesics = HeatGeodesics(geometry, spectrum, solver=solver)

    def measure(sources: Sequence[int]) -> list[Found]:
        fields = [geodesics.distance(source) for source in sources]
        return [
            Found(
                f.distance,
                f.poisson.iterations if f.poisson and f.solver.name != "direct" else None,
                f.solver.name,
                f.seconds,
            )
            for f in fields
        ]

    return measure


def _potpourri3d(
    points: Floats, faces: Ints | None, spectrum: Spectrum | None, *, robust: bool
) -> Measure:
    import potpourri3d

    solver: Any
    if faces is None:
        solver = potpourri3d.PointCloudHeatSolver(points)
    else:
        solver = potpourri3d.MeshHeatMethodDistanceSolver(points, faces, use_robust=robust)
    return lambda sources: [Found(np.asarray(solver.compute_distance(s))) for s in sources]


def _libigl(points: Floats, faces: Ints | None, spectrum: Spectrum | None) -> Measure:
    import igl

    data = igl.HeatGeodesicsData()
    igl.heat_geodesics_precompute(points, faces, data)
    return lambda sources: [
        Found(np.asarray(igl.heat_geodesics_solve(data, np.array([s], dtype=np.int64))))
        for s in sources
    ]


def _ours(solver: Solver, modes: str = "") -> Contender:
    return Contender(build=partial(_heat, solver=solver), options=repr(solver), modes=modes)


def _theirs(package: str, build: Build) -> Contender:
    return Contender(build=build, options=f"{package} {version(package)}")


# The paper's solvers have an incomplete factor of level 0, nothing of it relaxed.
_ICPCG = Iterative(coarse="none", drop=None, relaxation=0.0)
_ADDITIVE = Iterative(coarse="additive", drop=None, relaxation=0.0, modes=MODES)
_PROJECTED = Iterative(coarse="projected", drop=None, relaxation=0.0, modes=MODES)

ICPCG, DIRECT = "ICPCG", "direct"
AUTOMATIC, UNAIDED = "automatic, exact modes", "automatic, no modes"
ROBUST, PLAIN, LIBIGL = "potpourri3d, robust", "potpourri3d, not robust", "libigl"

#: By name, in the order of the tables.
CONTENDERS: Mapping[str, Contender] = {
    ICPCG: _ours(_ICPCG),
    f"additive, {MODES} exact modes": _ours(_ADDITIVE, "exact"),
    f"additive, {MODES} NEO modes": _ours(_ADDITIVE, "neo"),
    f"projected, {MODES} exact modes": _ours(_PROJECTED, "exact"),
    f"projected, {MODES} NEO modes": _ours(_PROJECTED, "neo"),
    "threshold IC": _ours(Iterative(coarse="none", drop=1e-2, relaxation=0.0)),
    "relaxed threshold IC": _ours(Iterative(coarse="none")),
    AUTOMATIC: _ours(WithinMemory(), "exact"),
    "automatic, NEO modes": _ours(WithinMemory(), "neo"),
    UNAIDED: _ours(WithinMemory()),
    DIRECT: _ours(Direct()),
    ROBUST: _theirs("potpourri3d", partial(_potpourri3d, robust=True)),
    PLAIN: _theirs("potpourri3d", partial(_potpourri3d, robust=False)),
    LIBIGL: _theirs("libigl", _libigl),
}
#: Other packages.
OTHERS = (ROBUST, PLAIN, LIBIGL)
#: Contenders for many sources: none is given modes, so that none has time on the house.
MANY = (UNAIDED, DIRECT, *OTHERS)
#: Contenders of the race: what comes without options, and potpourri3d both ways.
RACE = (UNAIDED, PLAIN, ROBUST)
