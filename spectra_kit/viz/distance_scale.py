"""Colours of distances: light to dark, crossed by evenly spaced lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spectra_kit._types import Bytes, Floats
from spectra_kit._validate import check_positive
from spectra_kit.errors import InvalidInputError
from spectra_kit.viz.colours import UNKNOWN, oklab_to_srgb

LINE = (45, 28, 58)
MARK = (24, 24, 40)
EVERY = 5  # so many lines make a thicker one

# From near to far, evenly in Oklab: lightness falls, hue (degrees) turns from yellow to violet.
_LIGHTNESS, _HUE, _CHROMA = (0.95, 0.56), (100.0, -75.0), (0.10, 0.13)
_LINES, _MOST = 28, 200  # about so many where no spacing is given, and never more
_THIN, _THICK = 0.9, 1.8  # of a line, in points (1/72 inch) on the page, seen face on
_INK = 0.85  # how much a line covers
_SHADE = 0.8  # of every other band, where there are no lines
_TABLE = 4000  # colours that VTK looks up for each pixel; it takes 4094 at most
_PLAIN = 16  # of them for what was not reached, and as many for the marks


@dataclass(frozen=True, eq=False)
class Scale:
    """How distances become colours.

    Attributes
    ----------
    limit : float
        The largest distance.
    spacing : float
        Between two lines, or of a band.
    lines : bool
        Lines, or bands of two shades.
    table : ndarray of shape (c, 3), uint8
        Colours of values from -1 to 1, as `values` makes them of distances.
    """

    limit: float
    spacing: float
    lines: bool
    table: Bytes

    @property
    def mark(self) -> float:
        """The value that has the colour of marks."""
        return 3 * _PLAIN / _TABLE - 1

    @property
    def ramp(self) -> Bytes:
        """The colours of distances alone, from zero to the limit."""
        return self.table[2 * _PLAIN :]

    def values(self, distance: Floats) -> Floats:
        """Return where in the table (-1 to 1) distances (n,) lie; infinity is grey."""
        start = 2 * _PLAIN / _TABLE
        scaled = start + (1 - start) * np.clip(distance / self.limit, 0.0, 1.0)
        return np.where(np.isfinite(distance), 2 * scaled - 1, -1.0)


def distance_scale(
    distance: Floats,
    *,
    inch: float,
    dpi: int = 200,
    spacing: float | None = None,
    lines: bool = True,
) -> Scale:
    """Choose the colours of distances (n,); an `inch` of the page is so long on the surface."""
    limit = float(distance[np.isfinite(distance)].max(initial=0.0)) or 1.0
    if spacing is None:
        spacing = round_number(limit / _LINES)
    elif limit / check_positive("spacing", spacing) > _MOST:
        raise InvalidInputError(
            f"`spacing` must be at least {limit / _MOST:.3g}, to make no more than {_MOST} lines,"
            f" got {spacing:.3g}"
        )
    n = _TABLE - 2 * _PLAIN
    at = (np.arange(n) + 0.5) / n * limit
    ramp = _colours(at / limit)
    if lines:
        ink = _INK * _coverage(at, limit / n, spacing, inch, inch / dpi)[:, None]
        ramp = (1 - ink) * ramp + ink * np.array(LINE)
    else:
        ramp = ramp * np.where(np.floor(at / spacing) % 2, _SHADE, 1.0)[:, None]
    plain = np.repeat([UNKNOWN, MARK], _PLAIN, axis=0)
    table = np.round(np.vstack([plain, ramp])).astype(np.uint8)
    return Scale(limit=limit, spacing=spacing, lines=lines, table=table)


def distance_colours(distance: Floats) -> Bytes:
    """Return the colours (n, 3) of distances (n,) without lines; grey where infinite."""
    limit = float(distance[np.isfinite(distance)].max(initial=0.0)) or 1.0
    colours = np.round(_colours(np.clip(distance / limit, 0.0, 1.0))).astype(np.uint8)
    colours[np.isinf(distance)] = UNKNOWN
    return colours


def round_number(value: float) -> float:
    """Return the nearest of 1, 2, 2.5 and 5 times a power of ten, by ratio."""
    steps = np.array([1.0, 2.0, 2.5, 5.0, 10.0]) * 10.0 ** np.floor(np.log10(value))
    return float(steps[np.argmin(np.abs(np.log(steps / value)))])


def _colours(part: Floats) -> Floats:
    """Colours (c, 3), 0 to 255, of distances relative to the largest."""
    lightness, hue, chroma = (
        start + (end - start) * part for start, end in (_LIGHTNESS, np.deg2rad(_HUE), _CHROMA)
    )
    lab = np.column_stack([lightness, chroma * np.cos(hue), chroma * np.sin(hue)])
    return oklab_to_srgb(lab).astype(np.float64)


def _coverage(at: Floats, step: float, spacing: float, inch: float, pixel: float) -> Floats:
    """How much of each distance a line covers; all are lengths on the surface."""
    number = np.rint(at / spacing)
    width = np.where(number % EVERY, _THIN, _THICK) * inch / 72
    # Never more than a part of what lies between, nor less than the table can show.
    width = np.clip(width, min(2 * step, 0.35 * spacing), 0.35 * spacing)
    edge = np.clip(pixel, step, np.maximum(width, step))  # soft over a pixel: no jags
    away = np.abs(at - number * spacing)
    return np.where(number > 0, np.clip(0.5 + (width / 2 - away) / edge, 0.0, 1.0), 0.0)
