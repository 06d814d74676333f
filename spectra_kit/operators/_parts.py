"""Parts of a point cloud that lie as near to each other as its own points do."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.warn import warn
from spectra_kit.errors import SplitSurfaceWarning
from spectra_kit.operators.laplacian import Laplacian

_FEW = 30  # neighbours on a plane: within three or four times their spacing
_NEAR = 2  # times as far
# Spread across to that along, of the points of a part no further from one than the next part: a
# line has none, and a third of a circle 0.08; half a disc has 0.28.
_LINE = 0.15
_SEEN = 1000  # points of a part that tell its shape near one of them


def warn_of_near_parts(laplacian: Laplacian, n_neighbors: int) -> None:
    """Say so where a cloud falls into parts that look like pieces or lines of one surface.

    The next part is no further than a few spacings of the points, or of the lines that they are on;
    or the part is a line itself, seen from as far as the next one.
    """
    if laplacian.n_components == 1:
        return
    points, labels = laplacian.points, laplacian.component_labels
    gaps = _gaps(points, labels)
    order = np.lexsort([gaps, labels])
    near = 0
    for part in np.split(order, np.cumsum(np.bincount(labels))[:-1]):
        offsets = points[part] - points[part[0]]  # that with the least gap comes first
        gap, distances = gaps[part[0]], np.linalg.norm(offsets, axis=1)
        offsets = offsets[np.argsort(distances)]
        distances.sort()
        few = _FEW
        while few < len(part) and _is_line(offsets[: few + 1]):
            few *= 2
        reach = _NEAR * distances[min(few, len(part) - 1)]
        near += gap <= reach or _is_line(offsets[distances <= gap])
    if near:
        some = "they lie" if near == laplacian.n_components else f"{near:,} of them lie"
        warn(
            f"the cloud falls into {laplacian.n_components:,} parts with an eigenvalue 0 each, and"
            f" {some} as near to the next as points or lines of one surface do to each other",
            SplitSurfaceWarning,
            advice=f"if they are one surface, raise `n_neighbors` above {n_neighbors}, or thin the"
            " points along their lines",
        )


def _is_line(offsets: Floats) -> bool:
    some = offsets[:: -(-len(offsets) // _SEEN)]
    spreads = np.linalg.svd(some - some.mean(axis=0), compute_uv=False) ** 2
    return bool(spreads[1:2].sum() <= _LINE * spreads[0])


def _gaps(points: Floats, labels: Ints) -> Floats:
    """Return how far the nearest point of another part is, (n,): the numbers differ in some bit."""
    gaps = np.full(len(points), np.inf)
    for bit in range(int(labels.max()).bit_length()):
        ones = (labels >> bit & 1).astype(bool)
        for here, there in ((ones, ~ones), (~ones, ones)):
            found = cKDTree(points[there]).query(points[here])[0]
            gaps[here] = np.minimum(gaps[here], found)
    return gaps
