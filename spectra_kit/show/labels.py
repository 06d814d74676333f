"""Names beside the dots of a diagram, that stay apart."""

from __future__ import annotations

import numpy as np

from spectra_kit._core.types import Floats

# Right and left first: read more easily than above and below.
_ANGLES = np.deg2rad([0, 180, 20, -20, 160, 200, 40, -40, 140, 220, 90, -90, 65, -65, 115, 245])
_GAPS = (6.0, 10.0, 16.0, 26.0, 40.0, 60.0)  # between a dot and its name, in points
_ROUNDS = 8  # each name is put again where the others leave most room
_OVERLAP, _COVERED, _CROSSED, _OUTSIDE = 40.0, 60.0, 8.0, 1e4  # costs, of one point of gap 1


def place_labels(anchors: Floats, sizes: Floats, room: Floats, obstacles: Floats) -> Floats:
    """Return the lower left corner (l, 2) of each label near its anchor, all in points (1/72 inch).

    Labels of `sizes` (l, 2) stay inside the corners of `room` (2, 2); they overlap each other, an
    anchor, or points of `obstacles` (o, 2) only where there is no other place.
    """
    candidates = _candidates(anchors, sizes)  # (l, c, 2)
    ends = candidates + sizes[:, None]
    cost = np.tile(np.repeat(_GAPS, len(_ANGLES)), (len(anchors), 1))
    cost += 0.05 * np.tile(np.arange(len(_ANGLES)), len(_GAPS))  # the order above, when in doubt
    cost += _OUTSIDE * ((candidates < room[0]) | (ends > room[1])).any(axis=2)
    cost += _COVERED * _inside(anchors, candidates - 3, ends + 3)
    cost += _CROSSED * _inside(obstacles, candidates, ends)
    chosen = cost.argmin(axis=1)
    for _ in range(_ROUNDS):
        before = chosen.copy()
        for i in range(len(anchors)):
            others = np.delete(np.arange(len(anchors)), i)
            low, high = candidates[others, chosen[others]], ends[others, chosen[others]]
            common = np.minimum(ends[i][:, None], high + 2) - np.maximum(
                candidates[i][:, None], low - 2
            )
            overlap = np.prod(np.clip(common, 0.0, None), axis=2).sum(axis=1)
            chosen[i] = (cost[i] + _OVERLAP * overlap).argmin()
        if (chosen == before).all():
            break
    return np.asarray(candidates[np.arange(len(anchors)), chosen])


def _candidates(anchors: Floats, sizes: Floats) -> Floats:
    """Lower left corners of all places for each label, near ones first: (l, c, 2)."""
    towards = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])
    # The edge of the label, not its centre, keeps the gap: steep directions centre it.
    lean = np.clip(1.6 * towards, -1.0, 1.0)
    steps = np.concatenate([gap * towards for gap in _GAPS])
    leans = np.tile(lean, (len(_GAPS), 1))
    centres = anchors[:, None] + steps + leans * sizes[:, None] / 2
    return np.asarray(centres - sizes[:, None] / 2)


def _inside(points: Floats, low: Floats, high: Floats) -> Floats:
    """How many points each box holds: (l, c)."""
    at = points[:, None, None]
    return np.asarray(((at > low) & (at < high)).all(axis=3).sum(axis=0), dtype=np.float64)
