"""What pictures share: a page with its head, a canvas in inches, tables, and tidy axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Bytes
from spectra_kit._core.validate import check_count

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

MARGIN = 0.15  # inches
GAP, SIDE, HEAD, LINE, BAR = 0.18, 0.34, 0.34, 0.17, 0.26  # inches of a table
_TITLE, _SUBTITLE = 0.36, 0.26  # inches of the lines at the head
_COARSEST, _FINEST = 10, 2400  # pixels per inch
_INK = "#303036"  # of lines, as on geometries
Dashes = str | tuple[int, tuple[float, float]]

# Okabe and Ito's colours and two more: told apart with every kind of colour blindness. Dashes let
# curves that run into one show through each other.
LINE_COLOURS = (
    *("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"),
    *("#7B4FA3", "#000000", "#777777"),
)
DASHES: tuple[Dashes, ...] = ("-", "-", "--", "-.", (0, (2, 1.5)))


@checked
@dataclass(frozen=True)
class Page:
    """The head of a picture and its resolution.

    Attributes
    ----------
    title, subtitle : str, optional
        Two lines at the head.
    dpi : int, default 200
        Pixels per inch, 600 for print. In ``.pdf`` and ``.svg`` text and lines are vectors, and
        only pictures of geometries have so many.

    Examples
    --------
    >>> from spectra_kit.show import Page
    >>> Page("Modes of a bunny", dpi=600)
    Page(title='Modes of a bunny', subtitle='', dpi=600)
    """

    title: str = ""
    subtitle: str = ""
    dpi: int = 200

    def __post_init__(self) -> None:
        check_count("dpi", self.dpi, low=_COARSEST, high=_FINEST)

    @property
    def head(self) -> float:
        """Inches from the upper edge to what comes below the titles."""
        return MARGIN + _TITLE * bool(self.title) + _SUBTITLE * bool(self.subtitle)


def new_figure(page: Page, width: float, height: float) -> Figure:
    """Return a white page of so many inches with its titles set, to be filled by a `Canvas`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=page.dpi, facecolor="white")
    FigureCanvasAgg(figure)
    canvas, room = Canvas(figure), width - 2 * MARGIN
    if page.title:
        canvas.text(page.title, MARGIN, MARGIN + 0.2, room, 14, bold=True)
    if page.subtitle:
        below = MARGIN + _TITLE * bool(page.title)
        canvas.text(page.subtitle, MARGIN, below + 0.1, room, 9, colour="0.35")
    return figure


def new_diagram(page: Page, width: float, height: float) -> Figure:
    """Return a page with `height` inches below its titles, where Matplotlib arranges axes."""
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    figure = new_figure(page, width, height + page.head)
    below = 1 - (page.head - MARGIN) / (height + page.head)
    rect, pad = (0.0, 0.0, 1.0, below), 2 * MARGIN / 3
    figure.set_layout_engine(ConstrainedLayoutEngine(rect=rect, w_pad=pad, h_pad=pad))
    return figure


class Canvas:
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
        for _ in range(2):  # widths of small letters do not follow their size at once
            box = label.get_window_extent()
            needed = (box.height if label.get_rotation() else box.width) / self.dpi
            if needed > room:
                label.set_fontsize(float(label.get_fontsize()) * room / needed)

    def line(self, x: float, top: float, bottom: float, width: float) -> None:
        """Draw a dark upright line, so many points wide."""
        from matplotlib.lines import Line2D

        ends = [1 - top / self.height, 1 - bottom / self.height]
        self.figure.add_artist(
            Line2D([x / self.width] * 2, ends, color=_INK, lw=width, solid_capstyle="butt")
        )

    def picture(self, picture: Bytes, left: float, top: float) -> None:
        """Place a picture (rows, columns, 3), pixel by pixel."""
        rows = round((self.height - top) * self.dpi) - len(picture)
        self.figure.figimage(picture, round(left * self.dpi), rows, origin="upper")

    def bar(self, bar: Bar, left: float, top: float, length: float) -> None:
        """Draw slim colours with their ends beside them, within `length`, and the label below."""
        slim, thick = min(1.1, 0.45 * length), 0.07
        start, room = left + (length - slim) / 2, (length - slim) / 2 - 0.06
        across = np.linspace(0, len(bar.colours) - 1, max(round(slim * self.dpi), 2))
        row = bar.colours[np.round(across).astype(int)]
        self.picture(np.tile(row, (max(round(thick * self.dpi), 1), 1, 1)), start, top)
        style = {"fontsize": 7.5, "color": "0.4", "va": "center_baseline"}
        self._set(bar.ends[0], start - 0.06, top + thick / 2, room, ha="right", **style)
        self._set(bar.ends[1], start + slim + 0.06, top + thick / 2, room, ha="left", **style)
        if bar.label:
            self.text(bar.label, left, top + 0.25, length, 8, colour="0.4", centred=True)


def short(value: float) -> str:
    """Two digits, like 0.036 or 3.6e-5, 12 or 1.2e+4."""
    if value == 0:
        return "0"
    if 0.01 <= abs(value) < 1000:
        return f"{value:#.2g}" if abs(value) < 10 else f"{value:.0f}"
    digits, exponent = f"{value:.1e}".split("e")
    return f"{digits}e{int(exponent)}"


@dataclass(frozen=True, eq=False, kw_only=True)
class Bar:
    """A colour bar: its colours (c, 3), what stands at its ends, and what it is of."""

    colours: Bytes
    ends: tuple[str, str]
    label: str = ""


@dataclass(frozen=True, eq=False, kw_only=True)
class Cell:
    """A picture (rows, columns, 3) with lines above it, and its colours."""

    picture: Bytes
    lines: tuple[str, ...] = ()
    bar: Bar | None = None


def set_table(
    page: Page,
    rows: Sequence[Sequence[Cell]],
    *,
    heads: Sequence[str] = (),
    names: Sequence[str] = (),
    cell: float = 0.0,
    left: float = 0.0,
    tall: float = 0.0,
    foot: float = 0.0,
) -> Figure:
    """Set cells on a page, in inches; columns are `cell` wide at least, and all is `tall` at least.

    There are `heads` above the columns, `names` beside the rows, and room `left` and at the `foot`.
    """
    dpi, columns = page.dpi, max(map(len, rows))
    pictures = [entry.picture for row in rows for entry in row]
    cell = max(cell, *(picture.shape[1] / dpi for picture in pictures))
    captions, heights, bars = zip(*(_heights(row, dpi) for row in rows), strict=True)
    used = sum(captions) + sum(heights) + sum(bars) + (len(rows) - 1) * GAP
    begin, side = page.head + HEAD * bool(heads), left + SIDE * bool(names)
    figure = new_figure(
        page,
        2 * MARGIN + side + columns * (cell + GAP) - GAP,
        begin + max(used, tall) + foot + MARGIN,
    )
    canvas = Canvas(figure)
    lefts = [MARGIN + side + i * (cell + GAP) for i in range(columns)]
    for x, head in zip(lefts, heads, strict=False):
        canvas.text(head, x, begin - HEAD + 0.22, cell, 12, bold=True, centred=True)
    top = begin + max(tall - used, 0.0) / 2
    for r, (row, caption, room, bar) in enumerate(zip(rows, captions, heights, bars, strict=True)):
        if names:
            whole = caption + room + bar + GAP
            canvas.sideways(names[r], MARGIN + left + 0.12, top + caption + room / 2, whole)
        for x, entry in zip(lefts, row, strict=False):
            for i, text in enumerate(entry.lines):
                colour = "0.4" if i else "0.1"
                canvas.text(text, x, top + 0.15 + LINE * i, cell, 9, colour=colour, centred=True)
            high, wide = (size / dpi for size in entry.picture.shape[:2])
            canvas.picture(entry.picture, x + (cell - wide) / 2, top + caption + (room - high) / 2)
            if entry.bar is not None:
                canvas.bar(entry.bar, x, top + caption + room + 0.13, cell)
        top += caption + room + bar + GAP
    return figure


def _heights(row: Sequence[Cell], dpi: int) -> tuple[float, float, float]:
    """Inches of the lines, the pictures and the bars of a row."""
    lines = max(len(entry.lines) for entry in row)
    bars = [entry.bar for entry in row if entry.bar is not None]
    return (
        0.06 + LINE * lines if lines else 0.0,
        max(len(entry.picture) for entry in row) / dpi,
        BAR * bool(bars) + LINE * any(bar.label for bar in bars),
    )


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
