"""Geodesic distances: numbers, a coloured mesh, a report, and pictures."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, cast

import numpy as np
from cyclopts import Parameter

from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count, check_indices, check_positive, quantity
from spectra_kit.cli import tables
from spectra_kit.cli.geodesic_compare import (
    Compared,
    clock_note,
    compare_solvers,
    comparison_table,
    number_of_modes,
)
from spectra_kit.cli.inputs import Numbering, load
from spectra_kit.cli.options import (
    DEMO,
    NETWORK,
    Command,
    Count,
    FolderDrawing,
    OneFile,
    Output,
    SolverName,
    Spared,
    refuse_given,
)
from spectra_kit.cli.output import as_json, check_folder, drawing, tell, together
from spectra_kit.cli.progress import step
from spectra_kit.cli.solving import check_solvers, refuse_solving, solve
from spectra_kit.cli.words import stem
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.geodesics import (
    Direct,
    DistanceField,
    FacePoint,
    HeatGeodesics,
    Iterative,
    WithinMemory,
    nearest_source,
)
from spectra_kit.geodesics.distance import exact_field
from spectra_kit.geodesics.sources import check_sources
from spectra_kit.geometry import Geometry, TriangleMesh
from spectra_kit.geometry.formats import ply
from spectra_kit.operators import IntrinsicTriangulation, Laplacian, intrinsic_delaunay
from spectra_kit.show import Page, View, plot_convergence, plot_distance
from spectra_kit.show.colours import distance_colours

_NUMBERS = ("distance.npy", "distance.ply", "report.json")
_PICTURES = ("field.png", "convergence.png")
_COARSE: dict[str, Literal["additive", "projected", "none"]] = {
    "iterative": "additive",
    "projected": "projected",
    "plain": "none",
}
Source = int | FacePoint
Solver = WithinMemory | Direct | Iterative


@dataclass(frozen=True, kw_only=True)
class _Sources(Command, group="sources"):
    """Where the distance is zero."""

    source: Annotated[tuple[int, ...], Parameter(consume_multiple=True, metavar="INDEX ...")] = ()
    """points of the file, counted from 0; the distance is to the nearest of all sources, of which
    the demo has one by default"""
    at: Annotated[tuple[tuple[float, float, float], ...], Parameter(metavar="X Y Z")] = ()
    """the point of the surface nearest to this place (may be repeated)"""
    face: Annotated[
        tuple[tuple[float, float, float, float], ...], Parameter(metavar="F B0 B1 B2")
    ] = ()
    """a point of a face, by its barycentric coordinates (may be repeated)"""
    farthest: int = 0
    """add N points, each the farthest from all sources before it (the first, where there are none,
    from point 0)"""


@dataclass(frozen=True, kw_only=True)
class _Heat(Command, group="method"):
    """How distances are computed."""

    method: Literal["auto", "direct", "iterative", "projected", "plain"] = "auto"
    """of the linear systems: direct, by a factor; or by conjugate gradients with incomplete
    Cholesky: plain, or with a coarse space of modes added (iterative) or projected out (projected);
    auto solves none on meshes of at most 2,000 vertices, where exact distances are quick, and is
    direct where factors fit into memory"""
    poisson_rtol: float = 1e-8
    """relative residual at which iterations stop"""
    time_coefficient: float = 1.0
    """the heat diffuses for X squared typical edge lengths; more is smoother"""
    heat_boundary: Literal["neumann", "dirichlet", "average"] = "neumann"
    """what heat does at a boundary: neumann, stay; dirichlet, leave; average, the mean of both"""


@dataclass(frozen=True, kw_only=True)
class GeodesicOptions(OneFile, Spared, _Sources, _Heat, FolderDrawing):
    """Measure distances along a surface, and draw them with isolines."""

    examples = (
        "geodesic bunny.obj --source 7",
        "geodesic bunny.obj --at 0.1 0.2 0.0 --farthest 3 -o far",
        f"geodesic {DEMO} --compare",
    )
    keys = (
        "input, kind, points, faces, operator, operator area, operator components, zero modes,"
        " fixed points, eigenvalue spacing, heat_boundary, sources, method, choice,"
        " time_coefficient, time_step, iterations, relative_residual, heat, seconds, spectrum,"
        " largest_distance, mean_distance, points_not_reached, spectrum_unused, comparison,"
        " written"
    )

    k: Count | None = None
    """number of modes (default: 24 and those of eigenvalue 0; 96 with --compare)"""
    solver: SolverName | None = None
    """what solves for modes for the coarse space of the linear solver, which may do without
    (default: none)"""
    output: Output = Path("geodesic")
    """folder for the distances, the report and the pictures"""
    compare: bool = False
    """also solve by every solver, and draw and print how each converges"""
    spacing: float | None = None
    """between two isolines (default: 20 to 40 lines)"""


def geodesic_distances(asked: GeodesicOptions) -> None:
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
    check_solver(asked)
    farthest = check_named(asked)
    pictures = () if asked.no_pictures else _PICTURES if asked.compare else _PICTURES[:1]
    check_folder(folder, _NUMBERS + pictures, _NUMBERS + _PICTURES, asked.inputs)

    geometry, kept = load(asked.file, asked)
    sources = named_sources(asked, geometry, kept)
    check_sources(sources or [0], geometry)
    with step(f"triangulating {geometry.n:,} points"):
        triangulation = intrinsic_delaunay(geometry)
    modes = number_of_modes(asked, triangulation.laplacian, usual=Iterative().modes)
    solver = linear_solver(asked, modes)
    unused = why_without_modes(asked, solver, geometry.n)
    # Modes of a file cost nothing, and are checked.
    spectrum = None
    if asked.spectrum or not unused:
        spectrum = coarse_spectrum(asked, triangulation.laplacian, modes)
    with step("preparing the solver"):
        geodesics = HeatGeodesics(
            triangulation,
            spectrum,
            solver=solver,
            time_coefficient=asked.time_coefficient,
            boundary=asked.heat_boundary,
        )
        geodesics.geometry = geometry  # whose triangles it may doubt

    def measure(some: list[Source]) -> DistanceField:
        exact = exact_field(geometry, some) if may_be_exact(asked) else None
        return geodesics.distance(check_sources(some, geometry)) if exact is None else exact

    with step("looking for the farthest points"):
        sources = with_farthest(sources, farthest, lambda few: measure(few).distance)
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
    asked: GeodesicOptions,
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
    asked: GeodesicOptions,
    geometry: Geometry,
    sources: list[Source],
    field: DistanceField,
    compared: list[Compared],
) -> None:
    folder, name, size = asked.output, stem(asked.file), f"{geometry.n:,} points"
    method = "heat method" if field.heat else "exact distances"
    mesh = cast(TriangleMesh, geometry)  # where there are points of faces
    places = [s.position(mesh) if isinstance(s, FacePoint) else mesh.points[s] for s in sources]
    plot_distance(
        geometry,
        field.distance,
        path=folder / _PICTURES[0],
        sources=np.array(places),
        spacing=asked.spacing,
        view=View(asked.upwards, asked.turn),
        page=Page(name, f"{size} \N{MIDDLE DOT} {method}", asked.dpi),
    )
    if compared:
        heading = f"{name}: the Poisson step of the heat method, {size}"
        plot_convergence(
            [one.run for one in compared],
            path=folder / _PICTURES[1],
            rtol=asked.poisson_rtol,
            solve_name="Poisson step",
            page=Page(heading, clock_note(), asked.dpi),
        )


def check_solver(asked: GeodesicOptions) -> None:
    """Refuse options of solvers that are not used, and solvers that lack what they need."""
    if asked.k is not None:
        check_count("-k", asked.k, low=1)
    if asked.spectrum:
        refuse_solving(asked)
    elif asked.solver:
        check_solvers(asked, asked.solver)
    elif not asked.compare:
        why = "without modes; choose what solves for them by --solver"
        refuse_given(asked, ("k", "rtol", "start", *NETWORK), why)
    if asked.method == "direct" and not asked.compare:
        refuse_given(asked, ["poisson_rtol"], "on a direct solver; choose another by --method")
    with_modes = bool(asked.spectrum or asked.solver)
    if asked.method == "projected" and not with_modes:
        raise InvalidInputError(
            "--method projected needs modes", advice="choose what solves for them by --solver"
        )
    if asked.method in ("direct", "plain") and with_modes and not asked.compare:
        named = f"--spectrum {asked.spectrum}" if asked.spectrum else f"--solver {asked.solver}"
        raise InvalidInputError(
            f"--method {asked.method}", "be given no modes", named, advice="leave one out"
        )


def may_be_exact(asked: GeodesicOptions) -> bool:
    """Whether nothing is asked for that only the heat method has."""
    heat = asked.compare or asked.spectrum or asked.solver or asked.heat_boundary != "neumann"
    return asked.method == "auto" and asked.time_coefficient == 1 and not heat


def linear_solver(asked: GeodesicOptions, modes: int) -> Solver:
    """Return the solver that ``--method`` names, with so many modes at most."""
    rtol = asked.poisson_rtol
    if asked.method == "auto":
        return WithinMemory(modes=modes, rtol=rtol)
    if asked.method == "direct":
        return Direct()
    return Iterative(coarse=_COARSE[asked.method], modes=modes, rtol=rtol)


def why_without_modes(asked: GeodesicOptions, solver: Solver, n: int) -> str:
    """Return why a solver that may choose on n points leaves the modes alone; "" if it does not."""
    if not (asked.solver or asked.spectrum) or not isinstance(solver, WithinMemory):
        return ""
    chosen, reason = solver.choose(n)
    return f"not needed by the direct solver: {reason}" if isinstance(chosen, Direct) else ""


def coarse_spectrum(asked: GeodesicOptions, laplacian: Laplacian, modes: int) -> Spectrum | None:
    """Return the modes that were asked for, with those of eigenvalue 0; None if none were."""
    if asked.spectrum:
        spectrum = Spectrum.load(asked.spectrum)
        return spectrum if asked.k is None else spectrum.truncate(min(asked.k, spectrum.k))
    if not asked.solver:
        return None
    k = min(modes + laplacian.kernel_dimension, laplacian.n)
    return solve(laplacian, k, asked.solver, asked)


def check_named(asked: GeodesicOptions) -> int:
    """Refuse what needs no geometry to be seen wrong; return how many farthest points to add."""
    check_count("--farthest", asked.farthest, low=0)
    if asked.file != DEMO:
        if not (asked.source or asked.at or asked.face or asked.farthest):
            raise InvalidInputError(
                "distances need at least one source",
                advice="name some by --source, --at, --face or --farthest",
            )
        sampled = asked.cloud is not None and (asked.source or asked.face)
        if sampled or ((asked.repair or asked.largest) and asked.face):
            raise InvalidInputError(
                "--source and --face number the points and faces of the file, which --cloud"
                " changes, and --repair and --largest the faces",
                advice="name places by --at instead",
            )
    for face, *_ in asked.face:
        if not face.is_integer():
            raise InvalidInputError("--face", "begin with the number of a face", f"{face:g}")
    return asked.farthest or int(not (asked.source or asked.at or asked.face))


def named_sources(asked: GeodesicOptions, geometry: Geometry, kept: Numbering) -> list[Source]:
    """Return the points that --source, --at and --face name.

    `kept` knows the points of the file, where some were left out.
    """
    check_count("--farthest", asked.farthest, low=0, high=geometry.n)
    named = check_indices("--source", np.array(asked.source, dtype=object), kept.n)
    points = kept.number(named)
    if (points < 0).any():
        lost = ", ".join(map(str, named[points < 0]))
        raise InvalidInputError(
            "--source",
            "name points that --repair and --largest keep",
            f"{lost}, which no face has, or none of that part",
            advice="name others, or places by --at",
        )
    found: list[Source] = points.tolist()
    found += [nearest_source(geometry, place) for place in asked.at]
    return found + [FacePoint(int(face), (a, b, c)) for face, a, b, c in asked.face]


def with_farthest(
    sources: list[Source], count: int, distance: Callable[[list[Source]], Floats]
) -> list[Source]:
    """Add `count` points, each the farthest from all before it; in a part not reached, its first.

    Without sources the first is the farthest from point 0, which is none itself.
    """
    if count and not sources:
        first = int(np.argmax(distance([0])))
        return with_farthest([first], count - 1, distance)
    chosen, latest = list(sources), list(sources)
    nearest: Floats = np.array(np.inf)
    for _ in range(count):
        nearest = np.minimum(nearest, distance(latest))
        latest = [int(np.argmax(nearest))]
        chosen += latest
    return chosen
