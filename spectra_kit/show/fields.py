"""Functions on one geometry: each in its colours and lines, in a table or in a gallery."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Bytes, Floats
from spectra_kit._core.validate import check_count, real_array
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import Geometry, GeometryLike
from spectra_kit.show.camera import View
from spectra_kit.show.colours import diverging_colours, refined, sequential_colours, with_grey
from spectra_kit.show.contours import level_lines, round_number, triangles_of
from spectra_kit.show.layout import (
    BAR,
    GAP,
    HEAD,
    LINE,
    MARGIN,
    SIDE,
    Bar,
    Canvas,
    Cell,
    Page,
    set_table,
    short,
)
from spectra_kit.show.picture import PathLike, plotted
from spectra_kit.show.render import Scene, render

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LINE_WIDTH = 0.75  # points (1/72 inch)
_PERCENTILE = 99.0  # a lone spike must not bleach the rest
_CONSTANT = 1e-12  # of the values: smaller differences are rounding
_WIDTH, _WIDEST_CELL = 11.0, 4.5  # inches
_TALLEST = 2.2  # pictures, height over cell width
_EMPTY = 0.5  # what a place left empty counts against a misfit of the page
_PIXELS = 9  # for each vertex of a surface with grey parts, whose colours blend between vertices
_LEVELS = 14  # lines from one end of the colours to the other, about
_TABLE, _GALLERY = 1.0, 1.4  # the wanted aspect of a page, width over height

Lines = Literal["none", "nodal", "levels"]


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Panel:
    """One picture: a function on the geometry, its colour limits, and two lines of text.

    Attributes
    ----------
    values : ndarray of shape (n,)
        One value per point; NaN, drawn grey, where there is none.
    limit : float
        The colours run from -limit to +limit, white at zero; or from `low`, if it is given. Where
        that is the limit, too, there is one value, and one colour.
    lines : tuple of str
        Set above the picture.
    low : float, optional
        Colours that begin here are sequential, dark to light.
    levels : tuple of float
        Values along which a line is drawn.
    """

    values: Floats
    limit: float
    lines: tuple[str, ...] = ()
    low: float | None = None
    levels: tuple[float, ...] = ()

    def scaled(self) -> Floats:
        """The values, -1 at one end of the colours and 1 at the other."""
        low = -self.limit if self.low is None else self.low
        if low == self.limit:
            return 0.0 * self.values
        return 2 * (self.values - low) / (self.limit - low) - 1

    def ends(self) -> tuple[str, str]:
        """The two ends of the colours in words; the first is empty where they are one value."""
        if self.low is None:
            return _signed(-self.limit, 2), "+" + _signed(self.limit, 2)
        if self.low == self.limit:
            return "", _signed(self.limit, 2)
        size = max(abs(self.low), abs(self.limit)) / (self.limit - self.low)
        digits = 2 + int(np.ceil(np.log10(max(size / 10, 1.0))))  # enough to tell them apart
        return _signed(self.low, digits), _signed(self.limit, digits)

    def colours(self, count: int) -> Bytes:
        """Colours (count, 3) from one end to the other."""
        check_count("count", count, low=1, high=65_536)
        if self.low is None:
            return diverging_colours(np.linspace(-1.0, 1.0, count))
        ends = (0.5, 0.5) if self.low == self.limit else (0.0, 1.0)
        return sequential_colours(np.linspace(*ends, count))

    def bar(self) -> Bar:
        """Return the bar of its colours."""
        return Bar(colours=self.colours(512), ends=self.ends())


def symmetric_limit(*functions: Floats) -> float:
    """The limit of symmetric colours for all these functions together."""
    sizes = [np.abs(f) for f in functions]
    common = max(float(np.percentile(size, _PERCENTILE)) for size in sizes)
    return common or max(float(size.max()) for size in sizes) or 1.0


def sequential_limits(*functions: Floats) -> tuple[float, float]:
    """Both ends of sequential colours for all these functions together; equal for a constant."""
    for beyond in (100 - _PERCENTILE, 0.0):  # where hardly any differ, those few are the picture
        low = min(float(np.percentile(f, beyond)) for f in functions)
        high = max(float(np.percentile(f, 100 - beyond)) for f in functions)
        if high - low > _CONSTANT * max(abs(low), abs(high)):
            return low, high
    return high, high


def draw_panels(
    geometry: Geometry, panels: Sequence[Panel], *, rotation: Floats, width: int, dpi: int
) -> list[Bytes]:
    """Return the pictures of panels, `width` pixels each, seen from one side."""
    for panel in panels:
        if real_array("values", panel.values, some_nan=True).shape != (geometry.n,):
            raise InvalidInputError("values", f"have shape ({geometry.n},)", np.shape(panel.values))
    triangles = triangles_of(geometry) if any(panel.levels for panel in panels) else None
    scenes = []
    kinds = groupby(panels, key=lambda p: (p.low is None, bool(np.isnan(p.values).any())))
    for (_, has_gaps), group in kinds:
        some, lines, drawn, normals = list(group), None, geometry, None
        if triangles is not None:
            lines = [level_lines(geometry.points, triangles, p.values, p.levels) for p in some]
        scaled = [panel.scaled() for panel in some]
        functions: Sequence[Floats] | Sequence[Bytes] = scaled
        if has_gaps:
            every = np.column_stack(scaled)
            drawn, every, normals = refined(geometry, every, width * width // _PIXELS)
            functions = [with_grey(p.colours(256), f) for p, f in zip(some, every.T, strict=True)]
        scene = Scene(
            geometry=drawn,
            functions=functions,
            rotation=rotation,
            width=width,
            colours=None if has_gaps else some[0].colours(256),
            normals=normals,
            lines=lines,
            line_width=LINE_WIDTH * dpi / 72,
        )
        scenes.append(scene)
    return [picture for drawn in render(scenes) for picture in drawn]


def _signed(value: float, digits: int) -> str:
    text = short(value) if digits == 2 else f"{value:.{digits}g}"
    return text.replace("-", "\N{MINUS SIGN}", 1) if value < 0 else text


@plotted
def plot_panels(
    geometry: GeometryLike,
    rows: Sequence[Sequence[Panel]],
    *,
    path: PathLike | None = None,
    view: View = View(),
    page: Page = Page(),
    rows_named: Sequence[str],
    columns_named: Sequence[str],
) -> Figure:
    """Draw a table of functions on one geometry, all seen from the same side.

    Parameters
    ----------
    $geometry
    rows : sequence of sequences of Panel
        A full table. It is transposed where that fits the page better.
    $path
    $view
    $page
    rows_named, columns_named : sequence of str
        The heads of the table.

    $returns

    Examples
    --------
    >>> from spectra_kit.geometry import TriangleMesh
    >>> from spectra_kit.show import Page, Panel, plot_panels
    >>> mesh = TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    >>> panel = Panel(values=mesh.points[:, 0], limit=1.0, lines=("x",))
    >>> plot_panels(mesh, [[panel]], rows_named=["x"], columns_named=["a"], page=Page(dpi=40))
    Picture(path=None)
    """
    if not rows or {len(row) for row in rows} != {len(columns_named)} or not columns_named:
        raise InvalidInputError(
            "rows",
            f"be a table of {len(columns_named)} columns, one for each of `columns_named`",
            f"rows of {[len(row) for row in rows]}",
        )
    if len(rows_named) != len(rows):
        raise InvalidInputError(
            "rows_named", f"be {len(rows)} names, one for each of `rows`", len(rows_named)
        )
    return draw_table(geometry, rows, rows_named, columns_named, view=view, page=page)


@plotted
def plot_fields(
    geometry: GeometryLike,
    fields: Mapping[str, ArrayLike] | Sequence[tuple[str, ArrayLike]],
    *,
    path: PathLike | None = None,
    view: View = View(),
    page: Page = Page(),
    symmetric: bool | None = None,
    share_limits: bool = False,
    lines: Lines = "none",
    columns: int | None = None,
) -> Figure:
    """Draw a gallery of functions on one geometry, all seen from the same side.

    Parameters
    ----------
    $geometry
    fields : mapping of str to array_like of shape (n,), or sequence of such pairs
        What to write above each picture, and one value for each point; NaN, drawn grey, where
        there is none, as `Repaired.restore` has it.
    $path
    $view
    $page
    symmetric : bool, optional
        Blue and red with white at zero, or sequential colours, dark to light; by default the former
        for functions that have negative values.
    share_limits : bool, default False
        One colour bar for all, at the foot of the page.
    lines : {"none", "nodal", "levels"}, default "none"
        Draw lines where a function is zero, or at evenly spaced round values within the colours.
    $columns

    $returns

    Notes
    -----
    Functions are linear on triangles and coloured pixel by pixel. Colours end where one point in a
    hundred lies beyond, so that a lone spike does not bleach the rest. Lines have the same width
    everywhere on the page; on a cloud they are those of the triangles that neighbours make.

    Examples
    --------
    >>> from spectra_kit.geometry import sphere
    >>> from spectra_kit.show import Page, plot_fields
    >>> ball = sphere(subdivisions=2).geometry
    >>> fields = {"height": ball.points[:, 2], "squared": ball.points[:, 2] ** 2}
    >>> plot_fields(ball, fields, lines="nodal", page=Page(dpi=30))
    Picture(path=None)
    """
    pairs = list(fields.items()) if isinstance(fields, Mapping) else fields
    if not isinstance(pairs, list | tuple) or not all(
        isinstance(pair, list | tuple) and len(pair) == 2 for pair in pairs
    ):
        raise InvalidInputError(
            "fields",
            "be a mapping of names to values, or a list of pairs of both",
            f"a {type(fields).__name__}",
            advice="write {'name': values}",
        )
    if not pairs:
        raise InvalidInputError("fields", "hold at least one function", "none")
    named = [(name, real_array(f"fields[{name!r}]", f, some_nan=True)) for name, f in pairs]
    for name, values in named:
        if values.shape != (geometry.n,):
            expected = f"have shape ({geometry.n},), one value for each point"
            raise InvalidInputError(f"fields[{name!r}]", expected, values.shape)
    every = [values for _, values in named] if share_limits else None
    panels = [_panel(name, values, every or [values], symmetric, lines) for name, values in named]
    return draw_gallery(geometry, panels, columns, view=view, page=page, one_bar=share_limits)


def _panel(
    name: str, values: Floats, together: list[Floats], symmetric: bool | None, lines: Lines
) -> Panel:
    """One field, in colours that fit all of `together`."""
    together = [f[~np.isnan(f)] for f in together]
    if symmetric is None:
        symmetric = any(bool((f < 0).any()) for f in together)
    low: float | None
    if symmetric:
        low, high = None, symmetric_limit(*together)
    else:
        low, high = sequential_limits(*together)
    levels: tuple[float, ...] = (0.0,) if lines == "nodal" else ()
    start = -high if low is None else low
    if lines == "levels" and start < high:
        step = round_number((high - start) / _LEVELS)
        # Not beyond the colours: a lone spike would have more lines than anything else.
        first, last = max(start, np.nanmin(values)) / step, min(high, np.nanmax(values)) / step
        levels = tuple(step * np.arange(np.ceil(first), np.floor(last) + 1))
    return Panel(values=values, limit=high, lines=(name,), low=low, levels=levels)


def draw_table(
    geometry: Geometry,
    rows: Sequence[Sequence[Panel]],
    rows_named: Sequence[str],
    columns_named: Sequence[str],
    *,
    view: View,
    page: Page,
) -> Figure:
    """Draw a full table of panels, transposed where that fits the page better."""
    rotation = view.rotation(geometry)
    aspect = _aspect(geometry, rotation)
    across, down = len(columns_named), len(rows_named)
    if _misfit(across, down, aspect, _TABLE) > _misfit(down, across, aspect, _TABLE):
        rows, columns_named, rows_named = list(zip(*rows, strict=True)), rows_named, columns_named
    cell = _cell_width(len(columns_named))
    cells = _cells(geometry, rows, rotation, page, cell)
    return set_table(page, cells, heads=columns_named, names=rows_named, cell=cell)


def draw_gallery(
    geometry: Geometry,
    panels: Sequence[Panel],
    columns: int | None,
    *,
    view: View,
    page: Page,
    one_bar: bool = False,
) -> Figure:
    """Draw panels in reading order, in columns that fit best; `one_bar` for all at the foot."""
    rotation, n = view.rotation(geometry), len(panels)
    if columns is None:
        aspect = _aspect(geometry, rotation)
        misfits = [
            _misfit(c, -(-n // c), aspect, _GALLERY) + _EMPTY * (-n % c) for c in range(1, n + 1)
        ]
        columns = 1 + int(np.argmin(misfits))
    columns = min(check_count("columns", columns, low=1), n)
    table = [panels[i : i + columns] for i in range(0, n, columns)]
    cell = _cell_width(columns)
    cells = _cells(geometry, table, rotation, page, cell, bars=not one_bar)
    figure = set_table(page, cells, cell=cell, foot=BAR * one_bar)
    if one_bar:
        canvas = Canvas(figure)
        length = min(canvas.width - 2 * MARGIN, 4.0)
        left, top = (canvas.width - length) / 2, canvas.height - MARGIN - 0.13
        canvas.bar(panels[0].bar(), left, top, length)
    return figure


def _cells(
    geometry: Geometry,
    table: Sequence[Sequence[Panel]],
    rotation: Floats,
    page: Page,
    cell: float,
    *,
    bars: bool = True,
) -> list[list[Cell]]:
    """The pictures of panels in cells so many inches wide, with or without their bars."""
    aspect = _aspect(geometry, rotation)
    width = int((cell if aspect < _TALLEST else cell * _TALLEST / aspect) * page.dpi)
    panels = [panel for row in table for panel in row]
    pictures = iter(draw_panels(geometry, panels, rotation=rotation, width=width, dpi=page.dpi))
    return [
        [
            Cell(picture=next(pictures), lines=panel.lines, bar=panel.bar() if bars else None)
            for panel in row
        ]
        for row in table
    ]


def _aspect(geometry: Geometry, rotation: Floats) -> float:
    """Height over width of the picture of a geometry."""
    extent = np.ptp(geometry.points @ rotation.T, axis=0)[:2]
    return float(np.clip(extent[1] / max(extent[0], 1e-300), 0.1, 8.0))


def _cell_width(columns: int) -> float:
    """Width of a cell when `columns` of them share the page."""
    room = _WIDTH - 2 * MARGIN - SIDE - (columns - 1) * GAP
    return min(room / columns, _WIDEST_CELL)


def _misfit(columns: int, rows: int, aspect: float, wanted: float) -> float:
    """How far a page of that many pictures of that aspect is from the wanted one."""
    cell = _cell_width(columns)
    width = 2 * MARGIN + SIDE + columns * (cell + GAP) - GAP
    each = cell * min(aspect, _TALLEST) + 2 * LINE + BAR + GAP
    height = Page("any").head + HEAD + rows * each - GAP
    return abs(float(np.log(width / height / wanted)))
