"""Geodesic distances: numbers, a coloured mesh, a report, and pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from spectra_kit._types import Floats
from spectra_kit._validate import check_positive, quantity
from spectra_kit.cli import program, tables
from spectra_kit.cli.folder import check_folder, drawing, together
from spectra_kit.cli.geodesic_compare import Compared, clock_note, compare_solvers, comparison_table
from spectra_kit.cli.geodesic_solver import (
    check_solver,
    coarse_spectrum,
    linear_solver,
    number_of_modes,
    why_without_modes,
)
from spectra_kit.cli.geodesic_sources import (
    Source,
    check_named,
    named_sources,
    positions,
    source_records,
    with_farthest,
)
from spectra_kit.cli.inputs import load_numbered
from spectra_kit.cli.options import CoarseSolver
from spectra_kit.cli.output import as_json, print_blocks, print_json
from spectra_kit.cli.outputs import up_of
from spectra_kit.cli.progress import step
from spectra_kit.cli.words import stem
from spectra_kit.errors import InvalidInputError
from spectra_kit.geodesics import DistanceField, HeatGeodesics, Iterative
from spectra_kit.geodesics.sources import check_sources
from spectra_kit.geometry import Geometry
from spectra_kit.geometry.formats import ply
from spectra_kit.operators import IntrinsicTriangulation, intrinsic_delaunay
from spectra_kit.spectra import Spectrum
from spectra_kit.viz.colours import distance_colours

_NUMBERS = ("distance.npy", "distance.ply", "report.json")
_FIELD, _CONVERGENCE = "field.png", "convergence.png"


def geodesic_distances(asked: program.Geodesic) -> None:
    """Measure distances, write them with a report and pictures into one folder."""
    folder, heat = asked.output.output, asked.heat
    if check_positive("--poisson-rtol", heat.poisson_rtol) >= 1:
        raise InvalidInputError("--poisson-rtol", "be less than 1", heat.poisson_rtol)
    check_positive("--time-coefficient", heat.time_coefficient)
    if asked.output.spacing is not None:
        check_positive("--spacing", asked.output.spacing)
    if asked.output.compare and heat.heat_boundary != "neumann":
        raise InvalidInputError(
            f"--compare is for --heat-boundary neumann, got {heat.heat_boundary}; leave one out"
        )
    check_solver(asked)
    farthest = check_named(asked)
    inputs = [Path(asked.file), *asked.solver.files]
    check_folder(folder, _files(asked), (*_NUMBERS, _FIELD, _CONVERGENCE), inputs)

    geometry, numbers = load_numbered(asked.file, asked.reading)
    sources = named_sources(asked, geometry, numbers)
    check_sources(sources or [0], geometry)
    with step(f"triangulating {geometry.n:,} points"):
        triangulation = intrinsic_delaunay(geometry)
    modes = number_of_modes(asked.solver, triangulation.laplacian, usual=Iterative().modes)
    solver = linear_solver(asked, farthest + 1, modes)
    unused = why_without_modes(asked.solver, solver, geometry.n)
    # Modes of a file cost nothing, and are checked.
    spectrum = None
    if asked.solver.spectrum or not unused:
        spectrum = coarse_spectrum(asked, triangulation.laplacian, modes)
    with step("preparing the solver"):
        geodesics = HeatGeodesics(
            triangulation,
            spectrum,
            solver=solver,
            time_coefficient=heat.time_coefficient,
            boundary=heat.heat_boundary,
        )
    with step("looking for the farthest points"):
        sources = with_farthest(
            sources,
            farthest,
            lambda few: geodesics.distance(check_sources(few, geometry)).distance,
        )
    with step(f"measuring the distance to {quantity(len(sources), 'source')}"):
        field = geodesics.distance(check_sources(sources, geometry))
    record = _record(asked, geometry, triangulation, sources, spectrum, field)
    record["spectrum_unused"] = unused or None
    compared = None
    if asked.output.compare:
        compared = compare_solvers(asked, geometry, triangulation, check_sources(sources, geometry))
        record["comparison"] = [one.record() for one in compared]
    with step(f"writing {folder}"):
        written = _write(folder, geometry, field.distance, record)
    if not asked.drawing.no_pictures:
        pictures = [folder / name for name in _files(asked)[len(_NUMBERS) :]]
        with drawing(pictures, kept=f"the numbers in {folder} are whole"):
            written += _draw(asked, geometry, sources, field, compared)
    if asked.general.json:
        print_json(**record, written=[str(path) for path in written])
        return
    print_blocks(
        tables.headline(asked.file, geometry, triangulation.laplacian),
        tables.pairs(_facts(record)),
        *([] if compared is None else [comparison_table(compared)]),
        "\n".join(f"written: {path}" for path in written),
    )


def _files(asked: program.Geodesic) -> tuple[str, ...]:
    """Names of all that will be written."""
    if asked.drawing.no_pictures:
        return _NUMBERS
    return (*_NUMBERS, _FIELD) + ((_CONVERGENCE,) if asked.output.compare else ())


def _record(
    asked: program.Geodesic,
    geometry: Geometry,
    triangulation: IntrinsicTriangulation,
    sources: list[Source],
    spectrum: Spectrum | None,
    field: DistanceField,
) -> tables.Record:
    """What the report says."""
    reached = field.distance[field.reached]
    return {
        "input": asked.file,
        **tables.geometry_record(geometry),
        **tables.operator_record(triangulation.laplacian),
        "heat_boundary": asked.heat.heat_boundary,
        "sources": source_records(sources),
        "method": asked.heat.method,
        "choice": field.choice,
        "time_coefficient": asked.heat.time_coefficient,
        "time_step": field.time_step,
        "iterations": field.poisson.iterations,
        "relative_residual": field.poisson.relative_residual,
        "heat": {
            "method": field.heat.method,
            "iterations": field.heat.iterations,
            "backward_error": field.heat.backward_error,
        },
        "seconds": dict(field.seconds),
        "spectrum": spectrum and _spectrum_record(asked.solver, spectrum),
        "largest_distance": float(reached.max()),
        "mean_distance": float(reached.mean()),
        "points_not_reached": int((~field.reached).sum()),
    }


def _spectrum_record(asked: CoarseSolver, spectrum: Spectrum) -> tables.Record:
    provenance = spectrum.provenance
    return {
        "from": str(asked.spectrum or asked.solver),
        "modes": spectrum.k,
        "solver": provenance.solver,
        "seconds": sum(provenance.seconds.values()),
    }


def _facts(record: tables.Record) -> dict[str, object]:
    """What the terminal shows of it."""
    seconds: dict[str, float] = record["seconds"]
    stages = ", ".join(f"{name} {s:.2f}" for name, s in seconds.items() if s >= 0.005)
    modes = record["spectrum"]
    return {
        "sources": len(record["sources"]),
        "solver": record["choice"],
        "time step": record["time_step"],
        "iterations": record["iterations"],
        "relative residual": f"{record['relative_residual']:.1e}",
        "seconds": f"{sum(seconds.values()):.2f}" + (f"  ({stages})" if stages else ""),
        **({"seconds of the spectrum": f"{modes['seconds']:.2f}"} if modes else {}),
        **({"spectrum": record["spectrum_unused"]} if record["spectrum_unused"] else {}),
        "largest distance": record["largest_distance"],
        "mean distance": record["mean_distance"],
        "points not reached": f"{record['points_not_reached']:,}",
    }


def _write(folder: Path, geometry: Geometry, distance: Floats, record: tables.Record) -> list[Path]:
    """The distances, the coloured geometry and the report, all or none."""
    numbers, coloured, report = _NUMBERS
    with together(folder, report=report, replacing=(_FIELD, _CONVERGENCE)) as part:
        np.save(part / numbers, distance)
        colours = dict(zip(("red", "green", "blue"), distance_colours(distance).T, strict=True))
        ply.write(geometry, part / coloured, {**colours, "quality": distance})  # as MeshLab says
        (part / report).write_text(as_json(record))
    return [folder / name for name in _NUMBERS]


def _draw(
    asked: program.Geodesic,
    geometry: Geometry,
    sources: list[Source],
    field: DistanceField,
    compared: list[Compared] | None,
) -> list[Path]:
    from spectra_kit.viz import Page, View, plot_convergence, plot_distance

    folder, name, dpi = asked.output.output, stem(asked.file), asked.drawing.dpi
    size = f"{geometry.n:,} points"
    plot_distance(
        folder / _FIELD,
        geometry,
        field.distance,
        sources=positions(sources, geometry),
        spacing=asked.output.spacing,
        view=View(up_of(asked.drawing, asked.file), asked.drawing.turn),
        page=Page(name, f"{size} \N{MIDDLE DOT} {field.choice}", dpi),
    )
    if compared is None:
        return [folder / _FIELD]
    plot_convergence(
        folder / _CONVERGENCE,
        [one.run for one in compared],
        rtol=asked.heat.poisson_rtol,
        solve_name="Poisson step",
        page=Page(f"{name}: the Poisson step of the heat method, {size}", clock_note(), dpi),
    )
    return [folder / _FIELD, folder / _CONVERGENCE]
