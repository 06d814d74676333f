"""A page of rows of pictures, each row as tall as it needs, with one colour bar below."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from spectra_kit._types import Bytes
from spectra_kit.viz.colours import error_colours
from spectra_kit.viz.pen import Pen, short
from spectra_kit.viz.sheet import MARGIN, head, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# Inches.
_GAP, _SIDE, _HEAD, _LINE, _BAR = 0.25, 0.3, 0.34, 0.19, 0.3
_NARROWEST = 2.2  # of a cell


@dataclass(frozen=True, eq=False)
class Row:
    """Pictures beside each other, the name of the row, and of source and target if not above."""

    name: str
    names: tuple[str, str] | None
    pictures: list[Bytes]


def set_rows(
    rows: list[Row],
    heads: list[str],
    bar: tuple[float, str] | None,
    title: str,
    subtitle: str,
    dpi: int,
) -> Figure:
    """Place the pictures, names and the colour bar; everything in inches from the top."""
    columns = 2 if bar is None else 3
    cell = max(_NARROWEST, *(p.shape[1] / dpi for row in rows for p in row.pictures))
    tall = [max(p.shape[0] for p in row.pictures) / dpi for row in rows]
    begin = head(title, subtitle)
    lines = [0.0 if row.names is None else _LINE for row in rows]
    height = begin + _HEAD + sum(tall) + sum(lines) + len(rows) * _GAP + MARGIN
    height += 0.0 if bar is None else _BAR
    width = 2 * MARGIN + _SIDE + columns * (cell + _GAP) - _GAP
    figure = new_figure(width, height, title=title, subtitle=subtitle, dpi=dpi)
    pen = Pen(figure)
    lefts = [MARGIN + _SIDE + i * (cell + _GAP) for i in range(columns)]
    for left, name in zip(lefts, heads, strict=False):
        pen.text(name, left, begin + 0.22, cell, 12, bold=True, centred=True)
    top = begin + _HEAD
    for row, line, room in zip(rows, lines, tall, strict=True):
        for left, text in zip(lefts, row.names or (), strict=False):
            pen.text(text, left, top + 0.12, cell, 9, colour="0.35", centred=True)
        top += line
        pen.sideways(row.name, MARGIN + 0.1, top + room / 2, room + _GAP)
        for left, picture in zip(lefts, row.pictures, strict=False):
            high, wide = (side / dpi for side in picture.shape[:2])
            pen.picture(picture, left + (cell - wide) / 2, top + (room - high) / 2)
        top += room + _GAP
    if bar is not None:
        limit, label = bar
        strip = error_colours(np.linspace(0.0, 1.0, 256), 1.0)
        pen.bar(strip, ("0", short(limit)), lefts[2], top - 0.05, cell)
        pen.text(label, lefts[2], top + 0.2, cell, 8, colour="0.4", centred=True)
    return figure
