"""On a surface: shortest paths, curvature, and a smoother one."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from cyclopts import Parameter

import spectra_kit as sk
from spectra_kit._core.clock import Clock
from spectra_kit._core.validate import check_count, check_positive, quantity
from spectra_kit.cli import options, tables
from spectra_kit.cli.inputs import Numbering, load
from spectra_kit.cli.output import REPORT, check_folder, check_output, tell, tell_folder
from spectra_kit.cli.progress import step
from spectra_kit.errors import InvalidInputError

if TYPE_CHECKING:
    from spectra_kit.geodesics import FacePoint, SurfacePath
    from spectra_kit.geometry import Geometry

_CURVATURES = ("mean", "gaussian", "larger", "smaller")
_PATHS = "path,x,y,z,length,face,weight0,weight1,weight2"
_SHARES = (0.01, 0.25, 0.5, 0.75, 0.99)  # of points, below quantiles of curvature
_WRITTEN = (".obj", ".off", ".ply", ".stl", ".npz", ".xyz")

Indices = Annotated[tuple[int, ...], Parameter(consume_multiple=True, metavar="INDEX ...")]
Places = Annotated[tuple[tuple[float, float, float], ...], Parameter(metavar="X Y Z")]


@dataclass(frozen=True, kw_only=True)
class _Ends(options.Command, group="sources"):
    """Where paths begin and end."""

    source: Indices = ()
    """vertices of the file, counted from 0, where paths begin: each at the nearest"""
    at: Places = ()
    """begin at the point of the surface nearest to this place, too (may be repeated)"""
    to: Indices = ()
    """vertices where paths end, one each (default: the farthest)"""
    to_at: Places = ()
    """end at the point of the surface nearest to this place, too (may be repeated)"""


@dataclass(frozen=True, kw_only=True)
class PathOptions(options.OneFile, _Ends, options.FolderDrawing):
    """Find exact shortest paths along a mesh, and draw them."""

    examples = (
        "path cat.off --source 7 --to 90",
        "path bunny.obj --at 0.1 0.2 0.0 --to 5 6 7 -o ways",
        f"path {options.DEMO}",
    )
    keys = "input, kind, points, faces, seconds, paths, written"
    needs = ("geodesics", "show")
    numbers, pictures = ("paths.csv", "paths.obj", REPORT), ("paths.png",)

    output: options.Output = Path("paths")
    """folder for the paths, the report and the picture"""


@dataclass(frozen=True, kw_only=True)
class CurvatureOptions(options.OneFile, options.FolderDrawing):
    """Measure curvature at the points of a mesh or cloud, and draw it."""

    examples = (
        "curvature bunny.obj",
        "curvature scan.ply --scale 0.5 -o bends",
        f"curvature {options.DEMO}",
    )
    keys = "input, kind, points, faces, scale, seconds, points_not_known, quantiles, written"
    needs = ("operators", "show")
    numbers, pictures = ("curvature.csv", "curvature.ply", REPORT), ("curvature.png",)

    scale: float | None = None
    """distance within which neighbours count; more smooths (default: three spacings)"""
    output: options.Output = Path("curvature")
    """folder for the curvatures, the report and the picture"""


@dataclass(frozen=True, kw_only=True)
class SmoothOptions(options.OneFile):
    """Smooth a mesh or a cloud, and write it to a file."""

    examples = (
        "smooth scan.ply -o smooth.ply",
        "smooth scan.ply --steps 10 --time 0.02 -o smooth.ply",
        "smooth bunny.obj --modes 100 -o low.obj",
    )
    keys = "input, kind, points, faces, seconds, moved, output"
    needs = ("operators", "eigen")

    output: options.Output = Path("smooth.ply")
    """the file (.obj, .off, .ply, .stl, .npz, .xyz)"""
    time: float | None = None
    """how long it flows along its mean curvature, in length^2 (default: the mean edge squared)"""
    steps: int = 1
    """that this takes"""
    free_boundary: bool = False
    """let points on the boundary move too"""
    free_volume: bool = False
    """let what a closed mesh encloses shrink"""
    modes: int | None = None
    """rebuild it from so many of its lowest modes instead"""


def shortest_paths(asked: PathOptions) -> None:
    """Find paths, write them with a report and a picture into one folder."""
    if asked.file != options.DEMO and not (asked.source or asked.at):
        raise InvalidInputError(
            "paths need a point to begin at", advice="name it by --source or --at"
        )
    if asked.cloud is not None:
        raise InvalidInputError("--cloud", "be left out: paths run along faces", asked.cloud)
    mesh, kept = _loaded(asked)
    if not isinstance(mesh, sk.TriangleMesh):
        raise InvalidInputError(
            asked.file,
            "hold faces, along which paths run",
            "a point cloud",
            advice="spectra-kit geodesic measures distances on clouds",
        )
    begins: list[int | FacePoint] = [*kept.named("--source", asked.source)]
    begins += [sk.geodesics.nearest_source(mesh, place) for place in asked.at]
    ends: list[int | FacePoint] = [*kept.named("--to", asked.to)]
    ends += [sk.geodesics.nearest_source(mesh, place) for place in asked.to_at]
    clock = Clock()
    with step(f"searching {mesh.n:,} vertices"):
        paths = sk.geodesics.GeodesicPaths(mesh, begins or [0], targets=ends or None)
    if not ends:
        known = np.where(np.isfinite(paths.distances), paths.distances, -1.0)
        ends = [int(np.argmax(known))]
    with step(f"following {quantity(len(ends), 'path')}"):
        found = [paths.to(end) for end in ends]
    record, rows = list[tables.Record](), [("to", "length", "points")]
    for end, path in zip(ends, found, strict=True):
        point = int(kept.first[end]) if isinstance(end, int) else None
        to = vars(end) if point is None else {"point": point}
        name = f"face {to['face']}" if point is None else str(point)
        record.append({"to": to, "length": path.length, "points": len(path)})
        rows.append((name, f"{path.length:.6g}", str(len(path))))
    _tell(
        asked,
        mesh,
        {"seconds": clock.total, "paths": record},
        tables.align(rows),
        write=lambda folder: _write_paths(folder, found),
        draw=lambda path: sk.show.plot_curves(
            mesh,
            found,
            path=path,
            view=asked.view,
            page=tables.page(asked, mesh, quantity(len(found), "shortest path")),
        ),
    )


def curvature(asked: CurvatureOptions) -> None:
    """Measure curvature, write it with a report and a picture into one folder."""
    if asked.scale is not None:
        check_positive("--scale", asked.scale)
    geometry, kept = _loaded(asked)
    clock = Clock()
    with step(f"fitting quadrics at {geometry.n:,} points"):
        bent = sk.operators.curvature(geometry, scale=asked.scale)
    columns = np.column_stack([bent.mean, bent.gaussian, bent.principal])
    known, scale = ~np.isnan(bent.mean), float(np.median(bent.scale))
    quantiles = dict(zip(_CURVATURES, np.quantile(columns[known], _SHARES, axis=0).T, strict=True))
    record = {
        "scale": scale,
        "seconds": clock.total,
        "points_not_known": int((~known).sum()),
        "quantiles": {"shares": _SHARES} | quantiles,
    }
    rows = [("curvature", *(f"{share:.0%}" for share in _SHARES))]
    rows += [(name, *(f"{value:.4g}" for value in row)) for name, row in quantiles.items()]
    _tell(
        asked,
        geometry,
        record,
        tables.align(rows, left=1),
        write=lambda folder: _write_curvature(folder, geometry, columns, kept),
        draw=lambda path: sk.show.plot_fields(
            geometry,
            {
                "mean curvature, 1/length": np.nan_to_num(bent.mean),
                "Gaussian curvature, 1/length²": np.nan_to_num(bent.gaussian),
            },
            path=path,
            symmetric=True,
            view=asked.view,
            page=tables.page(asked, geometry, f"neighbours within {scale:.3g}"),
        ),
    )


def smooth(asked: SmoothOptions) -> None:
    """Smooth a surface and write it."""
    check_output(asked.output, _WRITTEN, asked.inputs)
    if asked.modes is not None:
        check_count("--modes", asked.modes, low=1)
        why = "with --modes, which cuts instead"
        options.refuse_given(asked, ("time", "steps", "free_boundary", "free_volume"), why)
    geometry: Any = load(asked.file, asked)[0]
    clock = Clock()
    with step(f"smoothing {geometry.n:,} points"):
        if asked.modes is not None:
            found = sk.eigen.low_pass(geometry, sk.spectrum(geometry, asked.modes))
        else:
            found = sk.operators.smooth(
                geometry,
                time=asked.time,
                steps=asked.steps,
                boundary="free" if asked.free_boundary else "held",
                volume="free" if asked.free_volume else "kept",
            )
    with step(f"writing {asked.output}"):
        sk.write(found, asked.output)
    moved = np.linalg.norm(found.points - geometry.points, axis=1)
    mean, most = float(moved.mean()), float(moved.max())
    record = {
        "input": asked.file,
        **tables.geometry_record(geometry),
        "seconds": clock.total,
        "moved": {"mean": mean, "most": most},
        "output": asked.output,
    }
    facts = {"points moved in the mean": mean, "and at most": most, "written": asked.output}
    tell(asked, record, tables.size(asked.file, geometry), tables.pairs(facts))


def _loaded(asked: PathOptions | CurvatureOptions) -> "tuple[Geometry, Numbering]":
    """Check what is written, and load the input."""
    pictures = () if asked.no_pictures else asked.pictures
    known = asked.numbers + asked.pictures
    check_folder(asked.output, asked.numbers + pictures, known, asked.inputs)
    return load(asked.file, asked)


def _tell(
    asked: PathOptions | CurvatureOptions,
    geometry: "Geometry",
    record: tables.Record,
    table: str,
    *,
    write: Callable[[Path], object],
    draw: Callable[[Path], object],
) -> None:
    tell_folder(
        asked,
        asked.output,
        {"input": asked.file, **tables.geometry_record(geometry), **record},
        tables.size(asked.file, geometry),
        table,
        files=asked.numbers,
        pictures=() if asked.no_pictures else asked.pictures,
        replacing=asked.pictures,
        write=write,
        draw=lambda folder: draw(folder / asked.pictures[0]),
    )


def _write_paths(folder: Path, paths: "list[SurfacePath]") -> None:
    rows, lines, first = [], [], 1
    for i, path in enumerate(paths):
        columns = (path.points, path.lengths[:, None], path.faces[:, None], path.barycentric)
        rows.append(np.column_stack([np.full(len(path), i), *columns]))
        lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in path.points.tolist()]
        lines.append(" ".join(["l", *map(str, range(first, first + len(path)))]))
        first += len(path)
    forms = ["%d", *["%.17g"] * 4, "%d", *["%.17g"] * 3]
    np.savetxt(folder / "paths.csv", np.concatenate(rows), forms, ",", header=_PATHS, comments="")
    (folder / "paths.obj").write_text("\n".join([*lines, ""]))


def _write_curvature(
    folder: Path, geometry: "Geometry", columns: "np.ndarray", kept: Numbering
) -> None:
    from spectra_kit.geometry.formats import ply

    whole = np.column_stack([kept.spread(column, np.nan) for column in columns.T])
    head = ",".join(_CURVATURES)
    np.savetxt(folder / "curvature.csv", whole, "%.17g", ",", header=head, comments="")
    ply.write(geometry, folder / "curvature.ply", {"quality": np.ascontiguousarray(columns[:, 0])})
