"""Geodesic distances: numbers, a coloured mesh, a report, and pictures."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, cast

import numpy as np
from cyclopts import Parameter

import spectra_kit as sk
from spectra_kit._core.validate import check_count, check_positive, quantity
from spectra_kit.cli import options, solving, tables
from spectra_kit.cli.geodesic_compare import (
    clock_note,
    compare_solvers,
    comparison_record,
    comparison_table,
    number_of_modes,
)
from spectra_kit.cli.inputs import Numbering, load
from spectra_kit.cli.output import REPORT, check_folder, tell_folder
from spectra_kit.cli.progress import step
from spectra_kit.cli.words import stem
from spectra_kit.errors import InvalidInputError

if TYPE_CHECKING:
    from spectra_kit.geodesics import Direct, DistanceField, FacePoint, Iterative, WithinMemory
    from spectra_kit.geometry import Geometry

    Source = int | FacePoint
    Solver = WithinMemory | Direct | Iterative

_NUMBERS = ("distance.npy", "distance.ply", REPORT)
_PICTURES = ("field.png", "convergence.png")
_COARSE: dict[str, Literal["additive", "projected", "none"]] = {
    "iterative": "additive",
    "projected": "projected",
    "plain": "none",
}


@dataclass(frozen=True, kw_only=True)
class _Sources(options.Command, group="sources"):
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
class _Heat(options.Command, group="method"):
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
class GeodesicOptions(options.OneFile, options.Spared, _Sources, _Heat, options.FolderDrawing):
    """Measure distances along a surface, and draw them with isolines."""

    examples = (
        "geodesic bunny.obj --source 7",
        "geodesic bunny.obj --at 0.1 0.2 0.0 --farthest 3 -o far",
        f"geodesic {options.DEMO} --compare",
    )
    keys = (
        "input, kind, points, faces, operator, operator area, operator components, zero modes,"
        " fixed points, eigenvalue spacing, heat_boundary, sources, method, choice,"
        " time_coefficient, time_step, iterations, relative_residual, heat, seconds, spectrum,"
        " largest_distance, mean_distance, points_not_reached, spectrum_unused, comparison,"
        " written"
    )
    needs = ("geodesics", "show")

    k: options.Count | None = None
    """number of modes (default: 24 and those of eigenvalue 0; 96 with --compare)"""
    solver: options.SolverName | None = None
    """what solves for modes for the coarse space of the linear solver, which may do without
    (default: none)"""
    output: options.Output = Path("geodesic")
    """folder for the distances, the report and the pictures"""
    compare: bool = False
    """also solve by every solver, and draw and print how each converges"""
    spacing: float | None = None
    """between two isolines (default: 20 to 40 lines)"""


def geodesic_distances(asked: GeodesicOptions) -> None:
    """Measure distances, write them with a report and pictures into one folder."""
    from spectra_kit.geodesics.distance import exact_field
    from spectra_kit.geodesics.farthest import with_farthest

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
    check_folder(asked.output, _NUMBERS + pictures, _NUMBERS + _PICTURES, asked.inputs)

    geometry, kept = load(asked.file, asked)
    sources = named_sources(asked, geometry, kept)
    sk.geodesics.check_sources(sources or [0], geometry)
    with step(f"triangulating {geometry.n:,} points"):
        triangulation = sk.intrinsic_delaunay(geometry)
    modes = number_of_modes(asked, triangulation.laplacian, usual=sk.geodesics.Iterative().modes)
    solver = linear_solver(asked, modes)
    unused = why_without_modes(asked, solver, geometry.n)
    # Modes of a file cost nothing, and are checked.
    spectrum = None
    if asked.spectrum or not unused:
        spectrum = coarse_spectrum(asked, triangulation.laplacian, modes)
    with step("preparing the solver"):
        geodesics = sk.HeatGeodesics(
            triangulation,
            spectrum,
            solver=solver,
            time_coefficient=asked.time_coefficient,
            boundary=asked.heat_boundary,
        )
        geodesics.geometry = geometry  # whose triangles it may doubt

    def measure(some: "list[Source]") -> "DistanceField":
        exact = exact_field(geometry, some) if may_be_exact(asked) else None
        if exact is not None:
            return exact
        return geodesics.distance(sk.geodesics.check_sources(some, geometry))

    with step("looking for the farthest points"):
        sources = with_farthest(sources, farthest, lambda few: measure(few).distance)
    checked = sk.geodesics.check_sources(sources, geometry)
    with step(f"measuring the distance to {quantity(len(sources), 'source')}"):
        field = measure(sources)
    compared = compare_solvers(asked, geometry, triangulation, checked) if asked.compare else []
    in_file = [s if isinstance(s, sk.geodesics.FacePoint) else int(kept.first[s]) for s in sources]
    record = _record(asked, geometry, triangulation, in_file, spectrum, field)
    record["spectrum_unused"] = unused or None
    runs = [run for run, _ in compared]
    if compared:
        record["comparison"] = [comparison_record(*one) for one in compared]

    tell_folder(
        asked,
        asked.output,
        record,
        tables.headline(asked.file, geometry, triangulation.laplacian),
        tables.pairs(_facts(record)),
        *([comparison_table(record["comparison"])] if compared else []),
        files=_NUMBERS,
        pictures=pictures,
        replacing=_PICTURES,
        write=lambda folder: _write(folder, geometry, field, kept),
        draw=lambda folder: _draw(asked, folder, geometry, sources, field, runs),
    )


def _write(folder: Path, geometry: "Geometry", field: "DistanceField", kept: Numbering) -> None:
    from spectra_kit.geometry.formats import ply
    from spectra_kit.show.colours import distance_colours

    np.save(folder / _NUMBERS[0], kept.spread(field.distance, np.nan))
    shades = distance_colours(field.distance).T
    values = dict(zip(("red", "green", "blue"), shades, strict=True))
    values["quality"] = field.distance  # as MeshLab calls it
    ply.write(geometry, folder / _NUMBERS[1], values)


def _draw(
    asked: GeodesicOptions,
    folder: Path,
    geometry: "Geometry",
    sources: "list[Source]",
    field: "DistanceField",
    runs: "list[sk.show.SolverRun]",
) -> None:
    name, size = stem(asked.file), f"{geometry.n:,} points"
    method = "heat method" if field.heat else "exact distances"
    mesh = cast("sk.TriangleMesh", geometry)  # where there are points of faces
    faces = sk.geodesics.FacePoint
    places = [s.position(mesh) if isinstance(s, faces) else mesh.points[s] for s in sources]
    sk.show.plot_distance(
        geometry,
        field.distance,
        path=folder / _PICTURES[0],
        sources=np.array(places),
        spacing=asked.spacing,
        view=asked.view,
        page=sk.show.Page(name, f"{size} \N{MIDDLE DOT} {method}", asked.dpi),
    )
    if runs:
        heading = f"{name}: the Poisson step of the heat method, {size}"
        sk.show.plot_convergence(
            runs,
            path=folder / _PICTURES[1],
            rtol=asked.poisson_rtol,
            solve_name="Poisson step",
            page=sk.show.Page(heading, clock_note(), asked.dpi),
        )


def _record(
    asked: GeodesicOptions,
    geometry: "Geometry",
    triangulation: "sk.operators.IntrinsicTriangulation",
    sources: "list[Source]",
    spectrum: "sk.Spectrum | None",
    field: "DistanceField",
) -> tables.Record:
    """What the report says."""
    reached = field.distance[field.reached]
    return {
        "input": asked.file,
        **tables.geometry_record(geometry),
        **tables.operator_record(triangulation.laplacian),
        "heat_boundary": asked.heat_boundary,
        "sources": [
            vars(s) if isinstance(s, sk.geodesics.FacePoint) else {"point": s} for s in sources
        ],
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
    facts = {"sources": len(record["sources"]), "solver": record["choice"]}
    if record["heat"]:
        facts["time step"] = record["time_step"]
        facts["iterations"] = record["iterations"]
        facts["relative residual"] = f"{record['relative_residual']:.1e}"
    facts["seconds"] = tables.seconds(record["seconds"])
    if record["spectrum"]:
        facts["seconds of the spectrum"] = f"{record['spectrum']['seconds']:.2f}"
    if record["spectrum_unused"]:
        facts["spectrum"] = record["spectrum_unused"]
    facts["largest distance"] = record["largest_distance"]
    facts["mean distance"] = record["mean_distance"]
    facts["points not reached"] = f"{record['points_not_reached']:,}"
    return facts


def check_solver(asked: GeodesicOptions) -> None:
    """Refuse options of solvers that are not used, and solvers that lack what they need."""
    if asked.k is not None:
        check_count("-k", asked.k, low=1)
    if asked.spectrum:
        solving.refuse_solving(asked)
    elif asked.solver:
        solving.check_solvers(asked, asked.solver)
    elif not asked.compare:
        why = "without modes; choose what solves for them by --solver"
        options.refuse_given(asked, ("k", "rtol", "start", *options.NETWORK), why)
    if asked.method == "direct" and not asked.compare:
        options.refuse_given(
            asked, ["poisson_rtol"], "on a direct solver; choose another by --method"
        )
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


def linear_solver(asked: GeodesicOptions, modes: int) -> "Solver":
    """Return the solver that ``--method`` names, with so many modes at most."""
    rtol = asked.poisson_rtol
    if asked.method == "auto":
        return sk.geodesics.WithinMemory(modes=modes, rtol=rtol)
    if asked.method == "direct":
        return sk.geodesics.Direct()
    return sk.geodesics.Iterative(coarse=_COARSE[asked.method], modes=modes, rtol=rtol)


def why_without_modes(asked: GeodesicOptions, solver: "Solver", n: int) -> str:
    """Return why a solver that may choose on n points leaves the modes alone; "" if it does not."""
    if not (asked.solver or asked.spectrum) or not isinstance(solver, sk.geodesics.WithinMemory):
        return ""
    chosen, reason = solver.choose(n)
    direct = isinstance(chosen, sk.geodesics.Direct)
    return f"not needed by the direct solver: {reason}" if direct else ""


def coarse_spectrum(
    asked: GeodesicOptions, laplacian: "sk.Laplacian", modes: int
) -> "sk.Spectrum | None":
    """Return the modes that were asked for, with those of eigenvalue 0; None if none were."""
    if asked.spectrum:
        spectrum = sk.Spectrum.load(asked.spectrum)
        return spectrum if asked.k is None else spectrum.truncate(min(asked.k, spectrum.k))
    if not asked.solver:
        return None
    k = min(modes + laplacian.kernel_dimension, laplacian.n)
    return solving.solve(laplacian, k, asked.solver, asked)


def check_named(asked: GeodesicOptions) -> int:
    """Refuse what needs no geometry to be seen wrong; return how many farthest points to add."""
    check_count("--farthest", asked.farthest, low=0)
    if asked.file != options.DEMO:
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


def named_sources(asked: GeodesicOptions, geometry: "Geometry", kept: Numbering) -> "list[Source]":
    """Return the points that --source, --at and --face name.

    `kept` knows the points of the file, where some were left out.
    """
    check_count("--farthest", asked.farthest, low=0, high=geometry.n)
    found: list[Source] = [*kept.named("--source", asked.source)]
    found += [sk.geodesics.nearest_source(geometry, place) for place in asked.at]
    return found + [sk.geodesics.FacePoint(int(face), (a, b, c)) for face, a, b, c in asked.face]
