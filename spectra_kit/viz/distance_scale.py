"""Colours of distances, and the values at which lines are drawn over them."""

from __future__ import annotations

import numpy as np

from spectra_kit._types import Bytes, Floats
from spectra_kit._validate import check_positive
from spectra_kit.errors import InvalidInputError
from spectra_kit.viz.colours import UNKNOWN, oklab_to_srgb

EVERY = 5  # so many lines make a thicker one

# From near to far, evenly in Oklab: lightness falls, hue (degrees) turns from yellow to violet.
_LIGHTNESS, _HUE, _CHROMA = (0.95, 0.56), (100.0, -75.0), (0.10, 0.13)
_LINES, _MOST = 28, 200  # about so many where no spacing is given, and never more
_CLOSEST = 0.12  # inches between two lines on the page, about, where no spacing is given


def largest(distance: Floats) -> float:
    """Return the largest distance that is finite, where the colours end."""
    return float(distance[np.isfinite(distance)].max(initial=0.0)) or 1.0


def distance_colours(distance: Floats) -> Bytes:
    """Return the colours (n, 3) of distances (n,): light to dark; grey where infinite."""
    part = np.clip(distance / largest(distance), 0.0, 1.0)
    lightness, hue, chroma = (
        start + (end - start) * part for start, end in (_LIGHTNESS, np.deg2rad(_HUE), _CHROMA)
    )
    lab = np.column_stack([lightness, chroma * np.cos(hue), chroma * np.sin(hue)])
    return np.where(
        np.isfinite(distance)[:, None], oklab_to_srgb(lab), np.array(UNKNOWN, dtype=np.uint8)
    )


def distance_levels(distance: Floats, spacing: float | None, *, inch: float) -> Floats:
    """Return the distances (l,) of the lines: multiples of a spacing, by default a round one.

    An `inch` of the page is so long on the surface.
    """
    limit = largest(distance)
    if spacing is None:
        spacing = round_number(max(limit / _LINES, _CLOSEST * inch))
    elif limit / check_positive("spacing", spacing) > _MOST:
        raise InvalidInputError(
            "spacing",
            f"be at least {limit / _MOST:.3g}, to make no more than {_MOST} lines",
            f"{spacing:.3g}",
        )
    return np.asarray(spacing * np.arange(1, int(limit / spacing) + 1))


def round_number(value: float) -> float:
    """Return the nearest of 1, 2, 2.5 and 5 times a power of ten, by ratio."""
    steps = np.array([1.0, 2.0, 2.5, 5.0, 10.0]) * 10.0 ** np.floor(np.log10(value))
    return float(steps[np.argmin(np.abs(np.log(steps / value)))])
