"""Heat and wave kernel signatures: curves of chosen points, and pictures of all at some scales."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from string import ascii_lowercase
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spectra_kit._core.types import Bytes, Floats, Ints
from spectra_kit._core.validate import check_indices, real_array
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import Geometry, GeometryLike
from spectra_kit.show.camera import View, fitting_size
from spectra_kit.show.fields import Panel, sequential_limits
from spectra_kit.show.layout import (
    LINE_COLOURS,
    MARGIN,
    Canvas,
    Cell,
    Page,
    line_style,
    log_ticks,
    set_table,
    short,
    tidy,
)
from spectra_kit.show.picture import PathLike, plotted
from spectra_kit.show.render import Scene, ball_diameter, render, with_balls

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Kind = Literal["heat", "wave"]

_PICTURES = 4  # by default
_BALL = 0.017  # of the diagonal: radius of a mark
_RED = 60  # more red than green: a lit red ball
# Inches.
_CURVES, _HEIGHT, _FOOT, _HEAD, _SIDE, _GAP = 5.0, 4.4, 0.55, 0.28, 0.75, 0.3
_WIDEST, _TALLEST = 2.7, 2.6
_NARROWEST = 1.8  # of a picture with its caption


@plotted
def plot_signatures(
    geometry: GeometryLike,
    signature: ArrayLike,
    scales: ArrayLike,
    *,
    path: PathLike | None = None,
    view: View = View(),
    page: Page = Page(),
    points: ArrayLike,
    kind: Kind = "heat",
    shown: ArrayLike | None = None,
) -> Figure:
    """Draw how a signature of some points changes with the scale, and all points at some scales.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        With n points.
    signature : array_like of shape (n, t)
        In 1/length^2, of every point at every scale: `heat_kernel_signature` or
        `wave_kernel_signature`.
    scales : array_like of shape (t,)
        Ascending, two or more: times in length^2, or energies (logarithms of eigenvalues).
    $path
    $view
    $page
    points : array_like of shape (p,)
        Indices of one to nine points: each gets a curve, and a ball of its colour in the pictures.
    kind : {"heat", "wave"}, default "heat"
        Whether the scales are times or energies; times, and the heat, are drawn on logarithmic
        axes.
    shown : array_like of shape (s,), optional
        Which scales to draw on the geometry, as one to nine indices; by default four, evenly
        spread.

    $returns

    Notes
    -----
    Each picture has its own colours, cut off where the highest and the lowest hundredth of the
    points begin. The grey band holds nine tenths of all points.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> from spectra_kit.show import Page, plot_signatures
    >>> mesh = sk.geometry.sphere(subdivisions=2).geometry
    >>> spectrum = sk.eigensolve(sk.robust_laplacian(mesh), 9)
    >>> times = sk.features.heat_times(spectrum, 8)
    >>> hks = sk.features.heat_kernel_signature(spectrum, times)
    >>> plot_signatures(mesh, hks, times, points=[0, 7], page=Page(dpi=30))
    Picture(path=None)
    """
    at = _check_scales(scales, kind)
    values = real_array("signature", signature)
    if values.shape != (geometry.n, len(at)):
        raise InvalidInputError(
            "signature", f"have shape ({geometry.n}, {len(at)}), points by scales", values.shape
        )
    chosen = _few("points", points, geometry.n)
    if shown is None:
        shown = np.linspace(0, len(at) - 1, _PICTURES + 2).astype(int)[1:-1]
    drawn = _few("shown", np.unique(shown), len(at))
    panels = []
    for letter, i in zip(ascii_lowercase, drawn, strict=False):
        low, high = sequential_limits(values[:, i])
        told = f"t = {short(at[i])}" if kind == "heat" else f"energy {at[i]:.2f}"
        panels.append(
            Panel(values=values[:, i], low=low, limit=high, lines=(f"{letter}   {told}",))
        )
    pictures, seen = _pictures(geometry, panels, chosen, view.rotation(geometry), page.dpi)
    cells = [
        Cell(picture=picture, lines=panel.lines, bar=panel.bar())
        for panel, picture in zip(panels, pictures, strict=True)
    ]
    figure = set_table(
        page,
        [cells[i : i + 2] for i in range(0, len(cells), 2)],
        cell=_NARROWEST,
        left=_SIDE + _CURVES + _GAP,
        tall=_HEIGHT,
    )
    canvas, below = Canvas(figure), MARGIN + _FOOT
    box = (MARGIN + _SIDE, below, _CURVES, figure.get_figheight() - page.head - below - _HEAD)
    axes = figure.add_axes(tuple(np.array(box) / ([canvas.width, canvas.height] * 2)))
    named = {
        f"point {i}" + ("" if there else " (hidden)"): i
        for i, there in zip(chosen, seen, strict=True)
    }
    draw_curves(axes, values, at, named, drawn, kind)
    return figure


def draw_curves(
    axes: Axes,
    values: Floats,
    scales: Floats,
    points: Mapping[str, int],
    shown: Ints,
    kind: Kind,
) -> None:
    """Draw a curve for each point, the range of all points behind, and which scales are shown."""
    low, high = np.percentile(values, (5, 95), axis=0)
    axes.fill_between(scales, low, high, color="0.88", lw=0, label="90 % of all points")
    for i, (name, point) in enumerate(points.items()):
        colour, dashes = line_style(i)
        axes.plot(scales, values[point], color=colour, ls=dashes, lw=1.8, label=name)
    for letter, at in zip(ascii_lowercase, scales[shown], strict=False):
        axes.axvline(at, color="0.55", lw=0.8, ls=":", zorder=0)
        above: dict[str, Any] = {"xycoords": axes.get_xaxis_transform(), "ha": "center"}
        axes.annotate(letter, (at, 1), (0, 3), textcoords="offset points", fontsize=9.5, **above)
    if kind == "heat":
        axes.set(xscale="log", yscale="log", xlabel="time t  [length²]")
        axes.set_ylabel("heat kernel signature  [1/length²]")
        log_ticks(axes.xaxis, plain=True)
        log_ticks(axes.yaxis)
    else:
        axes.set(xlabel="energy log λ", ylabel="wave kernel signature  [1/length²]")
    axes.margins(x=0.02)
    tidy(axes)
    axes.legend(frameon=False, fontsize=9)


def _pictures(
    geometry: Geometry, panels: Sequence[Panel], points: Ints, rotation: Floats, dpi: int
) -> tuple[Bytes, NDArray[np.bool_]]:
    """Draw the fields with balls of the colours of their curves; tell which balls can be seen."""
    radius = _BALL * float(np.linalg.norm(np.ptp(geometry.points, axis=0)))
    centres = geometry.points[points]
    # A larger white ball a little further back makes a rim around each.
    rims = centres - 0.75 * radius * rotation[2]
    marked, rim = with_balls(geometry, rims, 1.35 * radius)
    marked, ball = with_balls(marked, centres, radius)
    red = np.array([255, 0, 0], dtype=np.uint8)
    inks = [tuple(bytes.fromhex(line_style(i)[0][1:])) for i in range(len(points))]
    own = np.array(inks, dtype=np.uint8)[ball[ball >= 0]]
    white = np.full((np.count_nonzero(rim >= 0), 3), 255, dtype=np.uint8)
    scene = Scene(
        geometry=marked,
        functions=[
            *(np.vstack([_coloured(panel), white, own]) for panel in panels),
            *(np.where(ball[:, None] == i, red, 0 * red) for i in range(len(points))),
        ],
        rotation=rotation,
        diameter=ball_diameter(geometry),
        width=round(fitting_size(geometry, rotation, _WIDEST, _TALLEST)[0] * dpi),
    )
    (pictures,) = render([scene])
    excess = pictures[len(panels) :, ..., 0].astype(int) - pictures[len(panels) :, ..., 1]
    disc = np.pi * (radius * scene.width / np.ptp(marked.points @ rotation[0])) ** 2
    seen = np.count_nonzero(excess > _RED, axis=(1, 2)) > disc / 4  # more than through a gap
    return pictures[: len(panels)], seen


def _coloured(panel: Panel) -> Bytes:
    """Colours (n, 3) of a field."""
    table = panel.colours(1024)
    part = np.clip((panel.scaled() + 1) / 2, 0.0, 1.0)
    return np.asarray(table[np.round(part * (len(table) - 1)).astype(int)])


def _few(name: str, indices: ArrayLike, n: int) -> Ints:
    """Return one to nine different indices."""
    array, most = check_indices(name, indices, n), len(LINE_COLOURS)
    if array.ndim != 1 or not 1 <= len(array) <= most or len(np.unique(array)) < len(array):
        raise InvalidInputError(name, f"be one to {most} different indices", array.tolist())
    return array


def _check_scales(scales: ArrayLike, kind: Kind) -> Floats:
    at = real_array("scales", scales)
    if at.ndim != 1 or len(at) < 2 or (np.diff(at) <= 0).any():
        raise InvalidInputError("scales", "be two or more ascending numbers", f"shape {at.shape}")
    if kind == "heat" and at[0] <= 0:
        raise InvalidInputError(
            "scales", "be positive times", f"{at[0]:.3g}", advice="say kind='wave' for energies"
        )
    return at
