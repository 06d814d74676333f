"""Pictures of many shapes on one page: as they are, or coloured by the classes of their points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.checked import checked
from spectra_kit._core.records import Brief
from spectra_kit._core.types import Bytes
from spectra_kit._core.validate import check_count, check_indices
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import Geometry
from spectra_kit.show.camera import View, fitting_size
from spectra_kit.show.colours import refined
from spectra_kit.show.layout import LINE_COLOURS, Cell, Page, set_table
from spectra_kit.show.picture import PathLike, plotted
from spectra_kit.show.render import Scene, render

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_WIDEST, _TALLEST = 2.2, 2.4  # inches of a picture
_CLASSES = 1 << 16
_PLAIN = (205, 205, 200)
_LIGHTER = 0.35  # towards white: shading must stay visible


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Thumbnail(Brief):
    """A shape, what its points are, and what to write above it.

    Attributes
    ----------
    geometry : TriangleMesh or PointCloud
        With n points.
    labels : array_like of shape (n,), integers, optional
        The class of each point; without, it is drawn in grey.
    lines : tuple of str
        Above the picture.
    """

    geometry: Geometry
    labels: Annotated[ArrayLike | None, tuple] = None
    lines: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.labels is None:
            return
        if np.shape(self.labels) != (self.geometry.n,):
            raise InvalidInputError(
                "labels", f"have shape ({self.geometry.n},)", np.shape(self.labels)
            )
        check_indices("labels", self.labels, _CLASSES)


@plotted
def plot_thumbnails(
    thumbnails: Sequence[Thumbnail],
    *,
    path: PathLike | None = None,
    columns: int = 4,
    view: View = View(),
    page: Page = Page(),
) -> Figure:
    """Draw shapes beside each other, each in its own size, coloured by the classes of its points.

    Parameters
    ----------
    thumbnails : sequence of Thumbnail
        At least one.
    $path
    columns : int, default 4
        How many stand beside each other.
    $view
    $page

    $returns

    Notes
    -----
    A class has the same colour on all; between two vertices of different ones it changes halfway.

    Examples
    --------
    >>> from spectra_kit.geometry import sphere
    >>> from spectra_kit.show import Page, Thumbnail, plot_thumbnails
    >>> ball = sphere(subdivisions=2).geometry
    >>> halves = Thumbnail(geometry=ball, labels=(ball.points[:, 2] > 0).astype(int))
    >>> plot_thumbnails([halves, Thumbnail(geometry=ball, lines=("plain",))], page=Page(dpi=30))
    Picture(path=None)
    """
    if not thumbnails:
        raise InvalidInputError("thumbnails", "hold at least one Thumbnail", "none")
    check_count("columns", columns, low=1)
    scenes = [_scene(thumbnail, view, page.dpi) for thumbnail in thumbnails]
    pictures = [drawn[0] for drawn in render(scenes)]
    cells = [
        Cell(picture=picture, lines=thumbnail.lines)
        for picture, thumbnail in zip(pictures, thumbnails, strict=True)
    ]
    rows = [cells[start : start + columns] for start in range(0, len(cells), columns)]
    return set_table(page, rows, cell=_WIDEST)


def _scene(thumbnail: Thumbnail, view: View, dpi: int) -> Scene:
    geometry = thumbnail.geometry
    labels = np.zeros(geometry.n, dtype=np.int64)
    palette = np.array([_PLAIN], dtype=np.uint8)
    if thumbnail.labels is not None:
        labels = check_indices("labels", thumbnail.labels, _CLASSES)
        present, labels = np.unique(labels, return_inverse=True)
        palette = _palette(int(present[-1]) + 1)[present]
    rotation = view.rotation(geometry)
    width, height = (
        round(side * dpi) for side in fitting_size(geometry, rotation, _WIDEST, _TALLEST)
    )
    shares = np.eye(len(palette))[labels]
    # A vertex to each pixel: borders of classes run through triangles.
    fine, shares, normals = refined(geometry, shares, width * height)
    colours = palette[shares.argmax(axis=1)]
    return Scene(
        geometry=fine, functions=[colours], rotation=rotation, width=width, normals=normals
    )


def _palette(count: int) -> Bytes:
    """Return colours (count, 3) that every eye tells apart, as far as there are such."""
    known = [[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in LINE_COLOURS if c != "#000000"]
    numbers = np.arange(count)
    colours = np.array(known, dtype=np.float64)[numbers % len(known)]
    lighter = _LIGHTER + 0.3 * (numbers // len(known) % 3)[:, None] / 2  # of the next rounds
    return np.asarray(np.round(colours + lighter * (255 - colours)), dtype=np.uint8)
