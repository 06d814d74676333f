"""`Panel`: a function with its colours and lines, and the pictures of many of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Bytes, Floats
from spectra_kit._core.validate import check_count, real_array
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import Geometry
from spectra_kit.show.colours import diverging_colours, sequential_colours
from spectra_kit.show.contours import level_lines, triangles_of
from spectra_kit.show.pen import short
from spectra_kit.show.render import Scene, render
from spectra_kit.show.table import Bar

LINE_WIDTH = 0.75  # points (1/72 inch)
_PERCENTILE = 99.0  # a lone spike must not bleach the rest
_CONSTANT = 1e-12  # of the values: smaller differences are rounding


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Panel:
    """One picture: a function on the geometry, its colour limits, and two lines of text.

    Attributes
    ----------
    values : ndarray of shape (n,)
        One value per point.
    limit : float
        The colours run from -limit to +limit, white at zero; or from `low`, if it is given. Where
        that is the limit, too, there is one value, and one colour.
    lines : tuple of str
        Set above the picture.
    low : float, optional
        Colours that begin here are sequential, dark to light.
    levels : tuple of float
        Values along which a line is drawn.
    """

    values: Floats
    limit: float
    lines: tuple[str, ...] = ()
    low: float | None = None
    levels: tuple[float, ...] = ()

    def scaled(self) -> Floats:
        """The values, -1 at one end of the colours and 1 at the other."""
        low = -self.limit if self.low is None else self.low
        if low == self.limit:
            return np.zeros_like(self.values)
        return 2 * (self.values - low) / (self.limit - low) - 1

    def ends(self) -> tuple[str, str]:
        """The two ends of the colours in words; the first is empty where they are one value."""
        if self.low is None:
            return _signed(-self.limit, 2), "+" + _signed(self.limit, 2)
        if self.low == self.limit:
            return "", _signed(self.limit, 2)
        size = max(abs(self.low), abs(self.limit)) / (self.limit - self.low)
        digits = 2 + int(np.ceil(np.log10(max(size / 10, 1.0))))  # enough to tell them apart
        return _signed(self.low, digits), _signed(self.limit, digits)

    def colours(self, count: int) -> Bytes:
        """Colours (count, 3) from one end to the other."""
        check_count("count", count, low=1, high=65_536)
        if self.low is None:
            return diverging_colours(np.linspace(-1.0, 1.0, count))
        ends = (0.5, 0.5) if self.low == self.limit else (0.0, 1.0)
        return sequential_colours(np.linspace(*ends, count))

    def bar(self) -> Bar:
        """Return the bar of its colours."""
        return Bar(colours=self.colours(512), ends=self.ends())


def symmetric_limit(*functions: Floats) -> float:
    """The limit of symmetric colours for all these functions together."""
    sizes = [np.abs(f) for f in functions]
    common = max(float(np.percentile(size, _PERCENTILE)) for size in sizes)
    return common or max(float(size.max()) for size in sizes) or 1.0


def sequential_limits(*functions: Floats) -> tuple[float, float]:
    """Both ends of sequential colours for all these functions together; equal for a constant."""
    for beyond in (100 - _PERCENTILE, 0.0):  # where hardly any differ, those few are the picture
        low = min(float(np.percentile(f, beyond)) for f in functions)
        high = max(float(np.percentile(f, 100 - beyond)) for f in functions)
        if high - low > _CONSTANT * max(abs(low), abs(high)):
            return low, high
    return high, high


def draw_panels(
    geometry: Geometry, panels: Sequence[Panel], *, rotation: Floats, width: int, dpi: int
) -> list[Bytes]:
    """Return the pictures of panels, `width` pixels each, seen from one side."""
    for panel in panels:
        if real_array("values", panel.values).shape != (geometry.n,):
            raise InvalidInputError("values", f"have shape ({geometry.n},)", np.shape(panel.values))
    triangles = triangles_of(geometry) if any(panel.levels for panel in panels) else None
    scenes = []
    for _, group in groupby(panels, key=lambda panel: panel.low is None):  # of one kind of colours
        some, lines = list(group), None
        if triangles is not None:
            lines = [level_lines(geometry.points, triangles, p.values, p.levels) for p in some]
        scene = Scene(
            geometry=geometry,
            functions=[panel.scaled() for panel in some],
            rotation=rotation,
            width=width,
            colours=some[0].colours(256),
            lines=lines,
            line_width=LINE_WIDTH * dpi / 72,
        )
        scenes.append(scene)
    return [picture for drawn in render(scenes) for picture in drawn]


def _signed(value: float, digits: int) -> str:
    text = short(value) if digits == 2 else f"{value:.{digits}g}"
    return text.replace("-", "\N{MINUS SIGN}", 1) if value < 0 else text
