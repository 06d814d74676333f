"""Colours of points: by position, to see where a map takes them, and by size of an error."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from string import ascii_uppercase
from typing import Any

import numpy as np

from spectra_kit._core.types import Bytes, Floats
from spectra_kit.geometry.shapes import Geometry, TriangleMesh

# Ends of the diverging colours in Oklab: as far from white, as dark and as strong as each other.
# Blue and vermilion stay apart for whoever lacks one kind of cone.
_DARK, _STRONG, _BLUE, _RED = 0.48, 0.175, 258.0, 28.0  # lightness, chroma, hues in degrees
_EARLY = 0.4  # chroma rises faster than the lightness falls: clear colours half way

# Of distances from near to far: lightness falls, hue (degrees) turns from yellow to violet.
_LIGHTNESS, _HUE, _CHROMA = (0.95, 0.56), (100.0, -75.0), (0.10, 0.13)

UNKNOWN = (205, 205, 205)  # of a point whose error, or partner, is not known

SQUARES = 9  # along the longer side
_PIXELS = 96  # of the chart, along the side of a square
_PALE, _DEEP = 0.9, 0.56  # lightness of the squares
_INK, _CHALK = "#26222c", "#ffffff"  # names on either
_CHECKS = 16  # along the longest side
_RELIEF = 0.035  # of the lightness, up and down between neighbouring squares
# Oklab (B. Ottosson, 2020) to linear sRGB.
_TO_LMS = np.array([[1, 0.3963377774, 0.2158037573], [1, -0.1055613458, -0.0638541728]])
_TO_LMS = np.vstack([_TO_LMS, [1, -0.0894841775, -1.2914855480]])
_TO_RGB = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)


def import_matplotlib() -> None:
    """Import Matplotlib, also where MPLBACKEND names a window system that is not installed here.

    A notebook sets that for all that it starts. Nothing here needs one, but Matplotlib refuses to
    be imported; where it can be, it is, and that backend is the one of whoever plots beside.
    """
    if "matplotlib" in sys.modules:
        return
    chosen = os.environ.pop("MPLBACKEND", None)
    try:
        import matplotlib as mpl
    finally:
        if chosen is not None:
            os.environ["MPLBACKEND"] = chosen
    if chosen:
        with suppress(ValueError):
            mpl.rcParams["backend"] = chosen


def diverging_colours(values: Floats) -> Bytes:
    """Colour values (n,) in [-1, 1], cut off there: blue to white at zero to red.

    Lightness (in Oklab) falls by equal steps on both sides, and equally far.
    """
    part = np.abs(np.clip(values, -1.0, 1.0))
    hue = np.deg2rad(np.where(values < 0, _BLUE, _RED))
    chroma = _STRONG * part * (1 + _EARLY * (1 - part))
    lightness = 1 - (1 - _DARK) * part
    return oklab_to_srgb(np.column_stack([lightness, chroma * np.cos(hue), chroma * np.sin(hue)]))


def sequential_colours(values: Floats) -> Bytes:
    """Colour values (n,) in [0, 1], cut off there: Matplotlib's viridis, dark to light."""
    return _mapped("viridis", np.clip(values, 0.0, 1.0))


def position_colours(positions: Floats, low: Floats, high: Floats, *, squares: bool) -> Bytes:
    """Colour positions (n, 3), to the right, up and near, in a box: distinct, and gradual.

    Blue to yellow from left to right and dark to light upwards, which most kinds of colour
    blindness leave apart; green to red towards the viewer. Faint `squares` show noise, and stretch.
    """
    side = np.maximum(high - low, 1e-300)
    right, up, near = np.clip(2 * (positions - low) / side - 1, -1.0, 1.0).T
    lightness = 0.72 + 0.15 * up
    if squares:
        cell = side.max() / _CHECKS
        parity = np.floor((positions - low) / cell).astype(np.int64).sum(axis=1) % 2
        lightness = lightness + _RELIEF * (2 * parity - 1)
    return oklab_to_srgb(np.column_stack([lightness, 0.13 * near, 0.15 * right]))


def error_colours(errors: Floats, limit: float) -> Bytes:
    """Colour errors (n,) from light at 0 to dark at `limit` and above; grey where NaN."""
    # The dark end of the map would swallow the shading of a lit surface.
    colours = _mapped("magma_r", 0.02 + 0.73 * np.clip(np.nan_to_num(errors / limit), 0.0, 1.0))
    colours[np.isnan(errors)] = UNKNOWN
    return colours


def with_grey(colours: Bytes, values: Floats) -> Bytes:
    """Colour values (n,) in [-1, 1] by the colours (c, 3) between; grey where NaN."""
    at = np.clip((np.nan_to_num(values) + 1) / 2, 0.0, 1.0) * (len(colours) - 1)
    found = colours[np.round(at).astype(np.int64)]
    found[np.isnan(values)] = UNKNOWN
    return found


def _mapped(name: str, part: Floats) -> Bytes:
    """Colours (n, 3) of Matplotlib at a part (n,) of the way through them."""
    import_matplotlib()
    from matplotlib import colormaps

    return np.array(colormaps[name](part, bytes=True))[..., :3]


def largest(distance: Floats) -> float:
    """Return the largest distance that is finite, where the colours end."""
    return float(distance[np.isfinite(distance)].max(initial=0.0)) or 1.0


def distance_colours(distance: Floats) -> Bytes:
    """Return the colours (n, 3) of distances (n,): light to dark; grey where infinite."""
    part = np.clip(distance / largest(distance), 0.0, 1.0)
    lightness, hue, chroma = (
        start + (end - start) * part for start, end in (_LIGHTNESS, np.deg2rad(_HUE), _CHROMA)
    )
    lab = np.column_stack([lightness, chroma * np.cos(hue), chroma * np.sin(hue)])
    return np.where(
        np.isfinite(distance)[:, None], oklab_to_srgb(lab), np.array(UNKNOWN, dtype=np.uint8)
    )


def refined(geometry: Geometry, values: Floats, n: int) -> tuple[Geometry, Floats, Floats | None]:
    """Split triangles into n vertices or more, with values and normals; a cloud stays as it is.

    Between vertices colours alone would blur; positions carried there keep a pattern sharp.
    """
    if not isinstance(geometry, TriangleMesh):
        return geometry, values, None
    import igl

    # Of a point without triangles there is none.
    around = np.nan_to_num(igl.per_vertex_normals(geometry.points, geometry.faces))
    rows, faces = np.hstack([geometry.points, around, values]), geometry.faces
    while len(rows) < n:
        rows, faces = igl.upsample(rows, faces, 1)
    points, normals, fine = np.split(rows, [3, 6], axis=1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    return TriangleMesh(points, faces), fine, normals


def oklab_to_srgb(lab: Floats) -> Bytes:
    """Oklab (n, 3) as sRGB bytes; what lies outside is cut off."""
    linear = np.clip((lab @ _TO_LMS.T) ** 3 @ _TO_RGB.T, 0.0, 1.0)
    gamma = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.asarray(np.round(255 * gamma), dtype=np.uint8)


def texture_colours(positions: Floats, low: Floats, high: Floats) -> Bytes:
    """Colour positions (n, 3) in a box by a chart that lies in the picture plane.

    Light and dark squares, named A1, B1, … from the lower left; bluer to the left and yellower to
    the right, greener below and redder above.
    """
    side = np.maximum(high - low, 1e-300)[:2]
    cell = side.max() / SQUARES
    columns, rows = (int(count) for count in np.maximum(np.ceil(side / cell - 1e-9), 1))
    chart: Bytes = named_squares(columns, rows)
    at = np.floor((positions[:, :2] - low[:2]) / cell * _PIXELS).astype(np.int64)
    across = np.clip(at[:, 0], 0, chart.shape[1] - 1)
    down = np.clip(chart.shape[0] - 1 - at[:, 1], 0, chart.shape[0] - 1)
    return np.asarray(chart[down, across])


def named_squares(columns: int, rows: int) -> Bytes:
    """Return the picture of a chart, upper row first."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    right, up = np.meshgrid(np.arange(columns), np.arange(rows)[::-1])
    dark = (right + up) % 2 == 1
    lab = np.stack(
        [
            np.where(dark, _DEEP, _PALE),
            0.10 * (2 * (up + 0.5) / rows - 1),
            0.12 * (2 * (right + 0.5) / columns - 1),
        ],
        axis=-1,
    )
    squares = oklab_to_srgb(lab.reshape(-1, 3)).reshape(rows, columns, 3)
    figure = Figure(figsize=(columns, rows), dpi=_PIXELS)
    canvas = FigureCanvasAgg(figure)
    figure.figimage(squares.repeat(_PIXELS, axis=0).repeat(_PIXELS, axis=1), origin="upper")
    for column in range(columns):
        for row in range(rows):
            figure.text(
                (column + 0.5) / columns,
                (row + 0.48) / rows,
                f"{ascii_uppercase[column]}{row + 1}",
                fontsize=38,
                fontweight="bold",
                color=_CHALK if (column + row) % 2 else _INK,
                ha="center",
                va="center",
            )
    drawn: Any = canvas
    drawn.draw()  # untyped in Matplotlib
    return np.array(drawn.buffer_rgba())[..., :3]
