"""A table of pictures on one page, with its heads, captions and colour bars.

Matplotlib sets the page; it is imported when a page is drawn.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from spectra_kit._validate import real_array
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import Geometry
from spectra_kit.viz.camera import choose_view
from spectra_kit.viz.pen import Pen, short
from spectra_kit.viz.picture import Picture
from spectra_kit.viz.render import Scene, render
from spectra_kit.viz.sheet import MARGIN, check_picture_path, head, new_figure, save

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]

_COLOURS = "RdBu_r"  # diverging, told apart with every kind of colour blindness

# Inches.
_WIDTH, _WIDEST_CELL, _GAP = 11.0, 4.5, 0.18
_HEAD, _SIDE, _CAPTION, _BAR = 0.34, 0.34, 0.40, 0.26
_TALLEST = 2.2  # pictures, height over cell width
_ASPECT = 1.0  # of the page, width over height: decides whether modes are rows or columns


@dataclass(frozen=True, eq=False, kw_only=True)
class Panel:
    """One picture: a function on the geometry, its colour limit, and two lines of text.

    Attributes
    ----------
    values : ndarray of shape (n,)
        One value per point.
    limit : float
        The colours run from -limit to +limit, white at zero.
    lines : tuple of str
        Set above the picture.
    """

    values: Floats
    limit: float
    lines: tuple[str, ...] = ()


def plot_panels(
    path: str | os.PathLike[str],
    geometry: Geometry,
    rows: Sequence[Sequence[Panel]],
    *,
    rows_named: Sequence[str],
    columns_named: Sequence[str],
    title: str = "",
    subtitle: str = "",
    dpi: int = 200,
) -> Picture:
    """Draw a table of functions on one geometry, all seen from the same side.

    Parameters
    ----------
    path : path-like
        The ``.png``, ``.pdf`` or ``.svg`` file to write, whole or not at all.
    geometry : TriangleMesh or PointCloud
        A cloud is drawn as balls that overlap a little.
    rows : sequence of sequences of Panel
        A full table. It is transposed where that fits the page better.
    rows_named, columns_named : sequence of str
        The heads of the table.
    title, subtitle : str, optional
        Two lines at the head of the page.
    dpi : int, default 200
        Pixels per inch; the page is at most 11 inches wide.

    Returns
    -------
    Picture
        Of the file written.

    Raises
    ------
    InvalidInputError
        If the table is empty or ragged, a panel has not one finite value per point, or `path`
        cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from spectra_kit.geometry import TriangleMesh
    >>> mesh = TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    >>> panel = Panel(values=mesh.points[:, 0], limit=1.0, lines=("x",))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "x.png"
    ...     plot_panels(path, mesh, [[panel]], rows_named=["x"], columns_named=["a"], dpi=40)
    ...     path.exists()
    True
    """
    check_picture_path(path)
    if not rows or {len(row) for row in rows} != {len(columns_named)} or not columns_named:
        raise InvalidInputError(
            f"`rows` must be a table of {len(columns_named)} columns,"
            f" got rows of {[len(row) for row in rows]}"
        )
    for panel in (panel for row in rows for panel in row):
        if real_array("values", panel.values).shape != (geometry.n,):
            raise InvalidInputError(
                f"`values` must have shape ({geometry.n},), got {np.shape(panel.values)}"
            )
    table, across, down = [list(row) for row in rows], list(columns_named), list(rows_named)
    rotation = choose_view(geometry)
    extent = np.ptp(geometry.points @ rotation.T, axis=0)[:2]
    aspect = float(np.clip(extent[1] / max(extent[0], 1e-300), 0.1, 8.0))
    if _misfit(len(across), len(down), aspect) > _misfit(len(down), len(across), aspect):
        table, across, down = [list(row) for row in zip(*table, strict=True)], down, across

    cell = _cell_width(len(across))
    width = cell if aspect < _TALLEST else cell * _TALLEST / aspect
    functions = [panel.values / panel.limit for row in table for panel in row]
    scene = Scene(
        geometry=geometry,
        functions=functions,
        rotation=rotation,
        width=round(width * dpi),
        colours=_colours(np.linspace(-1.0, 1.0, 256)),
    )
    (pictures,) = render([scene])
    return save(_set_page(table, across, down, pictures, cell, title, subtitle, dpi), path, dpi)


def _set_page(
    table: list[list[Panel]],
    across: list[str],
    down: list[str],
    pictures: Bytes,
    cell: float,
    title: str,
    subtitle: str,
    dpi: int,
) -> Figure:
    """Place pictures, captions and colour bars; everything is measured in inches from the top."""
    picture_height, picture_width = (side / dpi for side in pictures.shape[1:3])
    row_height = _CAPTION + picture_height + _BAR
    begin = head(title, subtitle)
    height = begin + _HEAD + len(down) * (row_height + _GAP) + MARGIN
    width = 2 * MARGIN + _SIDE + len(across) * (cell + _GAP) - _GAP
    figure = new_figure(width, height, title=title, subtitle=subtitle, dpi=dpi)
    pen = Pen(figure)
    strip = _colours(np.linspace(-1.0, 1.0, 512))
    lefts = [MARGIN + _SIDE + i * (cell + _GAP) for i in range(len(across))]
    for left, name in zip(lefts, across, strict=True):
        pen.text(name, left, begin + 0.22, cell, 12, bold=True, centred=True)
    remaining = iter(pictures)
    for r, name in enumerate(down):
        top = begin + _HEAD + r * (row_height + _GAP)
        pen.sideways(name, MARGIN + 0.12, top + _CAPTION + picture_height / 2, row_height)
        for left, panel in zip(lefts, table[r], strict=True):
            for line, text in enumerate(panel.lines):
                colour = "0.1" if line == 0 else "0.4"
                pen.text(text, left, top + 0.15 + 0.17 * line, cell, 9, colour=colour, centred=True)
            pen.picture(next(remaining), left + (cell - picture_width) / 2, top + _CAPTION)
            ends = "\N{MINUS SIGN}" + short(panel.limit), "+" + short(panel.limit)
            pen.bar(strip, ends, left, top + _CAPTION + picture_height + 0.13, cell)
    return figure


def _cell_width(columns: int) -> float:
    """Width of a cell when `columns` of them share the page."""
    room = _WIDTH - 2 * MARGIN - _SIDE - (columns - 1) * _GAP
    return min(room / columns, _WIDEST_CELL)


def _misfit(columns: int, rows: int, aspect: float) -> float:
    """How far a page of that many pictures of that aspect is from the wanted one."""
    height = (
        head("any", "")
        + _HEAD
        + rows * (_cell_width(columns) * min(aspect, _TALLEST) + _CAPTION + _BAR + _GAP)
    )
    return abs(float(np.log(_WIDTH / height / _ASPECT)))


def _colours(values: Floats) -> Bytes:
    """RGB bytes of values in [-1, 1], white at zero."""
    from matplotlib import colormaps

    # The two ends of the map are nearly black: lit surfaces need some colour left.
    scaled = 0.5 + 0.46 * np.clip(values, -1.0, 1.0)
    return np.asarray(colormaps[_COLOURS](scaled, bytes=True))[..., :3]
