"""What can be asked for of outputs: where they go, and how they look."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from spectra_kit.cli.options import DEMO, grouped

PICTURES = (".png", ".pdf", ".svg")
FILLED = "the folder is made; files of an earlier run in it are replaced"
_REPLACED = "a file of that name is replaced, once the new one is whole"


def _integers(_: object, tokens: Sequence[Any]) -> tuple[int, ...]:
    text = tokens[0].value
    try:
        return tuple(int(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"expected numbers like 1,2,5,10, got {text!r}") from None


Axis = Literal["x", "y", "z"]
Output = Annotated[Path, Parameter(alias="-o")]
Indices = Annotated[tuple[int, ...], Parameter(converter=_integers, n_tokens=1, metavar="I,J,...")]


@grouped("output", _REPLACED)
@dataclass(frozen=True, kw_only=True)
class Resolution:
    """How fine pictures are drawn."""

    dpi: int = 200
    """pixels per inch, 600 for print"""


@grouped("output", _REPLACED)
@dataclass(frozen=True, kw_only=True)
class Upright:
    """What points up in pictures."""

    up: Axis | None = None
    """axis that points up in the picture (default: chosen by the shape)"""


@grouped("output", _REPLACED)
@dataclass(frozen=True, kw_only=True)
class View(Upright):
    """From where pictures are drawn."""

    turn: float = 0.0
    """turn it about that axis by X degrees, its front to the right; 180 shows the other side"""


@grouped("output", _REPLACED)
@dataclass(frozen=True, kw_only=True)
class Drawing(View, Resolution):
    """From where pictures are drawn, and how fine."""


@grouped("output", FILLED)
@dataclass(frozen=True, kw_only=True)
class FolderDrawing(Drawing):
    """The same, of pictures in a folder."""

    no_pictures: bool = False
    """write numbers only"""


@grouped("output", _REPLACED)
@dataclass(frozen=True, kw_only=True)
class SpectrumOutput:
    """What ``spectrum`` writes and shows."""

    output: Output | None = None
    """write the spectrum to this .npz file (default: none)"""
    picture: Path | None = None
    """draw eigenvalues, Weyl's law and residuals (.png, .pdf, .svg) (default: none)"""
    modes: Indices | None = None
    """modes to show, counted from 0 (default: a handful)"""


@grouped("output", _REPLACED)
@dataclass(frozen=True, kw_only=True)
class ModesOutput:
    """What ``modes`` draws."""

    output: Output = Path("modes.png")
    """the picture (.png, .pdf, .svg)"""
    modes: Indices | None = None
    """modes to show, counted from 0 (default: the first 12 that are not constant)"""
    columns: int | None = None
    """modes in a row (default: as fits)"""
    no_lines: bool = False
    """leave the zero lines out"""


@grouped("output", _REPLACED)
@dataclass(frozen=True, kw_only=True)
class AnimateOutput:
    """What ``animate`` draws."""

    output: Output = Path("modes.gif")
    """the animation: .gif, or .mp4 where imageio-ffmpeg is installed"""
    modes: Indices | None = None
    """modes to show, counted from 0 (default: the first 6 that are not constant)"""
    seconds: float = 2.0
    """that each mode is shown"""
    fps: int = 20
    """frames per second"""
    width: int = 480
    """pixels"""


@grouped("output", _REPLACED)
@dataclass(frozen=True, kw_only=True)
class CompareOutput:
    """What ``compare`` draws and shows."""

    picture: Output | None = None
    """draw exact | predicted | difference of the chosen modes (.png, .pdf, .svg) (default: none)"""
    modes: Indices | None = None
    """modes to show, counted from 0 (default: a handful)"""


@grouped("output", _REPLACED)
@dataclass(frozen=True, kw_only=True)
class ExploreOutput:
    """The page that ``explore`` writes, or how it is served."""

    html: Output | None = None
    """the page to write: one file that needs no network (default: the name of FILE with .html, in
    the current folder)"""
    serve: bool = False
    """serve the page to this machine alone, too, until Ctrl-C"""
    max_points: int = 50_000
    """show at most so many points of a larger geometry"""
    port: int = 0
    """of --serve (default: a free one)"""
    no_browser: bool = False
    """with --serve, do not open a browser"""


@grouped("output", FILLED)
@dataclass(frozen=True, kw_only=True)
class MatchOutput:
    """The folder that ``match`` fills."""

    output: Output = Path("match")
    """folder for the maps, the report and the pictures"""


def up_of(view: Upright, file: str) -> Axis | None:
    """Return the axis that points up: the one asked for, or that of the demo; None to look."""
    return view.up or ("z" if file == DEMO else None)
