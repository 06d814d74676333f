"""Whether confidences can be believed: of maps that are 70 % sure, 70 % should be right."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.types import Bools, Floats, Ints
from spectra_kit.errors import InvalidInputError
from studies import figures

#: Maps with less confidence are doubted.
DOUBT = 0.5


@dataclass(frozen=True, eq=False)
class Reliability:
    """Maps by their confidence, in bins of one width; NaN where a bin is empty."""

    edges: Floats  #: (b + 1,) of the bins, from 0 to 1.
    confidence: Floats  #: (b,) its mean.
    right: Floats  #: (b,) share of maps that are right.
    count: Ints  #: (b,) of maps.

    @property
    def error(self) -> float:
        """Expected calibration error: the mean of ``|right - confidence|`` over all maps."""
        gaps = np.nan_to_num(np.abs(self.right - self.confidence))
        return float(self.count @ gaps / self.count.sum())


def reliability(confidences: ArrayLike, right: ArrayLike, *, bins: int = 10) -> Reliability:
    """Sort maps, whose confidences are in [0, 1], into bins.

    The diagram of Guo et al., *On Calibration of Modern Neural Networks*, ICML 2017, section 2.
    """
    values, fine = _checked(confidences, right)
    edges = np.linspace(0, 1, bins + 1)
    which = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, bins - 1)
    count = np.bincount(which, minlength=bins)

    def mean(of: Floats) -> Floats:
        sums = np.bincount(which, of, minlength=bins)
        means: Floats = np.divide(sums, count, out=np.full(bins, np.nan), where=count > 0)
        return means

    return Reliability(edges, mean(values), mean(fine.astype(np.float64)), count)


def doubted_shares(confidences: ArrayLike, right: ArrayLike) -> tuple[float, float]:
    """Return which share of the wrong maps, and of the right ones, is doubted; NaN of none."""
    values, fine = _checked(confidences, right)

    def share(chosen: Bools) -> float:
        return float(np.mean(values[chosen] < DOUBT)) if chosen.any() else math.nan

    return share(~fine), share(fine)


def draw_calibration(
    path: Path, confidences: Sequence[float], right: Sequence[bool], *, title: str = ""
) -> Path:
    """Draw the share of right maps over confidence, with counts, and who is sure of what."""
    found = reliability(confidences, right)
    values, fine = _checked(confidences, right)
    figure, (shares, counts) = figures.panels(title, 2)
    shares.plot([0, 1], [0, 1], color="0.6", lw=0.8, label="calibrated")
    label = f"measured; expected calibration error {found.error:.2f}"
    shares.plot(found.confidence, found.right, label=label, **figures.dots(0))
    for x, y, n in zip(found.confidence, found.right, found.count, strict=True):
        if n:
            shares.annotate(f"{n}", (x, y), (5, -10), textcoords="offset points", fontsize=8)
    shares.set(xlabel="confidence", ylabel="share of right maps", xlim=(0, 1), ylim=(-0.03, 1.03))
    shares.legend(frameon=False, fontsize=8, loc="upper left")
    of_wrong, of_right = doubted_shares(confidences, right)
    for i, (name, chosen, share) in enumerate(
        (("wrong", ~fine, of_wrong), ("right", fine, of_right))
    ):
        doubted = "" if math.isnan(share) else f", {share:.0%} doubted"
        counts.hist(
            values[chosen],
            bins=found.edges.tolist(),
            label=f"{chosen.sum()} {name}{doubted}",
            color=figures.colour(1 - i),
            histtype="step",
            lw=1.6,
        )
    counts.axvline(DOUBT, color="0.6", lw=0.8, zorder=0)
    counts.set(xlabel="confidence", ylabel="maps", xlim=(0, 1))
    counts.legend(frameon=False, fontsize=8, loc="upper center")
    return figures.save(figure, path)


def _checked(confidences: ArrayLike, right: ArrayLike) -> tuple[Floats, Bools]:
    values, fine = np.asarray(confidences, dtype=np.float64), np.asarray(right, dtype=bool)
    if values.ndim != 1 or not len(values) or not ((values >= 0) & (values <= 1)).all():
        raise InvalidInputError("confidences", "be at least one number in [0, 1]", values.shape)
    if fine.shape != values.shape:
        raise InvalidInputError("right", f"have the shape {values.shape}", fine.shape)
    return values, fine
