"""Pictures of point maps: the colours of the source carried to the target, and the error there."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._checked import checked
from spectra_kit._types import Floats, Ints
from spectra_kit._validate import check_positive
from spectra_kit.correspondence import MapErrors
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import Geometry
from spectra_kit.viz.camera import Up, choose_view, fitting_size
from spectra_kit.viz.colours import error_colours, position_colours, refined
from spectra_kit.viz.matched_pair import MatchedPair
from spectra_kit.viz.picture import Picture
from spectra_kit.viz.render import Scene, render
from spectra_kit.viz.rows import Row, set_rows
from spectra_kit.viz.sheet import check_picture, save
from spectra_kit.viz.texture import texture_colours

Transfer = Literal["colours", "texture"]

_WIDEST, _TALLEST = 3.4, 3.6  # inches of a picture
_PIXELS = {"colours": 4, "texture": 1}  # to a vertex: a pattern inside triangles looks sharp
_HEADS = ("source", "target")
_PERCENTILE = 99.0  # a lone outlier must not bleach the rest


@checked
def plot_correspondence(
    path: str | os.PathLike[str],
    source: Geometry,
    target: Geometry,
    point_map: ArrayLike,
    *,
    errors: MapErrors | None = None,
    transfer: Transfer = "colours",
    up: Up | None = None,
    turn: float = 0.0,
    limit: float | None = None,
    error_label: str = "geodesic error, 100 / √area",
    names: tuple[str, str] = ("source", "target"),
    title: str = "",
    subtitle: str = "",
    dpi: int = 200,
) -> Picture:
    """Draw the source in colours, and the target in those that a point map gives it.

    Both are seen from the same side, and below from the other side.

    Parameters
    ----------
    path : path-like
        The ``.png``, ``.pdf`` or ``.svg`` file to write, whole or not at all.
    source, target : TriangleMesh or PointCloud
        With n1 and n2 points. A cloud is drawn as balls that overlap a little.
    point_map : array_like of shape (n2,), integers
        The source point of each target point.
    errors : MapErrors, optional
        Of the map, drawn in a third column at the target points that they are of; those of a mesh
        are made by `correspondence.map_errors`.
    transfer : {"colours", "texture"}, default "colours"
        What the map carries: gradual colours, or a chart of named squares.
    up : {"x", "y", "z"}, optional
        The axis of the source that points up in the picture; by default the one it seems to stand
        on.
    turn : float, default 0
        Degrees to turn the geometry about that axis, from the view chosen: its front goes right.
    limit : float, optional
        The error at the dark end of the colours; by default the 99th percentile.
    error_label : str
        Says what the errors are, and in which unit.
    names : tuple of str, default ("source", "target")
        What to call the two.
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
        If `point_map` or `errors` does not fit the geometries, or `path` cannot be written.
    MissingDependencyError
        If there is no PyVista, or no OpenGL library that it can draw with.

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
    >>> import tempfile
    >>> from spectra_kit.geometry import creature_pair
    >>> from spectra_kit.viz import plot_correspondence
    >>> source, target, point_map = creature_pair(600)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     plot_correspondence(f"{folder}/map.png", source, target, point_map, dpi=30).path.name
    'map.png'
    """
    pair = MatchedPair(
        source=source, target=target, point_map=point_map, errors=errors, names=names
    )
    return _draw(path, [pair], True, transfer, up, turn, limit, error_label, title, subtitle, dpi)


@checked
def plot_correspondences(
    path: str | os.PathLike[str],
    pairs: Sequence[MatchedPair],
    *,
    transfer: Transfer = "colours",
    up: Up | None = None,
    turn: float = 0.0,
    limit: float | None = None,
    error_label: str = "geodesic error, 100 / √area",
    title: str = "",
    subtitle: str = "",
    dpi: int = 200,
) -> Picture:
    """Draw several matched pairs, one row each, from one side.

    Parameters
    ----------
    path : path-like
        The ``.png``, ``.pdf`` or ``.svg`` file to write, whole or not at all.
    pairs : sequence of MatchedPair
        At least one. If one has errors, all share their colour scale.
    transfer : {"colours", "texture"}, default "colours"
        As in `plot_correspondence`.
    up : {"x", "y", "z"}, optional
        As in `plot_correspondence`.
    turn : float, default 0
        As in `plot_correspondence`.
    limit : float, optional
        The error at the dark end of the colours, for all.
    error_label : str
        Says what the errors are, and in which unit.
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
        As in `plot_correspondence`, or if there is no pair.

    Examples
    --------
    >>> import tempfile
    >>> from spectra_kit.geometry import creature_pair
    >>> from spectra_kit.viz import MatchedPair, plot_correspondences
    >>> source, target, point_map = creature_pair(600)
    >>> pair = MatchedPair(source=source, target=target, point_map=point_map, name="truth")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     plot_correspondences(f"{folder}/maps.png", [pair], dpi=30).path.name
    'maps.png'
    """
    if not pairs:
        raise InvalidInputError("`pairs` must hold at least one MatchedPair, got none")
    return _draw(path, pairs, False, transfer, up, turn, limit, error_label, title, subtitle, dpi)


def _draw(
    path: str | os.PathLike[str],
    pairs: Sequence[MatchedPair],
    behind: bool,
    transfer: Transfer,
    up: Up | None,
    turn: float,
    limit: float | None,
    error_label: str,
    title: str,
    subtitle: str,
    dpi: int,
) -> Picture:
    """Check everything, draw the pictures of each row, set the page."""
    check_picture(path, dpi)
    if transfer not in get_args(Transfer):
        raise InvalidInputError(f"`transfer` must be 'colours' or 'texture', got {transfer!r}")
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
            pair, p, e, limit, dpi, choose_view(pair.source, up=up, turn=turn), behind, transfer
        )
    ]
    drawn, rows = render(scenes), []
    other = "other side" if transfer == "colours" else "other side, mirrored"
    for pair, source, target in zip(pairs, drawn[::2], drawn[1::2], strict=True):
        sides = ("one side", other) if behind else (pair.name,)
        names = None if behind or pair.names == _HEADS else pair.names
        each = np.split(target, len(source))  # the pictures of one side follow each other
        rows += [
            Row(side, names, [first, *rest])
            for side, first, rest in zip(sides, source, each, strict=True)
        ]
    heads = [*(pairs[0].names if behind else _HEADS), "error"]
    bar = None if all(e is None for e in errors) else (limit, error_label)
    return save(set_rows(rows, heads, bar, title, subtitle, dpi), path, dpi)


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
