"""Geodesic distances: numbers, a coloured mesh, a report, and pictures."""

from __future__ import annotations

from typing import cast

import numpy as np

from spectra_kit._core.validate import check_positive, quantity
from spectra_kit.cli import geodesic_setup as setup
from spectra_kit.cli import program, tables
from spectra_kit.cli.geodesic_compare import Compared, clock_note, compare_solvers, comparison_table
from spectra_kit.cli.inputs import load
from spectra_kit.cli.output import as_json, check_folder, drawing, tell, together
from spectra_kit.cli.progress import step
from spectra_kit.cli.words import stem
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.geodesics import DistanceField, FacePoint, HeatGeodesics, Iterative
from spectra_kit.geodesics.exact import exact_field
from spectra_kit.geodesics.sources import check_sources
from spectra_kit.geometry import Geometry, TriangleMesh
from spectra_kit.geometry.formats import ply
from spectra_kit.operators import IntrinsicTriangulation, intrinsic_delaunay
from spectra_kit.show import Page, View, plot_convergence, plot_distance
from spectra_kit.show.colours import distance_colours

_NUMBERS = ("distance.npy", "distance.ply", "report.json")
_PICTURES = ("field.png", "convergence.png")


def geodesic_distances(asked: program.Geodesic) -> None:
    """Measure distances, write them with a report and pictures into one folder."""
    folder = asked.output
    if check_positive("--poisson-rtol", asked.poisson_rtol) >= 1:
        raise InvalidInputError("--poisson-rtol", "be less than 1", asked.poisson_rtol)
    check_positive("--time-coefficient", asked.time_coefficient)
    if asked.spacing is not None:
        check_positive("--spacing", asked.spacing)
    if asked.compare and asked.heat_boundary != "neumann":
        raise InvalidInputError(
            "--heat-boundary",
            "be neumann with --compare",
            asked.heat_boundary,
            advice="leave one out",
        )
    setup.check_solver(asked)
    farthest = setup.check_named(asked)
    pictures = () if asked.no_pictures else _PICTURES if asked.compare else _PICTURES[:1]
    check_folder(folder, _NUMBERS + pictures, _NUMBERS + _PICTURES, asked.inputs)

    geometry, kept = load(asked.file, asked)
    sources = setup.named_sources(asked, geometry, kept)
    check_sources(sources or [0], geometry)
    with step(f"triangulating {geometry.n:,} points"):
        triangulation = intrinsic_delaunay(geometry)
    modes = setup.number_of_modes(asked, triangulation.laplacian, usual=Iterative().modes)
    solver = setup.linear_solver(asked, modes)
    unused = setup.why_without_modes(asked, solver, geometry.n)
    # Modes of a file cost nothing, and are checked.
    spectrum = None
    if asked.spectrum or not unused:
        spectrum = setup.coarse_spectrum(asked, triangulation.laplacian, modes)
    with step("preparing the solver"):
        geodesics = HeatGeodesics(
            triangulation,
            spectrum,
            solver=solver,
            time_coefficient=asked.time_coefficient,
            boundary=asked.heat_boundary,
        )
        geodesics.geometry = geometry  # whose triangles it may doubt

    def measure(some: list[setup.Source]) -> DistanceField:
        exact = exact_field(geometry, some) if setup.may_be_exact(asked) else None
        return geodesics.distance(check_sources(some, geometry)) if exact is None else exact

    with step("looking for the farthest points"):
        sources = setup.with_farthest(sources, farthest, lambda few: measure(few).distance)
    checked = check_sources(sources, geometry)
    with step(f"measuring the distance to {quantity(len(sources), 'source')}"):
        field = measure(sources)
    compared = compare_solvers(asked, geometry, triangulation, checked) if asked.compare else []
    in_file = [s if isinstance(s, FacePoint) else int(kept.first[s]) for s in sources]
    record = _record(asked, geometry, triangulation, in_file, spectrum, field)
    record["spectrum_unused"] = unused or None
    if compared:
        record["comparison"] = [one.record() for one in compared]
    writing = together(folder, report=_NUMBERS[2], replacing=_PICTURES)
    with step(f"writing {folder}"), writing as part:
        np.save(part / _NUMBERS[0], kept.spread(field.distance, np.nan))
        shades = distance_colours(field.distance).T
        values = dict(zip(("red", "green", "blue"), shades, strict=True))
        values["quality"] = field.distance  # as MeshLab calls it
        ply.write(geometry, part / _NUMBERS[1], values)
        (part / _NUMBERS[2]).write_text(as_json(record))
    if pictures:
        paths = [folder / name for name in pictures]
        with drawing(paths, kept=f"the numbers in {folder} are whole"):
            _draw(asked, geometry, sources, field, compared)
    written = [str(folder / name) for name in _NUMBERS + pictures]
    tell(
        asked,
        {**record, "written": written},
        tables.headline(asked.file, geometry, triangulation.laplacian),
        tables.pairs(_facts(record)),
        *([comparison_table(compared)] if compared else []),
        "\n".join(f"written: {path}" for path in written),
    )


def _record(
    asked: program.Geodesic,
    geometry: Geometry,
    triangulation: IntrinsicTriangulation,
    sources: list[setup.Source],
    spectrum: Spectrum | None,
    field: DistanceField,
) -> tables.Record:
    """What the report says."""
    reached = field.distance[field.reached]
    return {
        "input": asked.file,
        **tables.geometry_record(geometry),
        **tables.operator_record(triangulation.laplacian),
        "heat_boundary": asked.heat_boundary,
        "sources": [vars(s) if isinstance(s, FacePoint) else {"point": s} for s in sources],
        "method": asked.method,
        "choice": field.choice,
        "time_coefficient": asked.time_coefficient,
        "time_step": field.time_step,
        "iterations": field.poisson and field.poisson.iterations,
        "relative_residual": field.poisson and field.poisson.relative_residual,
        "heat": field.heat
        and {
            "method": field.heat.method,
            "iterations": field.heat.iterations,
            "backward_error": field.heat.backward_error,
        },
        "seconds": dict(field.seconds),
        "spectrum": spectrum
        and {
            "from": str(asked.spectrum or asked.solver),
            "modes": spectrum.k,
            "solver": spectrum.provenance.solver,
            "seconds": sum(spectrum.provenance.seconds.values()),
        },
        "largest_distance": float(reached.max()),
        "mean_distance": float(reached.mean()),
        "points_not_reached": int((~field.reached).sum()),
    }


def _facts(record: tables.Record) -> dict[str, object]:
    """What the terminal shows of it."""
    modes, unused = record["spectrum"], record["spectrum_unused"]
    return {
        "sources": len(record["sources"]),
        "solver": record["choice"],
        **(_system(record) if record["heat"] else {}),
        "seconds": tables.seconds(record["seconds"]),
        **({"seconds of the spectrum": f"{modes['seconds']:.2f}"} if modes else {}),
        **({"spectrum": unused} if unused else {}),
        "largest distance": record["largest_distance"],
        "mean distance": record["mean_distance"],
        "points not reached": f"{record['points_not_reached']:,}",
    }


def _system(record: tables.Record) -> dict[str, object]:
    return {
        "time step": record["time_step"],
        "iterations": record["iterations"],
        "relative residual": f"{record['relative_residual']:.1e}",
    }


def _draw(
    asked: program.Geodesic,
    geometry: Geometry,
    sources: list[setup.Source],
    field: DistanceField,
    compared: list[Compared],
) -> None:
    folder, name, size = asked.output, stem(asked.file), f"{geometry.n:,} points"
    method = "heat method" if field.heat else "exact distances"
    mesh = cast(TriangleMesh, geometry)  # where there are points of faces
    places = [s.position(mesh) if isinstance(s, FacePoint) else mesh.points[s] for s in sources]
    plot_distance(
        folder / _PICTURES[0],
        geometry,
        field.distance,
        sources=np.array(places),
        spacing=asked.spacing,
        view=View(asked.upwards, asked.turn),
        page=Page(name, f"{size} \N{MIDDLE DOT} {method}", asked.dpi),
    )
    if compared:
        heading = f"{name}: the Poisson step of the heat method, {size}"
        plot_convergence(
            folder / _PICTURES[1],
            [one.run for one in compared],
            rtol=asked.poisson_rtol,
            solve_name="Poisson step",
            page=Page(heading, clock_note(), asked.dpi),
        )
