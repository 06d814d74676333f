"""Runs of methods by time and error, and the front of those that nothing beats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from spectra_kit._checked import checked
from spectra_kit._validate import check_positive
from spectra_kit.errors import InvalidInputError


@checked
@dataclass(frozen=True, kw_only=True)
class ParetoPoint:
    """One run of one method: its seconds, and its error.

    Attributes
    ----------
    name : str
        Written beside its dot.
    group : str
        Points of one group share a colour and a marker.
    seconds : float
        Positive.
    error : float
        Not negative.
    league : str, default ""
        Points of one league share a front: a processor, for example.

    Raises
    ------
    InvalidInputError
        If `seconds` is not positive, or `error` negative or not finite.
    """

    name: str
    group: str
    seconds: float
    error: float
    league: str = ""

    def __post_init__(self) -> None:
        check_positive("seconds", self.seconds)
        if not (np.isfinite(self.error) and self.error >= 0):
            raise InvalidInputError("error", "be finite and >= 0", repr(self.error))


@checked
def pareto_front(points: Sequence[ParetoPoint], *, floor: float = 0.0) -> list[ParetoPoint]:
    """Return the points that no other one beats in both time and error.

    Parameters
    ----------
    points : sequence of ParetoPoint
        In any order.
    floor : float, default 0
        Smaller errors count as this.

    Returns
    -------
    list of ParetoPoint
        Fastest first, each with less error than the one before.

    Examples
    --------
    >>> from spectra_kit.viz import ParetoPoint, pareto_front
    >>> runs = [
    ...     ParetoPoint(name=name, group="", seconds=seconds, error=error)
    ...     for name, seconds, error in (("a", 1, 0.1), ("b", 2, 0.2), ("c", 3, 0.01))
    ... ]
    >>> [run.name for run in pareto_front(runs)]
    ['a', 'c']
    """
    front: list[ParetoPoint] = []
    best = float("inf")
    for point in sorted(points, key=lambda p: (p.seconds, max(p.error, floor))):
        if max(point.error, floor) < best:
            best = max(point.error, floor)
            front.append(point)
    return front
