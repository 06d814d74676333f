"""Pictures of maps: colours carried over, and the error there; matrices, and curves of errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.checked import checked
from spectra_kit._core.records import Brief
from spectra_kit._core.types import Bools, Floats, Ints
from spectra_kit._core.validate import check_indices, check_positive, real_array
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import Geometry, GeometryLike
from spectra_kit.maps import MapErrors, accuracy_curve, auc
from spectra_kit.show.camera import View, fitting_size
from spectra_kit.show.colours import (
    UNKNOWN,
    diverging_colours,
    error_colours,
    position_colours,
    refined,
    texture_colours,
)
from spectra_kit.show.layout import (
    Bar,
    Cell,
    Page,
    line_style,
    new_diagram,
    set_table,
    short,
    tidy,
)
from spectra_kit.show.picture import PathLike, plotted
from spectra_kit.show.render import Scene, render

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Transfer = Literal["colours", "texture"]

_WIDEST, _TALLEST, _NARROWEST = 3.4, 3.6, 2.2  # inches of a picture, and of a column
_PIXELS = {"colours": 4, "texture": 1}  # to a vertex: a pattern inside triangles looks sharp
_HEADS = ("source", "target")
_PERCENTILE = 99.0  # a lone outlier must not bleach the rest


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class MatchedPair(Brief):
    """Two geometries, a map between them, and what to write beside their pictures.

    Attributes
    ----------
    source, target : TriangleMesh or PointCloud
        With n1 and n2 points.
    point_map : array_like of shape (n2,), integers
        The source point of each target point.
    errors : MapErrors, optional
        Of the map, which say at which target points they are.
    covered : ndarray of bool of shape (n2,), optional
        Which target points have a partner, where the source is a part; the others are grey.
    name : str
        Set beside the row, reading upwards.
    names : tuple of str
        What to call the two.
    """

    source: Geometry
    target: Geometry
    point_map: ArrayLike
    errors: MapErrors | None = None
    covered: Bools | None = None
    name: str = ""
    names: tuple[str, str] = ("source", "target")

    def __post_init__(self) -> None:
        expected = f"have shape ({self.target.n},), one for each target point"
        if self.covered is not None and np.shape(self.covered) != (self.target.n,):
            raise InvalidInputError("covered", expected, np.shape(self.covered))

    def checked_map(self) -> Ints:
        """Return the point map if it fits the two geometries."""
        n = self.target.n
        if np.shape(self.point_map) != (n,):
            raise InvalidInputError(
                "point_map",
                f"have shape ({n},), a source point for each target point",
                np.shape(self.point_map),
                advice="are source and target exchanged?",
            )
        return check_indices("point_map", self.point_map, self.source.n)

    def checked_errors(self) -> Floats | None:
        """Return the errors at each target point, (n2,), NaN where not known."""
        return None if self.errors is None else self.errors.at_points(self.target.n)


@plotted
def plot_correspondence(
    source: GeometryLike,
    target: GeometryLike,
    point_map: ArrayLike,
    *,
    path: PathLike | None = None,
    view: View = View(),
    page: Page = Page(),
    errors: MapErrors | None = None,
    covered: Bools | None = None,
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
        With n1 and n2 points. A cloud is drawn as balls.
    point_map : array_like of shape (n2,), integers
        The source point of each target point.
    $path
    $view
    $page
    errors : MapErrors, optional
        Of the map, drawn in a third column at the target points that they are of; those of a mesh
        are made by `maps.map_errors`.
    covered : ndarray of bool of shape (n2,), optional
        Which target points have a partner (`Match.covered`, of parts); the others are grey.
    transfer : {"colours", "texture"}, default "colours"
        What the map carries: gradual colours, or a chart of named squares.
    limit : float, optional
        The error at the dark end of the colours; by default the 99th percentile.
    $error_label
    names : tuple of str, default ("source", "target")
        What to call the two.

    $returns

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
    >>> from spectra_kit.show import Page, plot_correspondence
    >>> source, target, point_map = creature_pair(600)
    >>> plot_correspondence(source, target, point_map, page=Page(dpi=30))
    Picture(path=None)
    """
    pair = MatchedPair(
        source=source,
        target=target,
        point_map=point_map,
        errors=errors,
        covered=covered,
        names=names,
    )
    return _draw([pair], True, transfer, limit, error_label, view, page)


@plotted
def plot_correspondences(
    pairs: Sequence[MatchedPair],
    *,
    path: PathLike | None = None,
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
    $path
    $view
    $page
    transfer : {"colours", "texture"}, default "colours"
        As in `plot_correspondence`.
    limit : float, optional
        The error at the dark end of the colours, for all.
    $error_label

    $returns

    Examples
    --------
    >>> from spectra_kit.geometry import creature_pair
    >>> from spectra_kit.show import MatchedPair, Page, plot_correspondences
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
    scenes = []
    for pair, point_map, error in zip(pairs, maps, errors, strict=True):
        rotation = view.rotation(pair.source)
        places = pair.source.points @ rotation.T
        box = places.min(axis=0), places.max(axis=0)
        carried = places[point_map]
        if pair.covered is not None:
            carried[np.logical_not(pair.covered)] = np.nan
        if error is not None:
            carried = np.column_stack([carried, error])
        for geometry, values in ((pair.source, places), (pair.target, carried)):
            scene = _scene(geometry, values, box, limit, rotation, page.dpi, transfer)
            scenes.append(replace(scene, behind=behind))
    drawn = render(scenes)
    other = "other side" if transfer == "colours" else "other side, mirrored"
    rows, sides = [], []
    for pair, source, target in zip(pairs, drawn[::2], drawn[1::2], strict=True):
        sides += ["one side", other] if behind else [pair.name]
        named = () if behind or pair.names == _HEADS else pair.names
        lines = [(name,) for name in named] + [()] * 3
        each = np.split(target, len(source))  # the pictures of one side follow each other
        for first, rest in zip(source, each, strict=True):
            pictures = zip([first, *rest], lines, strict=False)
            rows.append([Cell(picture=picture, lines=told) for picture, told in pictures])
    if any(error is not None for error in errors):
        strip = error_colours(np.linspace(0.0, 1.0, 256), 1.0)
        last = max(i for i, row in enumerate(rows) if len(row) > 2)
        bar = Bar(colours=strip, ends=("0", short(limit)), label=error_label)
        rows[last][2] = replace(rows[last][2], bar=bar)
    heads = [*(pairs[0].names if behind else _HEADS), "error"][: max(map(len, rows))]
    return set_table(page, rows, heads=heads, names=sides, cell=_NARROWEST)


def _scene(
    geometry: Geometry,
    values: Floats,
    box: tuple[Floats, Floats],
    limit: float,
    rotation: Floats,
    dpi: int,
    transfer: Transfer,
) -> Scene:
    """Colour by `values` (n, 3), places in the box; by errors, too, which are a fourth column.

    What has no place is grey.
    """
    inches = fitting_size(geometry, rotation, _WIDEST, _TALLEST)
    width, height = (round(side * dpi) for side in inches)
    fine, values, normals = refined(geometry, values, width * height // _PIXELS[transfer])
    places = np.nan_to_num(values[:, :3])
    if transfer == "texture":
        colours = [texture_colours(places, *box)]
    else:
        colours = [position_colours(places, *box, squares=normals is not None)]
    colours[0][np.isnan(values[:, 0])] = UNKNOWN
    if values.shape[1] > 3:
        colours.append(error_colours(values[:, 3], limit))
    return Scene(geometry=fine, functions=colours, rotation=rotation, width=width, normals=normals)


@plotted
def plot_functional_map(
    functional_map: ArrayLike,
    *,
    path: PathLike | None = None,
    page: Page = Page(),
) -> Figure:
    """Draw the matrix of a functional map.

    Parameters
    ----------
    functional_map : array_like of shape (k2, k1)
        C_12, from the source's modes (columns) to the target's (rows).
    $path
    $page

    $returns

    Notes
    -----
    Between isometric surfaces it is orthogonal, and diagonal with entries of modulus 1 where the
    eigenvalues are simple; a wide band about the diagonal tells of stretch. Colours run from -1 to
    1 for spectra at unit area.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.show import Page, plot_functional_map
    >>> plot_functional_map(np.eye(20), page=Page(dpi=40))
    Picture(path=None)
    """
    from matplotlib.colors import ListedColormap

    matrix = real_array("functional_map", functional_map)
    if matrix.ndim != 2 or not matrix.size:
        raise InvalidInputError("functional_map", "have shape (k2, k1)", matrix.shape)
    rows, columns = matrix.shape
    figure = new_diagram(page, 5.8, float(np.clip(4.4 * rows / columns, 1.5, 9.0)) + 0.5)
    panel = figure.add_subplot()
    colours = ListedColormap(diverging_colours(np.linspace(-1.0, 1.0, 255)) / 255)
    image = panel.imshow(matrix, cmap=colours, vmin=-1, vmax=1, interpolation="none")
    panel.set(xlabel="mode of the source", ylabel="mode of the target")
    figure.colorbar(image, ax=panel, shrink=0.6, aspect=30, ticks=[-1, 0, 1])
    return figure


@plotted
def plot_error_curves(
    errors: Mapping[str, ArrayLike],
    *,
    path: PathLike | None = None,
    page: Page = Page(),
    limit: float = 10.0,
    error_label: str = "geodesic error, 100 / √area",
) -> Figure:
    """Draw which share of the correspondences has at most which error.

    Parameters
    ----------
    errors : mapping of str to array_like of shape (c,)
        For each method its errors, >= 0, of all pairs together.
    $path
    $page
    limit : float, default 10
        The largest error shown, in the unit of `errors`.
    $error_label

    $returns

    Notes
    -----
    The legend gives the mean of each method and the area under its curve, relative to a perfect
    one's.

    Examples
    --------
    >>> from spectra_kit.show import plot_error_curves
    >>> plot_error_curves({"a": [0.0, 2.5], "b": [8.0]})
    Picture(path=None)
    """
    limit = check_positive("limit", limit)
    if not errors:
        raise InvalidInputError("errors", "hold at least one method", "none")
    at = np.linspace(0.0, limit, 401)
    curves = {name: accuracy_curve(values, at) for name, values in errors.items()}
    figure = new_diagram(page, 6.4, 4.6)
    panel = figure.add_subplot()
    for i, (name, curve) in enumerate(curves.items()):
        values = np.asarray(errors[name], dtype=np.float64)
        colour, dashes = line_style(i)
        text = f"{name}: mean {values.mean():.2f}, AUC {auc(values, limit=limit):.3f}"
        panel.plot(at, 100 * curve, color=colour, ls=dashes, lw=1.8, label=text)
    panel.set(
        xlabel=error_label, ylabel="share of correspondences [%]", xlim=(0, limit), ylim=(0, 101)
    )
    tidy(panel)
    panel.legend(frameon=False, loc="lower right", fontsize=9)
    return figure
