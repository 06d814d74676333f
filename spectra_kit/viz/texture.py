"""A chart of named squares to lay on a geometry, that a map carries to another one."""

from __future__ import annotations

from string import ascii_uppercase
from typing import Any

import numpy as np

from spectra_kit._types import Bytes, Floats
from spectra_kit.viz.colours import oklab_to_srgb

SQUARES = 9  # along the longer side
_PIXELS = 96  # of the chart, along the side of a square
_LIGHT, _DARK = 0.9, 0.56  # lightness of the squares
_INK, _CHALK = "#26222c", "#ffffff"  # names on either


def texture_colours(positions: Floats, low: Floats, high: Floats) -> Bytes:
    """Colour positions (n, 3) in a box by a chart that lies in the picture plane.

    Light and dark squares, named A1, B1, … from the lower left; bluer to the left and yellower to
    the right, greener below and redder above.
    """
    side = np.maximum(high - low, 1e-300)[:2]
    cell = side.max() / SQUARES
    columns, rows = (int(count) for count in np.maximum(np.ceil(side / cell - 1e-9), 1))
    chart: Bytes = named_squares(columns, rows)
    at = np.floor((positions[:, :2] - low[:2]) / cell * _PIXELS).astype(np.int64)
    across = np.clip(at[:, 0], 0, chart.shape[1] - 1)
    down = np.clip(chart.shape[0] - 1 - at[:, 1], 0, chart.shape[0] - 1)
    return np.asarray(chart[down, across])


def named_squares(columns: int, rows: int) -> Bytes:
    """Return the picture of a chart, upper row first."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    right, up = np.meshgrid(np.arange(columns), np.arange(rows)[::-1])
    dark = (right + up) % 2 == 1
    lab = np.stack(
        [
            np.where(dark, _DARK, _LIGHT),
            0.10 * (2 * (up + 0.5) / rows - 1),
            0.12 * (2 * (right + 0.5) / columns - 1),
        ],
        axis=-1,
    )
    squares = oklab_to_srgb(lab.reshape(-1, 3)).reshape(rows, columns, 3)
    figure = Figure(figsize=(columns, rows), dpi=_PIXELS)
    canvas = FigureCanvasAgg(figure)
    figure.figimage(squares.repeat(_PIXELS, axis=0).repeat(_PIXELS, axis=1), origin="upper")
    for column in range(columns):
        for row in range(rows):
            figure.text(
                (column + 0.5) / columns,
                (row + 0.48) / rows,
                f"{ascii_uppercase[column]}{row + 1}",
                fontsize=38,
                fontweight="bold",
                color=_CHALK if (column + row) % 2 else _INK,
                ha="center",
                va="center",
            )
    drawn: Any = canvas
    drawn.draw()  # untyped in Matplotlib
    return np.array(drawn.buffer_rgba())[..., :3]
