"""A page as a table of pictures, each with lines above it and perhaps a colour bar below."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from spectra_kit._core.types import Bytes
from spectra_kit.show.page import MARGIN, Page, new_figure
from spectra_kit.show.pen import Pen

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Inches.
GAP, SIDE, HEAD, LINE, BAR = 0.18, 0.34, 0.34, 0.17, 0.26


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
    pen = Pen(figure)
    lefts = [MARGIN + side + i * (cell + GAP) for i in range(columns)]
    for x, head in zip(lefts, heads, strict=False):
        pen.text(head, x, begin - HEAD + 0.22, cell, 12, bold=True, centred=True)
    top = begin + max(tall - used, 0.0) / 2
    for r, (row, caption, room, bar) in enumerate(zip(rows, captions, heights, bars, strict=True)):
        if names:
            whole = caption + room + bar + GAP
            pen.sideways(names[r], MARGIN + left + 0.12, top + caption + room / 2, whole)
        for x, entry in zip(lefts, row, strict=False):
            for i, text in enumerate(entry.lines):
                colour = "0.4" if i else "0.1"
                pen.text(text, x, top + 0.15 + LINE * i, cell, 9, colour=colour, centred=True)
            high, wide = (size / dpi for size in entry.picture.shape[:2])
            pen.picture(entry.picture, x + (cell - wide) / 2, top + caption + (room - high) / 2)
            if entry.bar is not None:
                pen.bar(entry.bar.colours, entry.bar.ends, x, top + caption + room + 0.13, cell)
                below = top + caption + room + 0.38
                pen.text(entry.bar.label, x, below, cell, 8, colour="0.4", centred=True)
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
