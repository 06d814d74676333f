"""A gallery of functions on one geometry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._checked import checked
from spectra_kit._types import Floats
from spectra_kit._validate import check_count, real_array
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import Geometry
from spectra_kit.viz.camera import View
from spectra_kit.viz.contours import round_number
from spectra_kit.viz.gallery import draw_gallery
from spectra_kit.viz.page import Page
from spectra_kit.viz.panels import Panel, sequential_limits, symmetric_limit
from spectra_kit.viz.picture import plotted

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Lines = Literal["none", "nodal", "levels"]

_LEVELS = 14  # lines from one end of the colours to the other, about


@plotted
@checked
def plot_fields(
    geometry: Geometry,
    fields: Mapping[str, ArrayLike] | Sequence[tuple[str, ArrayLike]],
    *,
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
    $path
    $geometry
    fields : mapping of str to array_like of shape (n,), or sequence of such pairs
        What to write above each picture, and one finite value for each point.
    $view
    $page
    symmetric : bool, optional
        Blue and red with white at zero, or sequential colours, dark to light; by default the former
        for functions that have negative values.
    share_limits : bool, default False
        One colour bar for all, at the foot of the page.
    lines : {"none", "nodal", "levels"}, default "none"
        Draw lines where a function is zero, or at evenly spaced round values within the colours.
    columns : int, optional
        How many pictures stand beside each other; by default what fits the page best.

    $returns

    Notes
    -----
    Functions are linear on triangles and coloured pixel by pixel. Colours end where one point in a
    hundred lies beyond, so that a lone spike does not bleach the rest. Lines have the same width
    everywhere on the page; on a cloud they are those of the triangles that neighbours make.

    Examples
    --------
    >>> from spectra_kit.geometry import sphere
    >>> from spectra_kit.viz import Page, plot_fields
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
    if columns is not None:
        check_count("columns", columns, low=1)
    named = [(name, real_array(f"fields[{name!r}]", values)) for name, values in pairs]
    for name, values in named:
        if values.shape != (geometry.n,):
            raise InvalidInputError(
                f"fields[{name!r}]",
                f"have shape ({geometry.n},), one value for each point",
                values.shape,
            )
    every = [values for _, values in named] if share_limits else None
    return draw_gallery(
        geometry,
        [_panel(name, values, every or [values], symmetric, lines) for name, values in named],
        columns=columns,
        one_bar=share_limits,
        view=view,
        page=page,
    )


def _panel(
    name: str, values: Floats, together: list[Floats], symmetric: bool | None, lines: Lines
) -> Panel:
    """One field, in colours that fit all of `together`."""
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
        first, last = (
            np.ceil(max(start, values.min()) / step),
            np.floor(min(high, values.max()) / step),
        )
        levels = tuple(step * np.arange(first, last + 1))
    return Panel(values=values, limit=high, lines=(name,), low=low, levels=levels)
