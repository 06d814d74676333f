"""What all pages have in common: the file, the head, line colours, and tidy axes."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spectra_kit._files import atomic_path, check_target
from spectra_kit._validate import check_count
from spectra_kit.errors import InvalidInputError
from spectra_kit.viz.pen import Pen
from spectra_kit.viz.picture import Picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Dashes = str | tuple[int, tuple[float, float]]

SUFFIXES = (".png", ".pdf", ".svg")
MARGIN = 0.15  # inches
_COARSEST, _FINEST = 10, 2400  # pixels per inch
_TITLE, _SUBTITLE = 0.36, 0.26  # inches of the lines at the head

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


def check_picture(path: str | os.PathLike[str], dpi: int) -> Path:
    """Return `path` if a picture can be written there, so fine: to be asked before the work."""
    if Path(path).suffix.lower() not in SUFFIXES:
        raise InvalidInputError(f"`path` must end in .png, .pdf or .svg, got {str(path)!r}")
    check_target(path)
    check_count("dpi", dpi, low=_COARSEST, high=_FINEST)
    return Path(path)


def head(title: str, subtitle: str) -> float:
    """Inches from the upper edge of the page to what comes below its titles."""
    return MARGIN + (_TITLE if title else 0.0) + (_SUBTITLE if subtitle else 0.0)


def new_figure(
    width: float,
    height: float,
    *,
    title: str = "",
    subtitle: str = "",
    dpi: int = 200,
    constrained: bool = False,
) -> Figure:
    """Return a white page of so many inches with its titles set.

    With `constrained` Matplotlib arranges the axes that are added, below the titles; otherwise they
    are placed by hand, `head` inches from above. Pictures set by a `Pen` need the `dpi` of `save`.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    figure = Figure(figsize=(width, height), dpi=dpi, facecolor="white")
    FigureCanvasAgg(figure)
    pen, room = Pen(figure), width - 2 * MARGIN
    if title:
        pen.text(title, MARGIN, MARGIN + 0.2, room, 14, bold=True)
    if subtitle:
        pen.text(subtitle, MARGIN, head(title, "") + 0.1, room, 9, colour="0.35")
    if constrained:
        below = 1 - (head(title, subtitle) - MARGIN) / height
        rect, pad = (0.0, 0.0, 1.0, below), 2 * MARGIN / 3
        figure.set_layout_engine(ConstrainedLayoutEngine(rect=rect, w_pad=pad, h_pad=pad))
    return figure


def tidy(axes: Axes) -> None:
    """A light grid behind the data, and no frame to the right and above."""
    axes.grid(color="0.92", lw=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9)


def save(figure: Figure, path: str | os.PathLike[str], dpi: int) -> Picture:
    """Write a figure, whole or not at all.

    In ``.pdf`` and ``.svg`` text stays text and lines stay lines; pictures are embedded pixel by
    pixel. The same figure gives the same bytes.
    """
    from matplotlib import rc_context

    dated = {".pdf": "CreationDate", ".svg": "Date"}.get(Path(path).suffix.lower())
    style: Any = {"svg.fonttype": "none", "svg.hashsalt": "spectra_kit", "pdf.fonttype": 42}
    if dated is not None:
        _embed_pictures(figure)
    with atomic_path(path) as part, rc_context(style):
        figure.savefig(part, dpi=dpi, metadata=None if dated is None else {dated: None})
    return Picture(Path(path))


def _embed_pictures(figure: Figure) -> None:
    """Turn pictures laid on the pixels of a page into ones that a page without pixels scales.

    Matplotlib would resample the former, and leave faint edges.
    """
    width, height = figure.get_size_inches() * figure.dpi
    images: list[Any] = list(figure.images)
    for image in images:
        pixels = image.get_array()
        rows, columns = pixels.shape[:2]
        place = (image.ox / width, image.oy / height, columns / width, rows / height)
        axes = figure.add_axes(place, frame_on=False, xticks=[], yticks=[], zorder=-1)
        axes.imshow(pixels, interpolation="none", aspect="auto", origin="upper")
        image.remove()
