"""Modes that swing, as GIF or MP4."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from spectra_kit._core.types import Bytes, Floats
from spectra_kit._core.validate import check_count, check_positive
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import GeometryLike, estimate_normals, orient_normals
from spectra_kit.geometry.shapes import Geometry, TriangleMesh
from spectra_kit.maps.surface import outward_normals
from spectra_kit.operators.oriented import oriented_triangles
from spectra_kit.show.camera import View
from spectra_kit.show.colours import diverging_colours
from spectra_kit.show.contours import level_lines, triangles_of
from spectra_kit.show.fields import symmetric_limit
from spectra_kit.show.layout import Page, new_figure
from spectra_kit.show.modes import check_modes, display_signs
from spectra_kit.show.picture import PathLike, written
from spectra_kit.show.render import Scene, render

_MOST_FRAMES = 20_000  # some quarter of an hour, and gigabytes while they are drawn
_MODES = 6  # by default
_CAPTION = 0.075  # of the width: height of the line above the picture
_SHRINKINGS = 8  # of balls: half of them is enough nearly everywhere
_LINE = 1 / 300  # of the width: that of a nodal line
_SAMPLED = 12  # frames that the colours of a GIF are chosen from
_DITHER = 6.0  # steps of 255, hardly more than between two of those colours
_BAYER = np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]]) / 16 - 15 / 32


@dataclass(frozen=True, eq=False)
class Film:
    """Frames (rows, columns, 3) of one size, and how many of them are shown in a second."""

    frames: list[Bytes]
    fps: float

    def write(self, path: Path) -> None:
        """Write a GIF or an MP4."""
        write = _write_gif if path.suffix.lower() == ".gif" else _write_mp4
        write(path, self.frames, self.fps)


@written(Film.write, ".gif", ".mp4")
def animate_modes(
    geometry: GeometryLike,
    spectrum: Spectrum,
    *,
    path: PathLike | None = None,
    view: View = View(),
    modes: Sequence[int] | None = None,
    amplitude: float = 0.01,
    seconds_per_mode: float = 2.0,
    fps: float = 20.0,
    nodal_lines: bool = False,
    width: int = 480,
    progress: Callable[[int, int], None] | None = None,
) -> Film:
    """Let modes swing one after the other, in colour and along the normals, as an endless film.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        The points that the spectrum lives on.
    spectrum : Spectrum
        Its k modes.
    $path
    $view
    modes : sequence of int, optional
        Which ones, counted from 0; by default the first six that are not constant.
    amplitude : float, default 0.01
        The farthest that a point moves, as part of the diagonal of the bounding box; 0 for colours
        alone. Where the surface is thin it moves less, at most a quarter of its thickness.
    seconds_per_mode : float, default 2
        Of one swing there and back.
    fps : float, default 20
        Frames in a second. GIF knows hundredths of a second only: there each frame lasts the
        nearest number of them.
    nodal_lines : bool, default False
        Draw the lines where the mode is zero; they stay where they are.
    width : int, default 480
        Of a frame, in pixels; the height follows the geometry.
    progress : callable, optional
        Called with the number of pictures drawn, and of all.

    $returns

    Raises
    ------
    MissingDependencyError
        If there is no imageio-ffmpeg, which ``.mp4`` needs.

    Notes
    -----
    ``x(t) = x + s(x) cos(omega t) n(x)`` with the outward normals n, those of clouds estimated, and
    ``s = w / sqrt(1 + (2 w / r)^2)``, ``w = a u(x) / max|u|``, where r is the radius of the largest
    ball inside that touches the surface at x: no point moves as far as half of it, so that thin
    parts stay apart. (A triangle of a coarse mesh, bent sharply outwards, may still fold.) The
    colours follow ``u cos(omega t)``, with the same limits in all frames. (Of max|u| only the 99th
    percentile counts, and what exceeds it is cut off.) The film begins at the largest swing of the
    first mode. Every mode begins and ends at rest, so that each flows into the next, and the last
    into the first.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> from spectra_kit.show import animate_modes
    >>> mesh = sk.geometry.sphere(subdivisions=2).geometry
    >>> spectrum = sk.eigensolve(sk.robust_laplacian(mesh), 5)
    >>> animate_modes(mesh, spectrum, modes=[1], width=40, fps=4)
    Picture(path=None)
    """
    chosen = check_modes(geometry, spectrum, modes, _MODES)
    if not (np.isfinite(amplitude) and amplitude >= 0):
        raise InvalidInputError("amplitude", "be finite and >= 0", repr(amplitude))
    check_count("width", width, low=16)
    rate = check_positive("fps", fps)
    quarter = max(round(check_positive("seconds_per_mode", seconds_per_mode) * rate / 4), 1)
    count = 4 * quarter
    if count * len(chosen) > _MOST_FRAMES:
        expected = f"make at most {_MOST_FRAMES:,} frames with `seconds_per_mode`"
        each = f"{seconds_per_mode:g} seconds for each of {len(chosen)} modes"
        raise InvalidInputError("fps", expected, f"{fps:g} in a second and {each}")
    swings = np.round(np.sin(2 * np.pi * np.arange(count) / count), 12)
    distinct, number = np.unique(swings, return_inverse=True)
    vectors = spectrum.eigenvectors[:, chosen]
    functions = [
        np.clip(column / symmetric_limit(column), -1.0, 1.0)
        for column in (vectors * display_signs(vectors)).T
    ]
    lines = None
    if nodal_lines:
        triangles = triangles_of(geometry)
        lines = [level_lines(geometry.points, triangles, function) for function in functions]
    scene = Scene(
        geometry=geometry,
        functions=functions,
        rotation=view.rotation(geometry),
        width=width,
        colours=diverging_colours(np.linspace(-1.0, 1.0, 256)),
        shifts=_shifts(geometry, functions, amplitude),
        swings=distinct.tolist(),
        lines=lines,
        line_width=max(_LINE * width, 1.5),
    )
    (pictures,) = render([scene], progress=progress)
    captions = [_caption(spectrum, mode, width) for mode in chosen]
    order = [(m, m * len(distinct) + i) for m in range(len(chosen)) for i in number]
    # Begin at the first peak: a film that stands still shows something, too.
    order = order[quarter:] + order[:quarter]
    return Film([_even(np.vstack([captions[m], pictures[p]])) for m, p in order], rate)


def _shifts(geometry: Geometry, functions: Sequence[Floats], amplitude: float) -> list[Floats]:
    """How far the points move, (n, 3) for each function; see the notes of `animate_modes`."""
    diagonal = float(np.linalg.norm(np.ptp(geometry.points, axis=0)))
    if not amplitude * diagonal:
        return [np.zeros((geometry.n, 3)) for _ in functions]
    if isinstance(geometry, TriangleMesh):
        normals = outward_normals(geometry.points, oriented_triangles(geometry))
    else:
        normals = orient_normals(geometry, estimate_normals(geometry))
    radii = _inner_radii(geometry.points, normals, diagonal)
    swings = (amplitude * diagonal * function for function in functions)
    return [(w / np.hypot(1, 2 * w / radii))[:, None] * normals for w in swings]


def _inner_radii(points: Floats, normals: Floats, largest: float) -> Floats:
    """Radii of the largest balls inside that touch the surface at the points, (n,).

    Balls shrink until they hold no other point: Ma, Bae and Choi, *3D medial axis point
    approximation using nearest neighbors and the normal field*, 2012.
    """
    tree = cKDTree(points)
    radii = np.full(len(points), largest)
    for _ in range(_SHRINKINGS):
        _, nearest = tree.query(points - radii[:, None] * normals)
        apart = points - points[nearest]
        behind = np.einsum("ij,ij->i", apart, normals)
        through = np.einsum("ij,ij->i", apart, apart) / (2 * np.where(behind > 0, behind, 1))
        radii = np.where(behind > 0, np.minimum(radii, through), radii)
    return np.asarray(np.maximum(radii, np.finfo(np.float64).tiny))


def _caption(spectrum: Spectrum, mode: int, width: int) -> Bytes:
    """The line above the pictures of a mode."""
    zero = mode < spectrum.n_zero_modes
    value = "0" if zero else f"{spectrum.eigenvalues[mode]:.4g}"
    inch = 64  # a power of two: the width in pixels comes out as asked for
    figure = new_figure(Page(dpi=inch), width / inch, round(_CAPTION * width) / inch)
    figure.text(
        0.5, 0.3, f"mode {mode}   λ = {value}", ha="center", fontsize=0.04 * width * 72 / inch
    )
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())[..., :3]  # type: ignore[attr-defined]


def _even(frame: Bytes) -> Bytes:
    """A frame with even sides, as films need them: white is added."""
    rows, columns, _ = frame.shape
    return np.pad(frame, ((0, rows % 2), (0, columns % 2), (0, 0)), constant_values=255)


def _write_gif(path: Path, frames: list[Bytes], fps: float) -> None:
    """Write frames in 256 colours that are the same in all: nothing flickers."""
    from PIL import Image

    chosen = np.unique(np.linspace(0, len(frames) - 1, _SAMPLED).astype(int))
    sample = Image.fromarray(np.vstack([frames[i][::2, ::2] for i in chosen]))
    fixed = Image.Dither.NONE
    colours = sample.quantize(255, method=Image.Quantize.MAXCOVERAGE, kmeans=2, dither=fixed)
    table = bytes([255, 255, 255, *(colours.getpalette() or [])[: 3 * 255]])
    palette = Image.new("P", (1, 1))
    palette.putpalette(table)
    first, *rest = (
        Image.fromarray(_dithered(frame)).quantize(palette=palette, dither=fixed)
        for frame in frames
    )
    lasting = 10 * max(round(100 / fps), 1)
    # The palette is said once, for all frames.
    first.save(path, save_all=True, append_images=rest, duration=lasting, loop=0, palette=table)


def _dithered(frame: Bytes) -> Bytes:
    """Add a fine pattern that stays where it is: fewer colours make no bands. White stays white."""
    rows, columns, _ = frame.shape
    pattern = np.tile(_BAYER, (rows // 4 + 1, columns // 4 + 1))[:rows, :columns, None]
    mixed = np.clip(np.round(frame + _DITHER * pattern), 0, 255).astype(np.uint8)
    return np.where((frame == 255).all(axis=2, keepdims=True), frame, mixed)


def _write_mp4(path: Path, frames: list[Bytes], fps: float) -> None:
    """Write frames as H.264 that every browser plays."""
    import imageio_ffmpeg

    rows, columns, _ = frames[0].shape
    style = {"quality": 8, "macro_block_size": 2, "ffmpeg_log_level": "error"}
    style["output_params"] = ["-movflags", "+faststart"]
    film = imageio_ffmpeg.write_frames(str(path), (columns, rows), fps=fps, **style)
    with closing(film):
        film.send(None)
        for frame in frames:
            film.send(np.ascontiguousarray(frame))
