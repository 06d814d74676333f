"""Every solver of the Poisson step side by side, another package beside them."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from typing import TYPE_CHECKING, cast

import numpy as np

import spectra_kit as sk
from spectra_kit._core.types import Floats
from spectra_kit.cli import tables
from spectra_kit.cli.progress import step
from spectra_kit.cli.solving import solve

if TYPE_CHECKING:
    from spectra_kit._sparse.solution import LinearSolution
    from spectra_kit.cli.geodesic import GeodesicOptions
    from spectra_kit.geodesics import Direct, Iterative
    from spectra_kit.geodesics.sources import Sources
    from spectra_kit.geometry import Geometry
    from spectra_kit.operators import IntrinsicTriangulation
    from spectra_kit.show import SolverRun

_MODES = 96  # as many as the NEO paper takes
_REPEATS = 2  # of everything, by turns; the faster counts, in which all is loaded and compiled
_DIRECT = "direct Cholesky"


def compare_solvers(
    asked: GeodesicOptions,
    geometry: Geometry,
    triangulation: IntrinsicTriangulation,
    sources: Sources,
) -> list[tuple[SolverRun, float]]:
    """Measure every solver on the same problem, from the arrays of the geometry on.

    With each run stands how far its distances are from those of the direct solver, relative to
    the largest of these.
    """
    time_coefficient = asked.time_coefficient
    contenders = _solvers(asked, triangulation)
    fastest: dict[str, tuple[SolverRun, Floats]] = {}
    for _ in range(_REPEATS):
        for name, contender in contenders.items():
            with step(f"trying {name}"):
                if contender is None:
                    run, distance = _potpourri3d(geometry, sources, time_coefficient)
                else:
                    run, distance = _ours(geometry, sources, name, *contender, time_coefficient)
            if name not in fastest or run.seconds < fastest[name][0].seconds:
                fastest[name] = run, distance
    direct = fastest[_DIRECT][1]
    known = np.isfinite(direct)
    largest = float(direct[known].max()) or 1.0
    return [
        (run, float(np.abs(distance[known] - direct[known]).max()) / largest)
        for run, distance in fastest.values()
    ]


def comparison_record(run: SolverRun, difference: float) -> tables.Record:
    """Everything, as the report has it; the residual of another package is not known."""
    return {
        "name": run.name,
        "iterations": run.iterations,
        "relative_residual": float(run.residuals[-1]) if len(run.residuals) else None,
        "stages": {**run.stages, "poisson": run.solve_seconds},
        "seconds": run.seconds,
        "spectrum_seconds": run.spectrum_seconds,
        "difference_from_direct": difference,
        "residuals": run.residuals,
        "times": run.times,
    }


def comparison_table(records: list[tables.Record]) -> str:
    """One row for each solver."""
    rows = [
        ("", "", "relative", "seconds", "spectrum", "difference"),
        ("solver", "iterations", "residual", "in all", "besides", "from direct"),
    ]
    for one in records:
        residual, spectrum = one["relative_residual"], one["spectrum_seconds"]
        rows.append(
            (
                one["name"],
                "" if one["iterations"] is None else str(one["iterations"]),
                "" if residual is None else f"{residual:.1e}",
                f"{one['seconds']:.2f}",
                f"{spectrum:.2f}" if spectrum else "",
                f"{one['difference_from_direct']:.1e}",
            )
        )
    return tables.align(rows, left=1)


def clock_note() -> str:
    """What the seconds are."""
    return (
        f"Faster of {_REPEATS} runs each, by turns. The clock starts with the geometry alone;"
        f" imports and compilation are not counted. {os.cpu_count()} processor cores."
    )


def number_of_modes(asked: GeodesicOptions, laplacian: sk.Laplacian, *, usual: int) -> int:
    """Return how many modes the coarse space has, those of eigenvalue 0 aside."""
    return usual if asked.k is None else max(asked.k - laplacian.kernel_dimension, 1)


def _solvers(
    asked: GeodesicOptions, triangulation: IntrinsicTriangulation
) -> dict[str, tuple[Direct | Iterative, sk.Spectrum | None] | None]:
    """Return the solvers by name, each with the modes that it uses; None is the other package."""
    laplacian, rtol = triangulation.laplacian, asked.poisson_rtol
    shipped = sk.geodesics.Iterative(rtol=rtol)
    modes = number_of_modes(asked, laplacian, usual=_MODES)
    few = min(modes, shipped.modes)

    def spectrum(solver: str, n: int) -> sk.Spectrum:
        told = replace(asked, accuracy=None, start=None, rtol=None)
        k = min(n + laplacian.kernel_dimension, laplacian.n)
        return solve(laplacian, k, solver, told)

    exact = spectrum("automatic", modes)
    # One base for all that differ in the coarse space alone: level 0, as in the paper.
    base = sk.geodesics.Iterative(coarse="none", drop=None, relaxation=0.0, modes=modes, rtol=rtol)
    additive = replace(base, coarse="additive")
    return {
        "IC(0)": (base, None),
        f"IC(0) + {modes} exact modes": (additive, exact),
        f"IC(0) + {modes} NEO modes": (additive, spectrum("neo", modes)),
        f"IC(0) + {modes} exact modes, projected": (replace(base, coarse="projected"), exact),
        "relaxed IC": (replace(shipped, coarse="none"), None),
        f"relaxed IC + {few} exact modes": (shipped, spectrum("automatic", few)),
        _DIRECT: (sk.geodesics.Direct(), None),
        "potpourri3d": None,
    }


def _ours(
    geometry: Geometry,
    sources: Sources,
    name: str,
    solver: Direct | Iterative,
    spectrum: sk.Spectrum | None,
    time_coefficient: float,
) -> tuple[SolverRun, Floats]:
    start = time.perf_counter()
    geodesics = sk.HeatGeodesics(
        geometry, spectrum, solver=solver, time_coefficient=time_coefficient
    )
    field = geodesics.distance(sources)
    whole = time.perf_counter() - start
    poisson, stages = cast("LinearSolution", field.poisson), dict(field.seconds)
    # The curve begins after a start of its own, and ends when the step does.
    times = poisson.times + max(stages.pop("poisson") - float(poisson.times[-1]), 0.0)
    # What no stage claims is counted too.
    stages["other"] = max(whole - sum(stages.values()) - float(times[-1]), 0.0)
    run = sk.show.SolverRun(
        name=name,
        stages=stages,
        spectrum_seconds=0.0 if spectrum is None else spectrum.provenance.solving_seconds,
        times=times,
        residuals=poisson.residual_norms / (poisson.rhs_norm or 1.0),
    )
    return run, field.distance


def _potpourri3d(
    geometry: Geometry, sources: Sources, time_coefficient: float
) -> tuple[SolverRun, Floats]:
    """Build and solve once by another package, which tells no residual."""
    import potpourri3d

    start = time.perf_counter()
    if isinstance(geometry, sk.TriangleMesh):
        solver = potpourri3d.MeshHeatMethodDistanceSolver(
            geometry.points, geometry.faces, t_coef=time_coefficient
        )
    else:
        solver = potpourri3d.PointCloudHeatSolver(geometry.points, t_coef=time_coefficient)
    built = time.perf_counter()
    distance = np.asarray(solver.compute_distance_multisource(sources.vertices.tolist()))
    stages = {"build": built - start, "first solve": time.perf_counter() - built}
    return sk.show.SolverRun(name="potpourri3d", stages=stages), distance
