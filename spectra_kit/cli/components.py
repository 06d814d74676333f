"""`match --components`: which part of a source each of a target is, in the folder of a match."""

from __future__ import annotations

import csv
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import spectra_kit as sk
from spectra_kit.cli import tables
from spectra_kit.cli.inputs import Numbering
from spectra_kit.cli.match_result import MAP, PARTS, PICTURES, doubts_of, setting
from spectra_kit.cli.output import tell_folder
from spectra_kit.cli.progress import step
from spectra_kit.errors import InvalidInputError

if TYPE_CHECKING:
    from spectra_kit.cli.match import MatchOptions
    from spectra_kit.geometry import Geometry
    from spectra_kit.maps import ComponentMatch

_SHOWN = ("target", "points", "first", "source", "confidence")  # the reasons are warnings


def match_parts(
    asked: MatchOptions,
    shapes: Sequence[Geometry],
    there: Sequence[Numbering],
    files: Sequence[str],
    sides: Sequence[str],
    pictures: Sequence[str],
) -> None:
    """Match the parts, write the map, the table of parts, a report and a picture."""
    meshes = [mesh for mesh in shapes if isinstance(mesh, sk.TriangleMesh)]
    if len(meshes) < len(shapes):
        raise InvalidInputError("--components", "match a mesh to a mesh", "a point cloud")
    (one, other), start = meshes, time.perf_counter()
    with step("matching the parts"):
        found = sk.maps.match_components(one, other, mirrored=asked.mirrored, k=asked.k)
    rows, names = _rows(found, meshes, there), (asked.source, asked.target)
    covered = found.point_map >= 0
    quality: tables.Record = {
        "seconds": time.perf_counter() - start,
        "parts_with_a_partner": int((found.partner >= 0).sum()),
        "covered_points": int(covered.sum()),
        "parts": rows,
    }
    record = {
        "source": {"input": asked.source, **tables.geometry_record(one)},
        "target": {"input": asked.target, **tables.geometry_record(other)},
        "landmarks": 0,
        "match": quality,
    }

    def write(folder: Path) -> None:
        first = np.where(covered, there[0].first[found.point_map], -1)
        np.save(folder / MAP, there[1].spread(first, -1))
        with (folder / PARTS).open("w", newline="") as file:
            table = csv.DictWriter(file, rows[0])
            table.writeheader()
            table.writerows(rows)
        for name, mesh in zip(sides, meshes, strict=False):
            sk.write(mesh, folder / name)

    tell_folder(
        asked,
        asked.output,
        record,
        *map(tables.size, names, meshes),
        f"the parts: that of {names[0]} that each of {names[1]} is",
        tables.align([_SHOWN, *([_cell(row[name]) for name in _SHOWN] for row in rows)]),
        files=files,
        pictures=pictures,
        replacing=PICTURES,
        write=write,
        draw=lambda folder: sk.show.plot_correspondence(
            one,
            other,
            np.maximum(found.point_map, 0),
            path=folder / pictures[0],
            covered=covered,
            **setting(asked, one, other),
        ),
    )


def _rows(
    found: ComponentMatch, meshes: Sequence[sk.TriangleMesh], there: Sequence[Numbering]
) -> list[tables.Record]:
    """Return what is told of each part of the target, and by which points of files to know it."""
    parts = [sk.geometry.components(mesh) for mesh in meshes]
    first = [
        [int(side.first[part.vertex_index].min()) for part in own]
        for own, side in zip(parts, there, strict=True)
    ]
    tried = {j: match for (_, j), match in found.matches.items()}
    rows = list[tables.Record]()
    for j, partner in enumerate(found.partner.tolist()):
        i = partner if partner >= 0 else None
        rows.append(
            {
                "target": j,
                "points": parts[1][j].mesh.n,
                "first": first[1][j],
                "source": i,
                "source_points": None if i is None else parts[0][i].mesh.n,
                "source_first": None if i is None else first[0][i],
                "confidence": float(found.confidence[j]),
                "mirrored": None if i is None else tried[j].mirrored,
                "doubts": doubts_of(tried[j]) if j in tried else "",
            }
        )
    return rows


def _cell(value: object) -> str:
    return "none" if value is None else f"{value:.3g}" if isinstance(value, float) else f"{value}"
