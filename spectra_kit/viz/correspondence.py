"""Pictures of point maps: the colours of the source carried to the target, and the error there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._checked import checked
from spectra_kit._types import Floats, Ints
from spectra_kit._validate import check_positive
from spectra_kit.correspondence import MapErrors
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import Geometry
from spectra_kit.viz.camera import View, fitting_size
from spectra_kit.viz.colours import error_colours, position_colours, refined
from spectra_kit.viz.matched_pair import MatchedPair
from spectra_kit.viz.page import Page
from spectra_kit.viz.pen import short
from spectra_kit.viz.picture import plotted
from spectra_kit.viz.render import Scene, render
from spectra_kit.viz.table import Bar, Cell, set_table
from spectra_kit.viz.texture import texture_colours

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Transfer = Literal["colours", "texture"]

_WIDEST, _TALLEST, _NARROWEST = 3.4, 3.6, 2.2  # inches of a picture, and of a column
_PIXELS = {"colours": 4, "texture": 1}  # to a vertex: a pattern inside triangles looks sharp
_HEADS = ("source", "target")
_PERCENTILE = 99.0  # a lone outlier must not bleach the rest


@plotted
@checked
def plot_correspondence(
    source: Geometry,
    target: Geometry,
    point_map: ArrayLike,
    *,
    view: View = View(),
    page: Page = Page(),
    errors: MapErrors | None = None,
    transfer: Transfer = "colours",
    limit: float | None = None,
    error_label: str = "geodesic error, 100 / √area",
    names: tuple[str, str] = ("source", "target"),
) -> Figure:
    """Draw the source in colours, and the target in those that a point map gives it.

    Both are seen from the same side, and below from the other side.

    Parameters
    ----------
    source, target : TriangleMesh or PointCloud
        With n1 and n2 points. A cloud is drawn as balls that overlap a little.
    point_map : array_like of shape (n2,), integers
        The source point of each target point.
    errors : MapErrors, optional
        Of the map, drawn in a third column at the target points that they are of; those of a mesh
        are made by `correspondence.map_errors`.
    transfer : {"colours", "texture"}, default "colours"
        What the map carries: gradual colours, or a chart of named squares.
    limit : float, optional
        The error at the dark end of the colours; by default the 99th percentile.
    error_label : str
        Says what the errors are, and in which unit.
    names : tuple of str, default ("source", "target")
        What to call the two.

    Notes
    -----
    A colour stands for a place on the source: blue to yellow from left to right, dark to light
    upwards, green to red towards the viewer. On meshes a faint checkerboard shows
    noise and stretch. A map that confuses left and right exchanges blue and yellow.

    The texture lies on the source in the picture plane, and goes through it: from behind it reads
    mirrored. On the target, names are legible where the map is smooth, broken where it is not, and
    mirrored where it turns the surface over. It wants meshes: a cloud has one colour per ball.

    Examples
    --------
    >>> from spectra_kit.geometry import creature_pair
    >>> from spectra_kit.viz import Page, plot_correspondence
    >>> source, target, point_map = creature_pair(600)
    >>> plot_correspondence(source, target, point_map, page=Page(dpi=30))
    Picture(path=None)
    """
    pair = MatchedPair(
        source=source, target=target, point_map=point_map, errors=errors, names=names
    )
    return _draw([pair], True, transfer, limit, error_label, view, page)


@plotted
@checked
def plot_correspondences(
    pairs: Sequence[MatchedPair],
    *,
    view: View = View(),
    page: Page = Page(),
    transfer: Transfer = "colours",
    limit: float | None = None,
    error_label: str = "geodesic error, 100 / √area",
) -> Figure:
    """Draw several matched pairs, one row each, from one side.

    Parameters
    ----------
    pairs : sequence of MatchedPair
        At least one. If one has errors, all share their colour scale.
    transfer : {"colours", "texture"}, default "colours"
        As in `plot_correspondence`.
    limit : float, optional
        The error at the dark end of the colours, for all.
    error_label : str
        Says what the errors are, and in which unit.

    Examples
    --------
    >>> from spectra_kit.geometry import creature_pair
    >>> from spectra_kit.viz import MatchedPair, Page, plot_correspondences
    >>> source, target, point_map = creature_pair(600)
    >>> pair = MatchedPair(source=source, target=target, point_map=point_map, name="truth")
    >>> plot_correspondences([pair], page=Page(dpi=30))
    Picture(path=None)
    """
    if not pairs:
        raise InvalidInputError("pairs", "hold at least one MatchedPair", "none")
    return _draw(pairs, False, transfer, limit, error_label, view, page)


def _draw(
    pairs: Sequence[MatchedPair],
    behind: bool,
    transfer: Transfer,
    limit: float | None,
    error_label: str,
    view: View,
    page: Page,
) -> Figure:
    """Check everything, draw the pictures of each row, set the page."""
    maps = [pair.checked_map() for pair in pairs]
    errors = [pair.checked_errors() for pair in pairs]
    known = np.concatenate([e[np.isfinite(e)] for e in errors if e is not None] or [np.zeros(0)])
    if limit is None:
        limit = (float(np.percentile(known, _PERCENTILE)) if len(known) else 0.0) or 1.0
    check_positive("limit", limit)
    scenes = [
        scene
        for pair, p, e in zip(pairs, maps, errors, strict=True)
        for scene in _scenes(
            pair, p, e, limit, page.dpi, view.rotation(pair.source), behind, transfer
        )
    ]
    drawn = render(scenes)
    other = "other side" if transfer == "colours" else "other side, mirrored"
    rows, sides = [], []
    for pair, source, target in zip(pairs, drawn[::2], drawn[1::2], strict=True):
        sides += ["one side", other] if behind else [pair.name]
        named = () if behind or pair.names == _HEADS else pair.names
        each = np.split(target, len(source))  # the pictures of one side follow each other
        for first, rest in zip(source, each, strict=True):
            lines = [(name,) for name in named] + [()] * 3
            rows.append(
                [Cell(picture=p, lines=t) for p, t in zip([first, *rest], lines, strict=False)]
            )
    if any(e is not None for e in errors):
        strip = error_colours(np.linspace(0.0, 1.0, 256), 1.0)
        last = max(i for i, row in enumerate(rows) if len(row) > 2)
        bar = Bar(colours=strip, ends=("0", short(limit)), label=error_label)
        rows[last][2] = replace(rows[last][2], bar=bar)
    heads = [*(pairs[0].names if behind else _HEADS), "error"][: max(map(len, rows))]
    return set_table(page, rows, heads=heads, names=sides, cell=_NARROWEST)


def _scenes(
    pair: MatchedPair,
    point_map: Ints,
    errors: Floats | None,
    limit: float,
    dpi: int,
    rotation: Floats,
    behind: bool,
    transfer: Transfer,
) -> tuple[Scene, Scene]:
    """Source, and target with the errors where there are any."""
    places = pair.source.points @ rotation.T
    low, high = places.min(axis=0), places.max(axis=0)

    def scene(geometry: Geometry, values: Floats) -> Scene:
        inches = fitting_size(geometry, rotation, _WIDEST, _TALLEST)
        width, height = (round(side * dpi) for side in inches)
        fine, values, normals = refined(geometry, values, width * height // _PIXELS[transfer])
        if transfer == "texture":
            colours = [texture_colours(values[:, :3], low, high)]
        else:
            colours = [position_colours(values[:, :3], low, high, squares=normals is not None)]
        if values.shape[1] > 3:
            colours.append(error_colours(values[:, 3], limit))
        return Scene(
            geometry=fine,
            functions=colours,
            rotation=rotation,
            width=width,
            normals=normals,
            behind=behind,
        )

    carried = places[point_map]
    on_target = carried if errors is None else np.column_stack([carried, errors])
    return scene(pair.source, places), scene(pair.target, on_target)
