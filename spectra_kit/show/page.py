"""`Page`: what stands at the head of a picture, and how fine it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from spectra_kit._core.checked import checked
from spectra_kit._core.validate import check_count
from spectra_kit.show.pen import Pen

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MARGIN = 0.15  # inches
_COARSEST, _FINEST = 10, 2400  # pixels per inch
_TITLE, _SUBTITLE = 0.36, 0.26  # inches of the lines at the head


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

    Raises
    ------
    InvalidInputError
        If `dpi` is not in [10, 2400].

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
    """Return a white page of so many inches with its titles set, to be filled by a `Pen`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=page.dpi, facecolor="white")
    FigureCanvasAgg(figure)
    pen, room = Pen(figure), width - 2 * MARGIN
    if page.title:
        pen.text(page.title, MARGIN, MARGIN + 0.2, room, 14, bold=True)
    if page.subtitle:
        below = MARGIN + _TITLE * bool(page.title)
        pen.text(page.subtitle, MARGIN, below + 0.1, room, 9, colour="0.35")
    return figure


def new_diagram(page: Page, width: float, height: float) -> Figure:
    """Return a page with `height` inches below its titles, where Matplotlib arranges axes."""
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    figure = new_figure(page, width, height + page.head)
    below = 1 - (page.head - MARGIN) / (height + page.head)
    rect, pad = (0.0, 0.0, 1.0, below), 2 * MARGIN / 3
    figure.set_layout_engine(ConstrainedLayoutEngine(rect=rect, w_pad=pad, h_pad=pad))
    return figure
