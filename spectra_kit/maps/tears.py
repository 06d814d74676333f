"""How much of a map is torn: neighbours that it takes far apart."""

from __future__ import annotations

import numpy as np

from spectra_kit._core.types import Ints
from spectra_kit.maps.lengths import edges_of, lengths_of
from spectra_kit.maps.placed import Placed

_FAR = 6.0  # times their distance: surfaces of different kinds stretch less almost everywhere


def torn(source: Placed, target: Placed, point_map: Ints) -> float:
    """Return the share of a target's edges whose ends lead far apart, in [0, 1].

    Far is more than six times the length of the edge, or that of an average edge of the source if
    that is longer: no map to vertices can do better. Where two maps look alike in all modes, the
    wrong one is torn, as it leads from a leg to the tail and back.
    """
    edges = edges_of(target.oriented)
    long = np.maximum(lengths_of(target.points, edges), _spacing(source))
    return float((lengths_of(source.points, point_map[edges]) > _FAR * long).mean())


def _spacing(surface: Placed) -> float:
    return float(lengths_of(surface.points, edges_of(surface.oriented)).mean())
