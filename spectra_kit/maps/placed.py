"""`Placed`: where a surface is, without what its modes add."""

from __future__ import annotations

from dataclasses import dataclass

from spectra_kit._core.types import Floats
from spectra_kit._core.validate import Rebuilt
from spectra_kit.operators.oriented import OrientedTriangles


@dataclass(frozen=True, eq=False, kw_only=True)
class Placed(Rebuilt):
    """The geometry of a surface at unit area."""

    points: Floats  # (n, 3)
    mass: Floats  # (n,), of the spectrum
    oriented: OrientedTriangles  # which side is out
