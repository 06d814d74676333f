"""Shortest paths along a mesh: a table, lines for other programs, a report, and a picture."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from cyclopts import Parameter

import spectra_kit as sk
from spectra_kit._core.clock import Clock
from spectra_kit._core.validate import check_indices, quantity
from spectra_kit.cli import options, tables
from spectra_kit.cli.inputs import Numbering, load
from spectra_kit.cli.output import REPORT, check_folder, tell_folder
from spectra_kit.cli.progress import step
from spectra_kit.errors import InvalidInputError

if TYPE_CHECKING:
    from spectra_kit.geodesics import FacePoint, SurfacePath

_NUMBERS, _PICTURES = ("paths.csv", "paths.obj", REPORT), ("paths.png",)
_COLUMNS = "path,x,y,z,length,face,weight0,weight1,weight2"

Place = tuple[float, float, float]
Indices = Annotated[tuple[int, ...], Parameter(consume_multiple=True, metavar="INDEX ...")]
Places = Annotated[tuple[Place, ...], Parameter(metavar="X Y Z")]


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

    output: options.Output = Path("paths")
    """folder for the paths, the report and the picture"""


def shortest_paths(asked: PathOptions) -> None:
    """Find paths, write them with a report and a picture into one folder."""
    if asked.file != options.DEMO and not (asked.source or asked.at):
        raise InvalidInputError(
            "paths need a point to begin at", advice="name it by --source or --at"
        )
    if asked.cloud is not None:
        raise InvalidInputError("--cloud", "be left out: paths run along faces", asked.cloud)
    pictures = () if asked.no_pictures else _PICTURES
    check_folder(asked.output, _NUMBERS + pictures, _NUMBERS + _PICTURES, asked.inputs)
    mesh, kept = load(asked.file, asked)
    if not isinstance(mesh, sk.TriangleMesh):
        raise InvalidInputError(
            asked.file,
            "hold faces, along which paths run",
            "a point cloud",
            advice="spectra-kit geodesic measures distances on clouds",
        )
    begins = _points(mesh, kept, "source", asked.source, asked.at) or [0]
    ends = _points(mesh, kept, "to", asked.to, asked.to_at)
    clock = Clock()
    with step(f"searching {mesh.n:,} vertices"):
        paths = sk.geodesics.GeodesicPaths(mesh, begins, targets=ends or None)
    if not ends:
        known = np.where(np.isfinite(paths.distances), paths.distances, -1.0)
        ends = [int(np.argmax(known))]
    with step(f"following {quantity(len(ends), 'path')}"):
        found = [paths.to(end) for end in ends]
    face_point = sk.geodesics.FacePoint
    told = [
        vars(end) if isinstance(end, face_point) else {"point": int(kept.first[end])}
        for end in ends
    ]
    record = {
        "input": asked.file,
        **tables.geometry_record(mesh),
        "seconds": clock.total,
        "paths": [
            {"to": end, "length": path.length, "points": len(path)}
            for end, path in zip(told, found, strict=True)
        ],
    }
    rows = [("to", "length", "points")]
    rows += [
        (str(end.get("point", f"face {end.get('face')}")), f"{path.length:.6g}", str(len(path)))
        for end, path in zip(told, found, strict=True)
    ]
    tell_folder(
        asked,
        asked.output,
        record,
        tables.size(asked.file, mesh),
        tables.align(rows),
        files=_NUMBERS,
        pictures=pictures,
        replacing=_PICTURES,
        write=lambda folder: _write(folder, found),
        draw=lambda folder: sk.show.plot_curves(
            mesh,
            found,
            path=folder / _PICTURES[0],
            view=asked.view,
            page=tables.page(asked, mesh, f"{quantity(len(found), 'shortest path')}"),
        ),
    )


def _points(
    mesh: "sk.TriangleMesh", kept: Numbering, option: str, points: Indices, places: Places
) -> "list[int | FacePoint]":
    """Return the points of the mesh that an option names by number, and another by place."""
    named = check_indices(f"--{option}", np.array(points, dtype=object), kept.n)
    numbers = kept.number(named)
    if (numbers < 0).any():
        lost = ", ".join(map(str, named[numbers < 0]))
        raise InvalidInputError(
            f"--{option}",
            "name vertices that --repair and --largest keep",
            f"{lost}, which no face has, or none of that part",
            advice="name others, or places",
        )
    return [*numbers.tolist(), *(sk.geodesics.nearest_source(mesh, place) for place in places)]


def _write(folder: Path, paths: "list[SurfacePath]") -> None:
    rows, lines, first = [], [], 1
    for i, path in enumerate(paths):
        columns = (path.points, path.lengths[:, None], path.faces[:, None], path.barycentric)
        rows.append(np.column_stack([np.full(len(path), i), *columns]))
        lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in path.points.tolist()]
        lines.append(" ".join(["l", *map(str, range(first, first + len(path)))]))
        first += len(path)
    forms = ["%d", *["%.17g"] * 4, "%d", *["%.17g"] * 3]
    table = np.concatenate(rows)
    np.savetxt(folder / _NUMBERS[0], table, forms, ",", header=_COLUMNS, comments="")
    (folder / _NUMBERS[1]).write_text("\n".join([*lines, ""]))
