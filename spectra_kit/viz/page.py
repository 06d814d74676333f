"""Tables and galleries of pictures on one page, with their heads, captions and colour bars.

Matplotlib sets the page; it is imported when a page is drawn.
"""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from spectra_kit._checked import checked
from spectra_kit._types import Floats
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import Geometry
from spectra_kit.viz.camera import Up, choose_view
from spectra_kit.viz.panels import Panel, draw_panels
from spectra_kit.viz.pen import Pen
from spectra_kit.viz.picture import Picture
from spectra_kit.viz.sheet import MARGIN, check_picture, head, new_figure, save

# Inches.
_WIDTH, _WIDEST_CELL, _GAP = 11.0, 4.5, 0.18
_HEAD, _SIDE, _LINE, _BAR = 0.34, 0.34, 0.17, 0.26
_TALLEST = 2.2  # pictures, height over cell width
_EMPTY = 0.5  # what a place left empty counts against a misfit of the page
_TABLE, _GALLERY = 1.0, 1.4  # the wanted aspect of a page, width over height


@checked
def plot_panels(
    path: str | os.PathLike[str],
    geometry: Geometry,
    rows: Sequence[Sequence[Panel]],
    *,
    rows_named: Sequence[str],
    columns_named: Sequence[str],
    up: Up | None = None,
    turn: float = 0.0,
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
    up : {"x", "y", "z"}, optional
        The axis that points up in the picture; by default the one the geometry seems to stand on.
    turn : float, default 0
        Degrees to turn the geometry about that axis, from the view chosen: its front goes right.
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
    >>> from spectra_kit.viz import Panel, plot_panels
    >>> mesh = TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    >>> panel = Panel(values=mesh.points[:, 0], limit=1.0, lines=("x",))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     picture = plot_panels(
    ...         f"{folder}/x.png", mesh, [[panel]], rows_named=["x"], columns_named=["a"], dpi=40
    ...     )
    >>> picture.path.name
    'x.png'
    """
    check_picture(path, dpi)
    if not rows or {len(row) for row in rows} != {len(columns_named)} or not columns_named:
        raise InvalidInputError(
            f"`rows` must be a table of {len(columns_named)} columns, one for each of"
            f" `columns_named`, got rows of {[len(row) for row in rows]}"
        )
    if len(rows_named) != len(rows):
        raise InvalidInputError(
            f"`rows_named` must be {len(rows)} names, one for each of `rows`, got {len(rows_named)}"
        )
    table, across, down = [list(row) for row in rows], list(columns_named), list(rows_named)
    rotation = choose_view(geometry, up=up, turn=turn)
    aspect = _aspect(geometry, rotation)
    misfits = [
        _misfit(columns, rows, aspect, _TABLE)
        for columns, rows in ((len(across), len(down)), (len(down), len(across)))
    ]
    if misfits[0] > misfits[1]:
        table, across, down = [list(row) for row in zip(*table, strict=True)], down, across
    return _set_page(path, geometry, table, rotation, (across, down), False, (title, subtitle), dpi)


def plot_gallery(
    path: str | os.PathLike[str],
    geometry: Geometry,
    panels: Sequence[Panel],
    *,
    columns: int | None,
    one_bar: bool,
    up: Up | None,
    turn: float,
    title: str,
    subtitle: str,
    dpi: int,
) -> Picture:
    """Draw panels in reading order, in as many columns as fit best; `one_bar` for all at the foot.

    What `plot_fields` and `plot_modes` have in common; the path has been checked.
    """
    rotation, n = choose_view(geometry, up=up, turn=turn), len(panels)
    if columns is None:
        aspect = _aspect(geometry, rotation)
        columns = min(
            range(1, n + 1),
            key=lambda c: _misfit(c, -(-n // c), aspect, _GALLERY) + _EMPTY * (-n % c),
        )
    columns = min(columns, n)
    table = [list(panels[i : i + columns]) for i in range(0, n, columns)]
    return _set_page(path, geometry, table, rotation, None, one_bar, (title, subtitle), dpi)


def _set_page(
    path: str | os.PathLike[str],
    geometry: Geometry,
    table: list[list[Panel]],
    rotation: Floats,
    named: tuple[list[str], list[str]] | None,
    one_bar: bool,
    titles: tuple[str, str],
    dpi: int,
) -> Picture:
    """Draw and place pictures, captions and bars; all is measured in inches from the top."""
    columns, aspect = len(table[0]), _aspect(geometry, rotation)
    cell = _cell_width(columns)
    width = round((cell if aspect < _TALLEST else cell * _TALLEST / aspect) * dpi)
    panels = [panel for row in table for panel in row]
    pictures = draw_panels(geometry, panels, rotation=rotation, width=width, dpi=dpi)
    tall, wide = (side / dpi for side in pictures[0].shape[:2])
    caption = 0.06 + _LINE * max(len(panel.lines) for panel in panels)
    row_height = caption + tall + (0.0 if one_bar else _BAR)
    begin = head(*titles) + (_HEAD if named else 0.0)
    side = _SIDE if named else 0.0
    height = begin + len(table) * (row_height + _GAP) - _GAP + MARGIN + (_BAR if one_bar else 0.0)
    page_width = 2 * MARGIN + side + columns * (cell + _GAP) - _GAP
    figure = new_figure(page_width, height, title=titles[0], subtitle=titles[1], dpi=dpi)
    pen, remaining = Pen(figure), iter(pictures)

    lefts = [MARGIN + side + i * (cell + _GAP) for i in range(columns)]
    for left, name in zip(lefts, named[0] if named else (), strict=False):
        pen.text(name, left, begin - _HEAD + 0.22, cell, 12, bold=True, centred=True)
    for r, row in enumerate(table):
        top = begin + r * (row_height + _GAP)
        if named:
            pen.sideways(named[1][r], MARGIN + 0.12, top + caption + tall / 2, row_height)
        for left, panel in zip(lefts, row, strict=False):
            for i, text in enumerate(panel.lines):
                colour = "0.1" if i == 0 else "0.4"
                pen.text(text, left, top + 0.15 + _LINE * i, cell, 9, colour=colour, centred=True)
            pen.picture(next(remaining), left + (cell - wide) / 2, top + caption)
            if not one_bar:
                pen.bar(panel.colours(512), panel.ends(), left, top + caption + tall + 0.13, cell)
    if one_bar:
        length = min(page_width - 2 * MARGIN, 4.0)
        left = (page_width - length) / 2
        pen.bar(panels[0].colours(512), panels[0].ends(), left, height - MARGIN - 0.13, length)
    return save(figure, path, dpi)


def _aspect(geometry: Geometry, rotation: Floats) -> float:
    """Height over width of the picture of a geometry."""
    extent = np.ptp(geometry.points @ rotation.T, axis=0)[:2]
    return float(np.clip(extent[1] / max(extent[0], 1e-300), 0.1, 8.0))


def _cell_width(columns: int) -> float:
    """Width of a cell when `columns` of them share the page."""
    room = _WIDTH - 2 * MARGIN - _SIDE - (columns - 1) * _GAP
    return min(room / columns, _WIDEST_CELL)


def _misfit(columns: int, rows: int, aspect: float, wanted: float) -> float:
    """How far a page of that many pictures of that aspect is from the wanted one."""
    cell = _cell_width(columns)
    width = 2 * MARGIN + _SIDE + columns * (cell + _GAP) - _GAP
    each = cell * min(aspect, _TALLEST) + 2 * _LINE + _BAR + _GAP
    height = head("any", "") + _HEAD + rows * each - _GAP
    return abs(float(np.log(width / height / wanted)))
