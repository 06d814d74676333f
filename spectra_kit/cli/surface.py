"""Curvature of a surface, and a smoother one."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import spectra_kit as sk
from spectra_kit._core.clock import Clock
from spectra_kit._core.validate import check_count, check_positive
from spectra_kit.cli import options, tables
from spectra_kit.cli.inputs import Numbering, load
from spectra_kit.cli.output import REPORT, check_folder, check_output, tell, tell_folder
from spectra_kit.cli.progress import step

if TYPE_CHECKING:
    from spectra_kit.geometry import Geometry

_NUMBERS, _PICTURES = ("curvature.csv", "curvature.ply", REPORT), ("curvature.png",)
_COLUMNS = ("mean", "gaussian", "larger", "smaller")
_WRITTEN = (".obj", ".off", ".ply", ".stl", ".npz", ".xyz")


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


def curvature(asked: CurvatureOptions) -> None:
    """Measure curvature, write it with a report and a picture into one folder."""
    if asked.scale is not None:
        check_positive("--scale", asked.scale)
    pictures = () if asked.no_pictures else _PICTURES
    check_folder(asked.output, _NUMBERS + pictures, _NUMBERS + _PICTURES, asked.inputs)
    geometry, kept = load(asked.file, asked)
    clock = Clock()
    with step(f"fitting quadrics at {geometry.n:,} points"):
        bent = sk.operators.curvature(geometry, scale=asked.scale)
    columns = np.column_stack([bent.mean, bent.gaussian, bent.principal])
    known = ~np.isnan(bent.mean)
    shares = (0.01, 0.25, 0.5, 0.75, 0.99)
    quantiles = np.quantile(columns[known], shares, axis=0).T
    record = {
        "input": asked.file,
        **tables.geometry_record(geometry),
        "scale": float(np.median(bent.scale)),
        "seconds": clock.total,
        "points_not_known": int((~known).sum()),
        "quantiles": {"shares": shares} | dict(zip(_COLUMNS, quantiles, strict=True)),
    }
    rows = [("curvature", *(f"{share:.0%}" for share in shares))]
    rows += [
        (name, *(f"{value:.4g}" for value in row))
        for name, row in zip(_COLUMNS, quantiles, strict=True)
    ]
    tell_folder(
        asked,
        asked.output,
        record,
        tables.size(asked.file, geometry),
        tables.align(rows, left=1),
        files=_NUMBERS,
        pictures=pictures,
        replacing=_PICTURES,
        write=lambda folder: _write(folder, geometry, columns, kept),
        draw=lambda folder: _draw(asked, folder, geometry, bent),
    )


def _write(folder: Path, geometry: "Geometry", columns: "np.ndarray", kept: Numbering) -> None:
    from spectra_kit.geometry.formats import ply

    whole = np.column_stack([kept.spread(column, np.nan) for column in columns.T])
    np.savetxt(folder / _NUMBERS[0], whole, "%.17g", ",", header=",".join(_COLUMNS), comments="")
    ply.write(geometry, folder / _NUMBERS[1], {"quality": np.ascontiguousarray(columns[:, 0])})


def _draw(
    asked: CurvatureOptions, folder: Path, geometry: "Geometry", bent: "sk.operators.Curvature"
) -> None:
    fields = {
        "mean curvature, 1/length": np.nan_to_num(bent.mean),
        "Gaussian curvature, 1/length²": np.nan_to_num(bent.gaussian),
    }
    sk.show.plot_fields(
        geometry,
        fields,
        path=folder / _PICTURES[0],
        symmetric=True,
        view=asked.view,
        page=tables.page(asked, geometry, f"neighbours within {np.median(bent.scale):.3g}"),
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
    record = {
        "input": asked.file,
        **tables.geometry_record(geometry),
        "seconds": clock.total,
        "moved": {"mean": float(moved.mean()), "most": float(moved.max())},
        "output": asked.output,
    }
    facts = {
        "points moved in the mean": float(moved.mean()),
        "and at most": float(moved.max()),
        "written": asked.output,
    }
    tell(asked, record, tables.size(asked.file, geometry), tables.pairs(facts))
