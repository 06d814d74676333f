"""What can be asked for of geodesic distances."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from spectra_kit.cli.options import grouped
from spectra_kit.cli.outputs import FILLED, Output


@grouped("sources", "the distance is to the nearest of them all; the demo has one by default")
@dataclass(frozen=True, kw_only=True)
class Sources:
    """Where distances begin."""

    source: Annotated[tuple[int, ...], Parameter(consume_multiple=True, metavar="INDEX ...")] = ()
    """points of the file, counted from 0"""
    at: Annotated[tuple[tuple[float, float, float], ...], Parameter(metavar="X Y Z")] = ()
    """the point of the surface nearest to this place (may be repeated)"""
    face: Annotated[
        tuple[tuple[float, float, float, float], ...], Parameter(metavar="F B0 B1 B2")
    ] = ()
    """a point of a face, by its barycentric coordinates (may be repeated)"""
    farthest: int = 0
    """add N points, each the farthest from all sources before it (the first, where there are none,
    from point 0)"""


@grouped("method")
@dataclass(frozen=True, kw_only=True)
class Heat:
    """How the heat method works."""

    method: Literal["auto", "direct", "iterative", "projected", "plain"] = "auto"
    """of the linear systems: direct, by a factor; or by conjugate gradients with incomplete
    Cholesky: plain, or with a coarse space of modes added (iterative) or projected out (projected)
    (default: auto, whichever should be quicker)"""
    poisson_rtol: float = 1e-8
    """relative residual at which iterations stop"""
    time_coefficient: float = 1.0
    """the heat diffuses for X squared typical edge lengths; more is smoother"""
    heat_boundary: Literal["neumann", "dirichlet", "average"] = "neumann"
    """what heat does at a boundary: neumann, stay; dirichlet, leave; average, the mean of both"""


@grouped("output", FILLED)
@dataclass(frozen=True, kw_only=True)
class GeodesicOutput:
    """The folder that ``geodesic`` fills, and with what."""

    output: Output = Path("geodesic")
    """folder for the distances, the report and the pictures"""
    compare: bool = False
    """also solve by every solver, and draw and print how each converges"""
    spacing: float | None = None
    """between two isolines (default: 20 to 40 lines)"""
