"""Pictures of curves and of vectors on surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import as_array, check_count, check_points
from spectra_kit.errors import InvalidInputError
from spectra_kit.geodesics import SurfacePath
from spectra_kit.geometry.shapes import GeometryLike
from spectra_kit.geometry.vectors import unit_vectors
from spectra_kit.operators.checks import of_shape
from spectra_kit.show.camera import View
from spectra_kit.show.isolines import both_sides
from spectra_kit.show.layout import Page
from spectra_kit.show.picture import PathLike, plotted

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PLAIN = (214, 222, 235)  # the colour of the surface
_WIDTH, _FINE = 2.4, 1.1  # of a curve, of an arrow, in points (1/72 inch)
_HALVINGS = 12
_HEAD, _OPEN = 0.35, 0.5  # of an arrow: how long its head is, and how wide over that


@plotted
def plot_curves(
    geometry: GeometryLike,
    curves: Sequence[SurfacePath | ArrayLike],
    *,
    path: PathLike | None = None,
    view: View = View(),
    page: Page = Page(),
    marks: ArrayLike | None = None,
) -> Figure:
    """Draw curves on a surface, from two sides.

    Parameters
    ----------
    $geometry
    curves : sequence of SurfacePath or of arrays of shape (p, 3)
        Points that lines join.
    $path
    $view
    $page
    marks : array_like of shape (m, 3), optional
        Places to mark by black balls; by default both ends of each curve that is not closed.

    $returns

    Examples
    --------
    >>> import spectra_kit as sk
    >>> mesh = sk.geometry.sphere(subdivisions=2).geometry
    >>> ways = [sk.geodesic_path(mesh, 0, target) for target in (40, 80)]
    >>> sk.show.plot_curves(mesh, ways, page=sk.show.Page("Two paths", dpi=30))
    Picture(path=None)
    """
    lines = [
        check_points("curves", one.points if isinstance(one, SurfacePath) else one)
        for one in curves
    ]
    if not lines:
        raise InvalidInputError("curves", "hold at least one curve", "none")
    if marks is None:
        marks = [line[i] for line in lines if (line[0] != line[-1]).any() for i in (0, -1)]
    segments = [np.stack([line[:-1], line[1:]], axis=1) for line in lines]
    return both_sides(geometry, _PLAIN, np.concatenate(segments), _WIDTH, marks, view, page)


@plotted
def plot_vectors(
    geometry: GeometryLike,
    vectors: ArrayLike,
    *,
    path: PathLike | None = None,
    view: View = View(),
    page: Page = Page(),
    arrows: int = 400,
) -> Figure:
    """Draw a field of tangent vectors as arrows, from two sides.

    Parameters
    ----------
    $geometry
    vectors : array_like of shape (n, 3)
        One at each point; NaN is left out. The longest arrow is as long as arrows are apart.
    $path
    $view
    $page
    arrows : int, default 400
        How many, at points that are far from each other.

    $returns

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> mesh = sk.geometry.sphere(subdivisions=3).geometry
    >>> field = np.cross([0, 0, 1], mesh.points)
    >>> sk.show.plot_vectors(mesh, field, arrows=60, page=sk.show.Page("Around", dpi=30))
    Picture(path=None)
    """
    given = as_array("vectors", vectors)
    field = of_shape("vectors", np.where(given != given, 0, given), geometry.points.shape)
    some, apart = _spread(geometry.points, check_count("arrows", arrows, low=1))
    some = some[field[some].any(axis=1)]
    start, along = geometry.points[some], field[some]
    along = along * (apart / (np.linalg.norm(along, axis=1).max(initial=0.0) or 1.0))
    across = np.cross(view.rotation(geometry)[2], along)  # in the picture
    size = np.linalg.norm(along, axis=1, keepdims=True)
    sideways, tip = _OPEN * size * unit_vectors(across), start + along
    barbs = [tip - _HEAD * (along + way * sideways) for way in (-1, 1)]
    segments = [np.stack(ends, axis=1) for ends in ((start, tip), (tip, barbs[0]), (tip, barbs[1]))]
    return both_sides(geometry, _PLAIN, np.concatenate(segments), _FINE, (), view, page)


def _spread(points: Floats, count: int) -> tuple[Ints, float]:
    """Return the first point in each of about `count` cells of space, and the size of these."""
    size = float(np.ptp(points, axis=0).max()) or 1.0
    low, high = size / len(points), size
    for _ in range(_HALVINGS):
        middle = np.sqrt(low * high)
        cells = np.floor((points - points.min(axis=0)) / middle)
        some = np.unique(cells, axis=0, return_index=True)[1]
        low, high = (middle, high) if len(some) > count else (low, middle)
    return some, float(middle)
