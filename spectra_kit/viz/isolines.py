"""Pictures of distances: colours with evenly spaced lines, as on a map."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spectra_kit._checked import checked
from spectra_kit._types import Bytes, Floats
from spectra_kit._validate import check_points
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import Geometry, TriangleMesh
from spectra_kit.viz.camera import Up, choose_view, fitting_size
from spectra_kit.viz.distance_scale import EVERY, Scale, distance_scale
from spectra_kit.viz.marks import with_balls
from spectra_kit.viz.pen import Pen
from spectra_kit.viz.picture import Picture
from spectra_kit.viz.render import Scene, render
from spectra_kit.viz.sheet import MARGIN, check_picture, head, new_figure, save

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_BALL = 0.07  # radius of the mark of a source, inches

# Inches.
_WIDEST, _TALLEST = 4.6, 4.6
_GAP, _BAR, _THICKNESS = 0.3, 0.75, 0.13


@checked
def plot_distance(
    path: str | os.PathLike[str],
    geometry: Geometry,
    distance: ArrayLike,
    *,
    sources: ArrayLike | None = None,
    spacing: float | None = None,
    up: Up | None = None,
    turn: float = 0.0,
    label: str = "distance",
    title: str = "",
    subtitle: str = "",
    dpi: int = 200,
) -> Picture:
    """Draw distances on a geometry in colours with evenly spaced lines, from two sides.

    Parameters
    ----------
    path : path-like
        The ``.png``, ``.pdf`` or ``.svg`` file to write, whole or not at all.
    geometry : TriangleMesh or PointCloud
        A cloud is drawn as balls that overlap a little, in bands instead of lines.
    distance : array_like of shape (n,)
        In the unit of length, >= 0; infinity is drawn in grey.
    sources : array_like of shape (s, 3), optional
        Places to mark by black balls.
    spacing : float, optional
        Between two lines, in the unit of length; by default a round number that makes 20 to 40.
    up : {"x", "y", "z"}, optional
        The axis that points up in the picture; by default the one the geometry seems to stand on.
    turn : float, default 0
        Degrees to turn the geometry about that axis, from the view chosen: its front goes right.
    label : str, default "distance"
        Set below the scale.
    title, subtitle : str, optional
        Two lines at the head of the page.
    dpi : int, default 200
        Pixels per inch; the page is at most 10 inches wide.

    Returns
    -------
    Picture
        Of the file written.

    Raises
    ------
    InvalidInputError
        If `distance` does not fit the geometry, is negative or NaN, `spacing` would make more than
        200 lines, or `path` cannot be written.
    MissingDependencyError
        If there is no PyVista, or no OpenGL library that it can draw with.

    Notes
    -----
    A function that is linear on triangles is coloured pixel by pixel, so lines are sharp on
    coarse meshes too; they are drawn on the surface and narrow where it turns away. Every fifth
    is thicker.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> from spectra_kit.geometry import sphere
    >>> from spectra_kit.viz import plot_distance
    >>> ball = sphere(subdivisions=2).geometry
    >>> distance = np.arccos(np.clip(ball.points @ ball.points[0], -1, 1))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     plot_distance(f"{folder}/distance.png", ball, distance, dpi=30).path.name
    'distance.png'
    """
    check_picture(path, dpi)
    values = _check_distance(distance, geometry.n)
    marks = np.empty((0, 3)) if sources is None else check_points("sources", sources)
    rotation = choose_view(geometry, up=up, turn=turn)
    across, tall = fitting_size(geometry, rotation, _WIDEST, _TALLEST)
    unit = float(np.ptp(geometry.points @ rotation.T, axis=0)[:2].max()) / max(across, tall)
    scale = distance_scale(
        values, spacing=spacing, inch=unit, dpi=dpi, lines=isinstance(geometry, TriangleMesh)
    )
    drawn, where = _torn(geometry, np.isfinite(values))
    drawn, ball = with_balls(drawn, marks, _BALL * unit)
    coded = np.append(scale.values(values[where]), np.full(np.count_nonzero(ball >= 0), scale.mark))
    (pictures,) = render(
        [
            Scene(
                geometry=drawn,
                functions=[coded],
                rotation=rotation,
                width=round(across * dpi),
                colours=scale.table,
                behind=True,
            )
        ]
    )
    caption = f"{label}, {'a line every' if scale.lines else 'bands of'} {scale.spacing:.4g}"
    caption += " · grey: not reached" * bool(np.isinf(values).any())
    caption += " · black balls: the sources" * bool(len(marks))
    return save(_set_page(list(pictures), scale, caption, title, subtitle, dpi), path, dpi)


def _check_distance(distance: ArrayLike, n: int) -> Floats:
    values = np.asarray(distance, dtype=np.float64)
    if values.shape != (n,) or np.isnan(values).any() or (values < 0).any():
        raise InvalidInputError(
            f"`distance` must have shape ({n},), one number >= 0 or infinity for each point, got"
            f" shape {values.shape} with {int(np.isnan(values).sum())} NaN and"
            f" {int((values < 0).sum())} negative"
        )
    return values


def _torn(geometry: Geometry, reached: NDArray[np.bool_]) -> tuple[Geometry, NDArray[np.intp]]:
    """Part faces that reach into the unknown from the others; return which point each was.

    Between a number and infinity there is nothing to interpolate.
    """
    everything = np.arange(geometry.n)
    if not isinstance(geometry, TriangleMesh):
        return geometry, everything
    mixed = ~reached[geometry.faces].all(axis=1) & reached[geometry.faces].any(axis=1)
    if not mixed.any():
        return geometry, everything
    beyond = int(np.flatnonzero(~reached)[0])
    faces = np.array(geometry.faces)
    inner = np.unique(faces[mixed][reached[faces[mixed]]])
    copy = np.arange(geometry.n)
    copy[inner] = geometry.n + np.arange(len(inner))
    faces[mixed] = copy[faces[mixed]]
    points = np.vstack([geometry.points, geometry.points[inner]])
    return TriangleMesh(points, faces), np.append(everything, np.full(len(inner), beyond))


def _set_page(
    pictures: list[Bytes], scale: Scale, caption: str, title: str, subtitle: str, dpi: int
) -> Figure:
    """Place two pictures and the scale; everything is measured in inches from the top."""
    tall, wide = (side / dpi for side in pictures[0].shape[:2])
    stacked = wide > 2 * tall
    begin = head(title, subtitle)
    room = max(wide if stacked else 2 * wide + _GAP, 4.0)
    width = room + 2 * MARGIN
    height = begin + (2 * tall + _GAP if stacked else tall) + _BAR + MARGIN
    figure = new_figure(width, height, title=title, subtitle=subtitle, dpi=dpi)
    pen = Pen(figure)
    for i, picture in enumerate(pictures):
        left = (
            MARGIN + (room - wide) / 2 if stacked else width / 2 + (i - 1) * wide + (i - 0.5) * _GAP
        )
        pen.picture(picture, left, begin + (i * (tall + _GAP) if stacked else 0.0))
    _set_scale(pen, scale, caption, height - MARGIN - _BAR + 0.25)
    return figure


def _set_scale(pen: Pen, scale: Scale, caption: str, top: float) -> None:
    """Draw the colours from zero to the limit, numbers at the thick lines, and what they are."""
    length = 0.55 * (pen.width - 2 * MARGIN)
    left = (pen.width - length) / 2
    strip = scale.ramp
    columns = round(length * pen.dpi)
    sums = np.vstack([np.zeros(3), np.cumsum(strip, axis=0, dtype=np.float64)])
    ends = np.linspace(0, len(strip), columns + 1)
    means = np.diff([np.interp(ends, np.arange(len(sums)), c) for c in sums.T], axis=1)
    row = np.round(means.T * columns / len(strip)).astype(np.uint8)
    pen.picture(np.tile(row, (round(_THICKNESS * pen.dpi), 1, 1)), left, top)
    step = EVERY * scale.spacing
    for i in range(int(scale.limit / step) + 1):
        at = left + length * i * step / scale.limit
        pen.text(f"{i * step:.4g}", at - 0.4, top + _THICKNESS + 0.14, 0.8, 8, centred=True)
    pen.text(caption, left, top + _THICKNESS + 0.32, length, 8, centred=True, colour="0.4")
