"""Every solver of the Poisson step side by side, another package beside them."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from spectra_kit._types import Floats
from spectra_kit.cli import tables
from spectra_kit.cli.geodesic_method import spectrum_named
from spectra_kit.cli.geodesic_options import COMPARED_MODES
from spectra_kit.cli.progress import step, telling
from spectra_kit.geodesics import Direct, HeatGeodesics, Iterative
from spectra_kit.geodesics.sources import Sources, check_sources
from spectra_kit.geometry import Geometry, TriangleMesh, sphere
from spectra_kit.operators import IntrinsicTriangulation, intrinsic_delaunay
from spectra_kit.spectra import Spectrum
from spectra_kit.viz import SolverRun

_REPEATS = 2  # of everything, one after the other; the faster run of each counts
_SPECTRA = {"exact": "exact modes", "neo": "NEO modes", "neo-polished": "NEO modes, polished"}
_DIRECT, _PEER = "direct Cholesky", "potpourri3d"


@dataclass(frozen=True, eq=False)
class Compared:
    """A run, and how far its distances are from those of the direct solver.

    Attributes
    ----------
    run : SolverRun
        Its seconds and residuals.
    difference : float
        Largest, relative to the largest distance.
    """

    run: SolverRun
    difference: float

    def record(self) -> tables.Record:
        """Everything, as the report has it."""
        run = self.run
        residuals = run.residuals
        return {
            "name": run.name,
            "iterations": run.iterations,
            "relative_residual": float(residuals[-1]) if len(residuals) else None,
            "stages": {**run.stages, "poisson": run.solve_seconds},
            "seconds": run.seconds,
            "spectrum_seconds": run.spectrum_seconds,
            "difference_from_direct": self.difference,
            "residuals": residuals,
            "times": run.times,
        }


def compare_solvers(
    arguments: argparse.Namespace,
    geometry: Geometry,
    triangulation: IntrinsicTriangulation,
    sources: Sources,
) -> list[Compared]:
    """Measure every solver on the same problem, from the arrays of the geometry on.

    Compiled code is loaded and tried on a small sphere before any clock starts.
    """
    ball = sphere(subdivisions=4).geometry
    small = argparse.Namespace(**vars(arguments) | {"modes": 20})
    with step("warming up"), telling(quiet=True):
        for _, measure in _measures(small, ball, intrinsic_delaunay(ball), check_sources(0, ball)):
            measure()
    measures = list(_measures(arguments, geometry, triangulation, sources))
    fastest: dict[str, tuple[SolverRun, Floats]] = {}
    for _ in range(_REPEATS):
        for name, measure in measures:
            with step(f"trying {name}"):
                run, distance = measure()
            if name not in fastest or run.seconds < fastest[name][0].seconds:
                fastest[name] = run, distance
    _, reference = fastest[_DIRECT]
    return [
        Compared(run, largest_difference(distance, reference)) for run, distance in fastest.values()
    ]


def largest_difference(distance: Floats, reference: Floats) -> float:
    """Return the largest difference where `reference` is finite, relative to its largest value."""
    known = np.isfinite(reference)
    largest = float(reference[known].max()) or 1.0
    return float(np.abs(distance[known] - reference[known]).max()) / largest


def comparison_table(compared: list[Compared]) -> str:
    """One row for each solver."""
    rows = [
        ("", "", "relative", "seconds", "spectrum", "difference"),
        ("solver", "iterations", "residual", "in all", "besides", "from direct"),
    ]
    for one in compared:
        run, residuals = one.run, one.run.residuals
        rows.append(
            (
                run.name,
                "" if run.iterations is None else str(run.iterations),
                f"{residuals[-1]:.1e}" if len(residuals) else "",
                f"{run.seconds:.2f}",
                f"{run.spectrum_seconds:.2f}" if run.spectrum_seconds else "",
                f"{one.difference:.1e}",
            )
        )
    return tables.align(rows, left=1)


def clock_note() -> str:
    """What the seconds are."""
    return (
        f"Faster of {_REPEATS} runs each, by turns, after a warm-up. The clock starts with the"
        " geometry alone; imports and compilation are not counted."
        f" {os.cpu_count()} processor cores."
    )


_Entry = tuple[str, Callable[[], tuple[SolverRun, Floats]]]


def _measures(
    arguments: argparse.Namespace,
    geometry: Geometry,
    triangulation: IntrinsicTriangulation,
    sources: Sources,
) -> Iterator[_Entry]:
    """Names of the solvers, and what measures each."""
    modes = arguments.modes or COMPARED_MODES
    shipped = Iterative(rtol=arguments.rtol)
    few = min(modes, shipped.modes)
    spectra = {
        name: spectrum_named(name, arguments, triangulation.laplacian, modes) for name in _SPECTRA
    }
    spectra["few"] = spectrum_named("exact", arguments, triangulation.laplacian, few)

    def ours(name: str, solver: Direct | Iterative, source: str = "none") -> _Entry:
        spectrum = spectra.get(source)
        return name, lambda: _run_ours(arguments, geometry, sources, name, solver, spectrum)

    # One base for all that differ in the coarse space alone: level 0, as in the paper.
    base = Iterative(coarse="none", drop=None, relaxation=0.0, modes=modes, rtol=arguments.rtol)
    additive, projected = replace(base, coarse="additive"), replace(base, coarse="projected")
    yield ours("IC(0)", base)
    for name, words in _SPECTRA.items():
        yield ours(f"IC(0) + {modes} {words}", additive, name)
    yield ours(f"IC(0) + {modes} exact modes, projected", projected, "exact")
    yield ours("relaxed IC", replace(shipped, coarse="none"))
    yield ours(f"relaxed IC + {few} exact modes", shipped, "few")
    yield ours(_DIRECT, Direct())
    yield _PEER, lambda: _run_peer(arguments, geometry, sources, _PEER)


def _run_ours(
    arguments: argparse.Namespace,
    geometry: Geometry,
    sources: Sources,
    name: str,
    solver: Direct | Iterative,
    spectrum: Spectrum | None,
) -> tuple[SolverRun, Floats]:
    start = time.perf_counter()
    geodesics = HeatGeodesics(
        geometry, spectrum, solver=solver, time_coefficient=arguments.time_coefficient
    )
    field = geodesics.distance(sources)
    whole = time.perf_counter() - start
    poisson, stages = field.poisson, dict(field.seconds)
    # The curve begins after a start of its own, and ends when the step does.
    times = poisson.times + max(stages.pop("poisson") - float(poisson.times[-1]), 0.0)
    # What no stage claims is counted too.
    stages["other"] = max(whole - sum(stages.values()) - float(times[-1]), 0.0)
    run = SolverRun(
        name=name,
        stages=stages,
        spectrum_seconds=0.0 if spectrum is None else _solving_seconds(spectrum),
        times=times,
        residuals=poisson.residual_norms / (poisson.rhs_norm or 1.0),
    )
    return run, field.distance


def _solving_seconds(spectrum: Spectrum) -> float:
    """Return what the modes took; their operator is the triangulation, which has its own stage."""
    seconds = spectrum.provenance.seconds
    return sum(taken for stage, taken in seconds.items() if stage != "assembly")


def _run_peer(
    arguments: argparse.Namespace, geometry: Geometry, sources: Sources, name: str
) -> tuple[SolverRun, Floats]:
    """Build and solve once by potpourri3d; it tells no residual."""
    import potpourri3d

    start = time.perf_counter()
    coefficient = arguments.time_coefficient
    if isinstance(geometry, TriangleMesh):
        solver = potpourri3d.MeshHeatMethodDistanceSolver(
            geometry.points, geometry.faces, t_coef=coefficient
        )
    else:
        solver = potpourri3d.PointCloudHeatSolver(geometry.points, t_coef=coefficient)
    built = time.perf_counter()
    distance = np.asarray(solver.compute_distance_multisource(sources.vertices.tolist()))
    stages = {"build": built - start, "first solve": time.perf_counter() - built}
    return SolverRun(name=name, stages=stages), distance
