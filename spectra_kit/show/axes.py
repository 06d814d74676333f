"""Line colours, and tidy axes with few numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from spectra_kit.show.pen import short

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

Dashes = str | tuple[int, tuple[float, float]]

# Okabe and Ito's colours and two more: told apart with every kind of colour blindness. Dashes let
# curves that run into one show through each other.
LINE_COLOURS = (
    *("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"),
    *("#7B4FA3", "#000000", "#777777"),
)
DASHES: tuple[Dashes, ...] = ("-", "-", "--", "-.", (0, (2, 1.5)))


def line_style(i: int) -> tuple[str, Dashes]:
    """Colour and dashes of the curve number `i`."""
    return LINE_COLOURS[i % len(LINE_COLOURS)], DASHES[i % len(DASHES)]


def tidy(axes: Axes) -> None:
    """A light grid behind the data, and no frame to the right and above."""
    axes.grid(color="0.92", lw=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9)


def log_ticks(axis: Axis, *, plain: bool = False) -> None:
    """Number the powers of ten on a logarithmic axis; on a short or `plain` one others, too."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axis.get_view_interval()
    if plain or high < 200 * low:
        between = (1.2, 1.5, 3.0, 4.0, 7.0) if high < 4 * low else (3.0,) if high < 20 * low else ()
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0, *between)))
        axis.set_major_formatter(
            FuncFormatter(lambda value, _: f"{value:g}" if plain else short(value))
        )
    axis.set_minor_formatter(NullFormatter())
