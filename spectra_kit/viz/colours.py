"""Colours of points: by position, to see where a map takes them, and by size of an error."""

from __future__ import annotations

import numpy as np

from spectra_kit._types import Bytes, Floats
from spectra_kit.geometry.shapes import Geometry, TriangleMesh

# Ends of the diverging colours in Oklab: as far from white, as dark and as strong as each other.
# Blue and vermilion stay apart for whoever lacks one kind of cone.
_DARK, _STRONG, _BLUE, _RED = 0.48, 0.175, 258.0, 28.0  # lightness, chroma, hues in degrees
_EARLY = 0.4  # chroma rises faster than the lightness falls: clear colours half way

UNKNOWN = (205, 205, 205)  # of a point whose error is not known

_SQUARES = 16  # along the longest side
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
    from matplotlib import colormaps

    return np.asarray(colormaps["viridis"](np.clip(values, 0.0, 1.0), bytes=True))[..., :3]


def position_colours(positions: Floats, low: Floats, high: Floats, *, squares: bool) -> Bytes:
    """Colour positions (n, 3), to the right, up and near, in a box: distinct, and gradual.

    Blue to yellow from left to right and dark to light upwards, which most kinds of colour
    blindness leave apart; green to red towards the viewer. Faint `squares` show noise, and stretch.
    """
    side = np.maximum(high - low, 1e-300)
    right, up, near = np.clip(2 * (positions - low) / side - 1, -1.0, 1.0).T
    lightness = 0.72 + 0.15 * up
    if squares:
        cell = side.max() / _SQUARES
        parity = np.floor((positions - low) / cell).astype(np.int64).sum(axis=1) % 2
        lightness = lightness + _RELIEF * (2 * parity - 1)
    return oklab_to_srgb(np.column_stack([lightness, 0.13 * near, 0.15 * right]))


def error_colours(errors: Floats, limit: float) -> Bytes:
    """Colour errors (n,) from light at 0 to dark at `limit` and above; grey where NaN."""
    from matplotlib import colormaps

    # The dark end of the map would swallow the shading of a lit surface.
    scaled = 0.02 + 0.73 * np.clip(np.nan_to_num(errors / limit), 0.0, 1.0)
    colours: Bytes = np.array(colormaps["magma_r"](scaled, bytes=True))[..., :3]
    colours[np.isnan(errors)] = UNKNOWN
    return colours


def refined(geometry: Geometry, values: Floats, n: int) -> tuple[Geometry, Floats, Floats | None]:
    """Split the triangles of a mesh into n vertices or more; interpolate values and normals.

    Between vertices colours alone would blur; positions carried there keep a pattern sharp. A cloud
    comes back as it is, without normals.
    """
    if not isinstance(geometry, TriangleMesh):
        return geometry, values, None
    import igl

    rows, faces = np.hstack([geometry.points, _normals(geometry), values]), geometry.faces
    while len(rows) < n:
        rows, faces = igl.upsample(rows, faces, 1)
    points, normals, fine = np.split(rows, [3, 6], axis=1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    return TriangleMesh(points, faces), fine, normals


def _normals(mesh: TriangleMesh) -> Floats:
    """Sum of the area vectors of the faces around each vertex, as unit vectors (n, 3)."""
    a, b, c = (mesh.points[mesh.faces[:, i]] for i in range(3))
    sums = np.zeros_like(mesh.points)
    for corner in range(3):
        np.add.at(sums, mesh.faces[:, corner], np.cross(b - a, c - a))
    return np.asarray(sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-300))


def oklab_to_srgb(lab: Floats) -> Bytes:
    """Oklab (n, 3) as sRGB bytes; what lies outside is cut off."""
    linear = np.clip((lab @ _TO_LMS.T) ** 3 @ _TO_RGB.T, 0.0, 1.0)
    gamma = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.asarray(np.round(255 * gamma), dtype=np.uint8)
