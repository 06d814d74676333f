"""Points that are known to correspond: where they put all others, and whether a map keeps them."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from spectra_kit._core.types import Bools, Floats, Ints
from spectra_kit.maps.lengths import edges_of, lengths_from, lengths_of
from spectra_kit.maps.nearest import nearest
from spectra_kit.maps.placed import Placed

Pairs = tuple[Ints, Ints]

ENOUGH = 3  # distances that tell a point from all others, but for symmetries
_SHORT = 0.05  # at unit area: distances count by their ratios, but for such short ones
_FAR = 3.0  # steps between neighbours beyond which a landmark is lost
_NEAR = 0.05  # the same at unit area, where steps are finer: bending is rigid below that length


def located(source: Placed, target: Placed, landmarks: Pairs) -> Ints:
    """Return the source point as far from all landmarks as each target point is, (n2,)."""
    here, there = (
        np.log(lengths_from(placed, points) + _SHORT).T
        for placed, points in zip((source, target), landmarks, strict=True)
    )
    return nearest(there, here)


def left_by(source: Placed, point_map: Ints, landmarks: Pairs) -> tuple[Floats, float]:
    """Return how far a map leads from each landmark, (l,), and how far is too far; at unit area."""
    here, there = landmarks
    places = source.points
    steps = lengths_of(places, edges_of(source.oriented))
    apart: Floats = np.linalg.norm(places[point_map[there]] - places[here], axis=1)
    return apart, max(_FAR * float(steps.mean()), _NEAR)


def kept(
    point_map: Ints, on_faces: sparse.csr_array | None, landmarks: Pairs, held: Bools
) -> tuple[Ints, sparse.csr_array | None]:
    """Return a map, to points and into triangles, that leads right to the landmarks it holds."""
    here, there = landmarks[0][held], landmarks[1][held]
    out = point_map.copy()
    out[there] = here
    if on_faces is not None:
        rows = on_faces.tolil()
        rows[there] = 0.0
        rows[there, here] = 1.0
        on_faces = sparse.csr_array(rows)
    return out, on_faces
