"""`Picture`: what a plot has drawn, shown by notebooks; and how every plot gets into its file."""

from __future__ import annotations

import inspect
import os
from base64 import b64encode
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import wraps
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from spectra_kit._core.checked import checked
from spectra_kit._core.files import atomic_path, check_target, temporary_folder
from spectra_kit._core.optional import optional
from spectra_kit.errors import InvalidInputError
from spectra_kit.show.colours import import_matplotlib

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_TYPES = {".png": "image/png", ".gif": "image/gif", ".svg": "image/svg+xml"}

# What stands in the docstring of every plot that writes $path, $geometry and so on.
_SHARED = {
    "path": "path : path-like, optional\n    The file to write; see `Picture`.",
    "geometry": "geometry : TriangleMesh or PointCloud\n    A cloud is drawn as balls.",
    "view": "view : View, optional\n    Where it is seen from.",
    "page": "page : Page, optional\n    Its head, and its resolution.",
    "columns": "columns : int, optional\n"
    "    How many pictures stand beside each other; by default what fits the page best.",
    "error_label": "error_label : str\n    Says what the errors are, and in which unit.",
    "returns": "Returns\n-------\nPicture\n    What was drawn.",
}

PathLike = str | os.PathLike[str]
Options = ParamSpec("Options")
Drawn = TypeVar("Drawn")


@checked
@dataclass(frozen=True)
class Picture:
    """A picture that was drawn. A notebook shows it where it is the last line of a cell.

    Every plot takes a `path` by that name, and writes that file, whole or not at all: ``.png``,
    ``.pdf`` or ``.svg``, of animations ``.gif`` or ``.mp4``. Without one the picture is kept here.

    Attributes
    ----------
    path : Path, optional
        The file. PNG, GIF and SVG are shown as they are, others by their name.
    content : bytes, default b""
        Where no file was asked for: a PNG, of an animation a GIF.

    Examples
    --------
    >>> from pathlib import Path
    >>> from spectra_kit.show import Picture
    >>> Picture(Path("modes.png")).path.name
    'modes.png'
    """

    path: Path | None = None
    content: bytes = field(default=b"", repr=False)

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> dict[str, str]:
        """What a notebook shows; its own words for the object where that is nothing."""
        content = self.content
        suffix = ".gif" if content.startswith(b"GIF") else ".png"
        if self.path is not None:
            suffix = self.path.suffix.lower()
            content = self.path.read_bytes() if self.path.is_file() else b""
        if suffix not in _TYPES or not content:
            return {}
        return {
            _TYPES[suffix]: content.decode() if suffix == ".svg" else b64encode(content).decode()
        }


def written(
    write: Callable[[Drawn, Path], None], *suffixes: str
) -> Callable[[Callable[Options, Drawn]], Callable[Options, Picture]]:
    """Decorate what draws something: it then is `checked`, and returns a `Picture`.

    That is written to the `path` among its options, which is refused before the drawing if `write`
    could not write there. The first of the `suffixes` is what a picture without a path is made of.
    """

    def decorate(draw: Callable[Options, Drawn]) -> Callable[Options, Picture]:
        draw = checked(draw)

        @wraps(draw)
        def plot(*args: Options.args, **options: Options.kwargs) -> Picture:
            path: Any = options.get("path")
            _check_path(path, suffixes)
            import_matplotlib()
            drawn = draw(*args, **options)
            if path is not None:
                with atomic_path(path) as part:
                    write(drawn, part)
                return Picture(Path(path))
            with temporary_folder() as folder:
                write(drawn, part := folder / f"picture{suffixes[0]}")
                return Picture(content=part.read_bytes())

        plot.__annotations__ = draw.__annotations__ | {"return": "Picture"}
        own_words = Template(inspect.cleandoc(draw.__doc__ or ""))
        plot.__doc__ = own_words.safe_substitute(_SHARED) + "\n"
        return plot

    return decorate


@checked
def _check_path(path: PathLike | None, suffixes: tuple[str, ...]) -> None:
    """Refuse a path that nothing could be written to."""
    if path is None:
        return
    suffix = Path(path).suffix.lower()
    if suffix not in suffixes:
        *most, last = suffixes
        raise InvalidInputError("path", f"end in {', '.join(most)} or {last}", repr(str(path)))
    check_target(path)
    if suffix == ".mp4":
        optional("imageio_ffmpeg", extra="video", needed_by="MP4", otherwise="write a .gif")


def save(figure: Figure, path: PathLike) -> None:
    """Write a figure; the same one gives the same bytes.

    In ``.pdf`` and ``.svg`` text stays text and lines stay lines; pictures are embedded pixel by
    pixel.
    """
    from matplotlib import rc_context

    dated = {".pdf": "CreationDate", ".svg": "Date"}.get(Path(path).suffix.lower())
    style: Any = {"svg.fonttype": "none", "svg.hashsalt": "spectra_kit", "pdf.fonttype": 42}
    if dated is not None:
        _embed_pictures(figure)
    with rc_context(style):
        figure.savefig(path, dpi=figure.dpi, metadata=None if dated is None else {dated: None})


def _embed_pictures(figure: Figure) -> None:
    """Let a page without pixels scale the pictures: resampled, they would have faint edges."""
    width, height = figure.get_size_inches() * figure.dpi
    images: list[Any] = list(figure.images)
    for image in images:
        pixels = image.get_array()
        rows, columns = pixels.shape[:2]
        place = (image.ox / width, image.oy / height, columns / width, rows / height)
        axes = figure.add_axes(place, frame_on=False, xticks=[], yticks=[], zorder=-1)
        axes.imshow(pixels, interpolation="none", aspect="auto", origin="upper")
        image.remove()


plotted = written(save, ".png", ".pdf", ".svg")
