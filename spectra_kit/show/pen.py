"""A pen that sets text, pictures and colour bars on a Matplotlib figure, measured in inches."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from spectra_kit._core.types import Bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_LINE = "#303036"  # as on geometries


class Pen:
    """Draws on a figure at inches from its top left corner."""

    def __init__(self, figure: Figure) -> None:
        self.figure, self.dpi = figure, figure.dpi
        self.width, self.height = (float(side) for side in figure.get_size_inches())

    def text(
        self,
        text: str,
        left: float,
        baseline: float,
        width: float,
        size: float,
        *,
        bold: bool = False,
        centred: bool = False,
        colour: str = "0.1",
    ) -> None:
        """Set one line, smaller where it would not fit `width`."""
        style = {"fontweight": "bold" if bold else "normal", "color": colour, "va": "baseline"}
        style["ha"] = "center" if centred else "left"
        at = left + width / 2 if centred else left
        self._set(text, at, baseline, width, fontsize=size, **style)

    def sideways(self, text: str, x: float, y: float, length: float) -> None:
        """Set a bold line that reads upwards, centred at (x, y)."""
        style = {"fontweight": "bold", "color": "0.1", "ha": "center", "va": "center"}
        self._set(text, x, y, length, fontsize=12, rotation=90, **style)

    def _set(self, text: str, x: float, y: float, room: float, **style: Any) -> None:
        """Set a text in this style, but smaller where it needs more room than there is."""
        at = x / self.width, 1 - y / self.height
        label = self.figure.text(*at, text, parse_math=False, **style)
        box = label.get_window_extent()
        needed = (box.height if label.get_rotation() else box.width) / self.dpi
        if needed > room:
            label.set_fontsize(float(label.get_fontsize()) * room / needed)

    def line(self, x: float, top: float, bottom: float, width: float) -> None:
        """Draw a dark upright line, so many points wide."""
        from matplotlib.lines import Line2D

        ends = [1 - top / self.height, 1 - bottom / self.height]
        self.figure.add_artist(
            Line2D([x / self.width] * 2, ends, color=_LINE, lw=width, solid_capstyle="butt")
        )

    def picture(self, picture: Bytes, left: float, top: float) -> None:
        """Place a picture (rows, columns, 3), pixel by pixel."""
        rows = round((self.height - top) * self.dpi) - len(picture)
        self.figure.figimage(picture, round(left * self.dpi), rows, origin="upper")

    def bar(
        self, strip: Bytes, ends: tuple[str, str], left: float, top: float, length: float
    ) -> None:
        """Draw a slim bar of these colours (c, 3), `ends` written beside it, within `length`."""
        slim, thick = min(1.1, 0.45 * length), 0.07
        start, room = left + (length - slim) / 2, (length - slim) / 2 - 0.06
        across = np.linspace(0, len(strip) - 1, max(round(slim * self.dpi), 2))
        row = strip[np.round(across).astype(int)]
        self.picture(np.tile(row, (max(round(thick * self.dpi), 1), 1, 1)), start, top)
        style = {"fontsize": 7.5, "color": "0.4", "va": "center_baseline"}
        self._set(ends[0], start - 0.06, top + thick / 2, room, ha="right", **style)
        self._set(ends[1], start + slim + 0.06, top + thick / 2, room, ha="left", **style)


def short(value: float) -> str:
    """Two digits, like 0.036 or 3.6e-5, 12 or 1.2e+4."""
    if value == 0:
        return "0"
    if 0.01 <= abs(value) < 1000:
        return f"{value:#.2g}" if abs(value) < 10 else f"{value:.0f}"
    digits, exponent = f"{value:.1e}".split("e")
    return f"{digits}e{int(exponent)}"
