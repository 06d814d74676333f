"""Pictures of distances: colours with evenly spaced lines, as on a map."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.types import Bytes, Floats
from spectra_kit._core.validate import check_points
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import Geometry, GeometryLike
from spectra_kit.show.camera import View, fitting_size
from spectra_kit.show.colours import distance_colours, largest
from spectra_kit.show.contours import distance_levels, level_lines, triangles_of
from spectra_kit.show.layout import MARGIN, Canvas, Cell, Page, set_table
from spectra_kit.show.picture import PathLike, plotted
from spectra_kit.show.render import Scene, render, with_balls

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EVERY = 5  # so many lines make a thicker one
MARK = (24, 24, 40)  # the colour of what marks a source
_THIN, _THICK = 0.7, 1.3  # of a line, in points (1/72 inch)
# Inches.
_BALL = 0.07  # radius of the mark of a source
_WIDEST, _TALLEST, _ROOM = 4.6, 4.6, 4.0
_FOOT, _THICKNESS = 0.75, 0.13


@plotted
def plot_distance(
    geometry: GeometryLike,
    distance: ArrayLike,
    *,
    path: PathLike | None = None,
    view: View = View(),
    page: Page = Page(),
    sources: ArrayLike | None = None,
    spacing: float | None = None,
    label: str = "distance",
) -> Figure:
    """Draw distances on a geometry in colours with evenly spaced lines, from two sides.

    Parameters
    ----------
    $geometry
    distance : array_like of shape (n,)
        In the unit of length, >= 0; infinity is drawn in grey.
    $path
    $view
    $page
    sources : array_like of shape (s, 3), optional
        Places to mark by black balls.
    spacing : float, optional
        Between two lines, in the unit of length; by default a round number that makes at most 40.
    label : str, default "distance"
        Set below the scale.

    $returns

    Notes
    -----
    A function that is linear on triangles has straight lines there, of the same width everywhere
    on the page; every fifth is thicker. On a cloud they are those of the triangles that neighbours
    make.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.geometry import sphere
    >>> from spectra_kit.show import Page, plot_distance
    >>> ball = sphere(subdivisions=2).geometry
    >>> distance = np.arccos(np.clip(ball.points @ ball.points[0], -1, 1))
    >>> plot_distance(ball, distance, page=Page("From one point", dpi=30))
    Picture(path=None)
    """
    values = _check_distance(distance, geometry.n)
    marks = np.empty((0, 3)) if sources is None else check_points("sources", sources)
    unit = inch(geometry, view)
    levels = distance_levels(values, spacing, inch=unit)
    lines, widths = distance_lines(geometry, values, levels)
    colours = distance_colours(values)
    figure = both_sides(geometry, colours, lines, widths, marks, view, page, foot=_FOOT)
    caption = f"{label}, a line every {levels[0]:.4g}" if len(levels) else label
    caption += " · grey: not reached" * bool(np.isinf(values).any())
    caption += " · black balls: the sources" * bool(len(marks))
    _set_scale(Canvas(figure), largest(values), levels, caption)
    return figure


def inch(geometry: Geometry, view: View) -> float:
    """Return what an inch of a picture of `both_sides` is, in the unit of length."""
    rotation = view.rotation(geometry)
    extent = np.ptp(geometry.points @ rotation.T, axis=0)[:2].max()
    return float(extent) / max(fitting_size(geometry, rotation, _WIDEST, _TALLEST))


def both_sides(
    geometry: Geometry,
    colours: Bytes | tuple[int, int, int],
    lines: Floats,
    widths: Floats | float,
    marks: ArrayLike,
    view: View,
    page: Page,
    *,
    foot: float = 0.0,
) -> Figure:
    """Draw a coloured geometry with lines, widths in points, and balls at `marks`."""
    rotation = view.rotation(geometry)
    across, tall = fitting_size(geometry, rotation, _WIDEST, _TALLEST)
    at = np.empty((0, 3))
    if np.size(marks):
        at = np.unique(check_points("marks", marks), axis=0)
    drawn, _ = with_balls(geometry, at, _BALL * inch(geometry, view))
    every: Bytes = np.full((drawn.n, 3), MARK, dtype=np.uint8)
    every[: geometry.n] = colours
    scene = Scene(
        geometry=drawn,
        functions=[every],
        rotation=rotation,
        width=round(across * page.dpi),
        behind=True,
        lines=[lines],
        line_width=widths * page.dpi / 72,
    )
    cells = [Cell(picture=picture) for picture in render([scene])[0]]
    stacked = across > 2 * tall
    rows = [[cell] for cell in cells] if stacked else [cells]
    return set_table(page, rows, cell=_ROOM if stacked else _ROOM / 2, foot=foot)


def distance_lines(geometry: Geometry, values: Floats, levels: Floats) -> tuple[Floats, Floats]:
    """Return the segments (s, 2, 3) of the lines, and their widths (s,) in points.

    Between a number and infinity there is nothing to interpolate: there are none.
    """
    triangles = triangles_of(geometry)
    known = triangles[np.isfinite(values[triangles]).all(axis=1)]
    finite = np.where(np.isfinite(values), values, largest(values))
    thick = np.arange(1, len(levels) + 1) % EVERY == 0
    lines = [
        level_lines(geometry.points, known, finite, levels[these]) for these in (~thick, thick)
    ]
    return np.concatenate(lines), np.repeat([_THIN, _THICK], [len(part) for part in lines])


def _check_distance(distance: ArrayLike, n: int) -> Floats:
    values = np.asarray(distance, dtype=np.float64)
    if values.shape != (n,) or np.isnan(values).any() or (values < 0).any():
        expected = f"have shape ({n},), one number >= 0 or infinity for each point"
        nan, negative = int(np.isnan(values).sum()), int((values < 0).sum())
        got = f"shape {values.shape} with {nan} NaN and {negative} negative"
        raise InvalidInputError("distance", expected, got)
    return values


def _set_scale(canvas: Canvas, limit: float, levels: Floats, caption: str) -> None:
    """Draw the colours from zero to the limit, numbers at the thick lines, and what they are."""
    length = 0.55 * (canvas.width - 2 * MARGIN)
    left, top = (canvas.width - length) / 2, canvas.height - MARGIN - _FOOT + 0.25
    strip: Bytes = distance_colours(np.linspace(0.0, limit, round(length * canvas.dpi)))
    canvas.picture(np.tile(strip, (round(_THICKNESS * canvas.dpi), 1, 1)), left, top)
    below = top + _THICKNESS
    for i, level in enumerate([0.0, *levels]):
        at = left + length * level / limit
        if i:
            canvas.line(at, top, below, _THIN if i % EVERY else _THICK)
        if not i % EVERY:
            canvas.text(f"{level:.4g}", at - 0.4, below + 0.14, 0.8, 8, centred=True)
    canvas.text(caption, left, below + 0.32, length, 8, centred=True, colour="0.4")
