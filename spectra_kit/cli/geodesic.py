"""Geodesic distances: numbers, a coloured mesh, a report, and pictures."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from spectra_kit._types import Floats
from spectra_kit._validate import check_count, check_positive, quantity
from spectra_kit.cli import tables
from spectra_kit.cli.folder import check_folder, drawing, together
from spectra_kit.cli.geodesic_compare import Compared, clock_note, compare_solvers, comparison_table
from spectra_kit.cli.geodesic_method import (
    check_spectrum,
    linear_solver,
    spectrum_named,
    why_without_modes,
)
from spectra_kit.cli.geodesic_options import SPECTRA
from spectra_kit.cli.geodesic_sources import (
    Source,
    check_named,
    named_sources,
    positions,
    source_records,
    with_farthest,
)
from spectra_kit.cli.inputs import load
from spectra_kit.cli.options import DEMO, up_of
from spectra_kit.cli.output import as_json, print_blocks, print_json
from spectra_kit.cli.progress import step
from spectra_kit.cli.words import stem
from spectra_kit.errors import InvalidInputError
from spectra_kit.geodesics import DistanceField, HeatGeodesics, Iterative
from spectra_kit.geodesics.sources import check_sources
from spectra_kit.geometry import Geometry
from spectra_kit.geometry.formats import ply
from spectra_kit.operators import IntrinsicTriangulation, intrinsic_delaunay
from spectra_kit.spectra import Spectrum
from spectra_kit.viz.distance_scale import distance_colours

_NUMBERS = ("distance.npy", "distance.ply", "report.json")
_FIELD, _CONVERGENCE = "field.png", "convergence.png"


def geodesic_distances(arguments: argparse.Namespace) -> None:
    """Measure distances, write them with a report and pictures into one folder."""
    folder: Path = arguments.output
    if arguments.modes is not None:
        check_count("--modes", arguments.modes, low=1)
    for option in ("rtol", "time_coefficient", "spacing"):
        if (value := getattr(arguments, option)) is not None:
            check_positive("--" + option.replace("_", "-"), value)
    if arguments.compare and arguments.boundary != "neumann":
        raise InvalidInputError(
            f"--compare is for --boundary neumann, got {arguments.boundary}; leave one out"
        )
    check_spectrum(arguments)
    check_named(arguments)
    inputs = [Path(name) for name in (arguments.file, arguments.spectrum) if name != DEMO]
    check_folder(folder, _files(arguments), (*_NUMBERS, _FIELD, _CONVERGENCE), inputs)

    geometry = load(arguments)
    sources = named_sources(arguments, geometry)
    check_sources(sources or [0], geometry)
    with step(f"triangulating {geometry.n:,} points"):
        triangulation = intrinsic_delaunay(geometry)
    solver = linear_solver(arguments)
    unused = why_without_modes(arguments, solver, geometry.n)
    # Modes of a file cost nothing, and are checked.
    spectrum = spectrum_named(
        "none" if unused and arguments.spectrum in SPECTRA else arguments.spectrum,
        arguments,
        triangulation.laplacian,
        arguments.modes or Iterative().modes,
    )
    with step("preparing the solver"):
        geodesics = HeatGeodesics(
            triangulation,
            spectrum,
            solver=solver,
            time_coefficient=arguments.time_coefficient,
            boundary=arguments.boundary,
        )
    with step("looking for the farthest points"):
        sources = with_farthest(
            sources,
            arguments.farthest,
            lambda few: geodesics.distance(check_sources(few, geometry)).distance,
        )
    with step(f"measuring the distance to {quantity(len(sources), 'source')}"):
        field = geodesics.distance(check_sources(sources, geometry))
    record = _record(arguments, geometry, triangulation, sources, spectrum, field)
    record["spectrum_unused"] = unused or None
    compared = None
    if arguments.compare:
        compared = compare_solvers(
            arguments, geometry, triangulation, check_sources(sources, geometry)
        )
        record["comparison"] = [one.record() for one in compared]
    with step(f"writing {folder}"):
        written = _write(folder, geometry, field.distance, record)
    if not arguments.no_pictures:
        pictures = [folder / name for name in _files(arguments)[len(_NUMBERS) :]]
        with drawing(pictures, kept=f"the numbers in {folder} are whole"):
            written += _draw(arguments, geometry, sources, field, compared)
    if arguments.json:
        print_json(**record, written=[str(path) for path in written])
        return
    print_blocks(
        tables.headline(arguments.file, geometry, triangulation.laplacian),
        tables.pairs(_facts(record)),
        *([] if compared is None else [comparison_table(compared)]),
        "\n".join(f"written: {path}" for path in written),
    )


def _files(arguments: argparse.Namespace) -> tuple[str, ...]:
    """Names of all that will be written."""
    if arguments.no_pictures:
        return _NUMBERS
    return (*_NUMBERS, _FIELD) + ((_CONVERGENCE,) if arguments.compare else ())


def _record(
    arguments: argparse.Namespace,
    geometry: Geometry,
    triangulation: IntrinsicTriangulation,
    sources: list[Source],
    spectrum: Spectrum | None,
    field: DistanceField,
) -> tables.Record:
    """What the report says."""
    reached = field.distance[field.reached]
    return {
        "input": arguments.file,
        **tables.geometry_record(geometry),
        **tables.operator_record(triangulation.laplacian),
        "boundary": arguments.boundary,
        "sources": source_records(sources),
        "solver": arguments.solver,
        "choice": field.choice,
        "time_coefficient": arguments.time_coefficient,
        "time_step": field.time_step,
        "iterations": field.poisson.iterations,
        "relative_residual": field.poisson.relative_residual,
        "heat": {
            "method": field.heat.method,
            "iterations": field.heat.iterations,
            "backward_error": field.heat.backward_error,
        },
        "seconds": dict(field.seconds),
        "spectrum": spectrum and _spectrum_record(arguments.spectrum, spectrum),
        "largest_distance": float(reached.max()),
        "mean_distance": float(reached.mean()),
        "points_not_reached": int((~field.reached).sum()),
    }


def _spectrum_record(name: str, spectrum: Spectrum) -> tables.Record:
    provenance = spectrum.provenance
    return {
        "from": name,
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
    arguments: argparse.Namespace,
    geometry: Geometry,
    sources: list[Source],
    field: DistanceField,
    compared: list[Compared] | None,
) -> list[Path]:
    from spectra_kit.viz import Page, View, plot_convergence, plot_distance

    folder, name, dpi = arguments.output, stem(arguments.file), arguments.dpi
    size = f"{geometry.n:,} points"
    plot_distance(
        folder / _FIELD,
        geometry,
        field.distance,
        sources=positions(sources, geometry),
        spacing=arguments.spacing,
        view=View(up_of(arguments), arguments.turn),
        page=Page(name, f"{size} \N{MIDDLE DOT} {field.choice}", dpi),
    )
    if compared is None:
        return [folder / _FIELD]
    plot_convergence(
        folder / _CONVERGENCE,
        [one.run for one in compared],
        rtol=arguments.rtol,
        solve_name="Poisson step",
        page=Page(f"{name}: the Poisson step of the heat method, {size}", clock_note(), dpi),
    )
    return [folder / _FIELD, folder / _CONVERGENCE]
