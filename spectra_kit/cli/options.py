"""What can be asked for: one frozen dataclass for each group of options.

Each option stands once, with its type, its default and its help; a command takes a few groups (see
`program`), and its functions the groups that they need.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

from spectra_kit.catalogue import OPERATORS, SOLVERS, SUBSPACES
from spectra_kit.errors import InvalidInputError

DEMO = "demo"
FORMATS = "obj, off, ply, stl, glb, gltf, xyz, npy, npz"
PICTURES = (".png", ".pdf", ".svg")
NETWORK = ("weights", "poses", "dtype", "device")  # what the network alone may be told
_DRAWN = ("dpi", "up", "turn")
_OPERANDS = ("file", "source", "target")
STARTS = tuple(name for name in SUBSPACES if name != "given")  # it needs columns

Axis = Literal["x", "y", "z"]
if TYPE_CHECKING:
    File = str
else:  # a text; but of a path the shell knows how to complete it
    File = str | Path

_READ, _OPERATED, _SOLVED = Group("input"), Group("operator"), Group("solver")
_COARSE = Group("modes", help="for the coarse space of the linear solver, which may do without")
_REPLACED = Group("output", help="a file of that name is replaced, once the new one is whole")
_FILLED = Group("output", help="the folder is made; files of an earlier run in it are replaced")


def option(
    text: str,
    *names: str,
    metavar: str | None = None,
    choices: Sequence[str] | None = None,
    **more: Any,
) -> Parameter:
    """Return how an option is named, and what its help says.

    A default that the help does not tell is added to it.
    """
    return Parameter(
        name=names or None, help=text, metavar=metavar, choices=choices, negative="", **more
    )


def grouped(group: Group) -> Parameter:
    """Return what makes a dataclass a group of options, under their own names."""
    return Parameter(name="*", group=group)


def geometry(name: str) -> Parameter:
    """Return the operand that is a geometry."""
    text = f"a mesh or point cloud ({FORMATS}), or {DEMO!r} for an animal made on the spot"
    return option(text, name, group=_READ)


def indices(default: str) -> Parameter:
    """Return the option that takes numbers of modes."""
    return option(
        f"modes to show, counted from 0 (default: {default})",
        metavar="I,J,...",
        converter=_integers,
        n_tokens=1,
    )


def _integers(_: object, tokens: Sequence[Any]) -> tuple[int, ...]:
    text = tokens[0].value
    try:
        return tuple(int(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"expected numbers like 1,2,5,10, got {text!r}") from None


def output(text: str, *names: str, metavar: str) -> Parameter:
    """Return the option that names what is written."""
    return option(text, *(names or ("-o", "--output")), metavar=metavar)


def refuse_given(group: object, names: Sequence[str], why: str) -> None:
    """Refuse options that change nothing as things are: who gives one expects something of it."""
    for field in fields(group):  # type: ignore[arg-type]  # a group is a dataclass
        if field.name in names and getattr(group, field.name) != field.default:
            raise InvalidInputError(
                f"--{field.name.replace('_', '-')} has no effect {why}, or leave it out"
            )


@grouped(_READ)
@dataclass(frozen=True, kw_only=True)
class Reading:
    """What is done to geometries as they are read."""

    points: Annotated[int, option("vertices of the demo, 500 or more", metavar="N")] = 8000
    cloud: Annotated[
        int | None, option("sample N points on the mesh (default: none)", metavar="N")
    ] = None
    repair: Annotated[
        bool,
        option(
            "merge duplicates, drop degenerate faces and unused vertices, and say what was done"
        ),
    ] = False
    seed: Annotated[int, option("of everything random", metavar="N")] = 0

    @property
    def changed(self) -> bool:
        """Whether points are numbered otherwise than in their file."""
        return self.repair or self.cloud is not None


@grouped(_READ)
@dataclass(frozen=True, kw_only=True)
class Known:
    """What is known of how two geometries correspond."""

    landmarks: Annotated[
        Path | None,
        option(
            "corresponding points: a line for each with its number on the source and on the"
            " target, counted from 0",
            metavar="TXT",
        ),
    ] = None
    sides: Annotated[
        Literal["either", "kept", "reversed"],
        option(
            "whether the map may mirror (default: either, mirrored only if that is clearly better)"
        ),
    ] = "either"
    truth: Annotated[
        Path | None,
        option(
            "the true source point of each target point, to measure errors by (negative: unknown)",
            metavar="NPY",
        ),
    ] = None


@grouped(_OPERATED)
@dataclass(frozen=True, kw_only=True)
class Operator:
    """The Laplacian, and what holds at the boundary."""

    operator: Annotated[
        str | None,
        option("Laplacian (default: robust for meshes, delaunay for clouds)", choices=[*OPERATORS]),
    ] = None
    boundary: Annotated[Literal["neumann", "dirichlet"], option("of a mesh with a boundary")] = (
        "neumann"
    )


@grouped(_OPERATED)
@dataclass(frozen=True, kw_only=True)
class LeanOperator(Operator):
    """By default the same of meshes as `robust`, made in a seventh of its memory."""

    operator: Annotated[str | None, option("Laplacian", choices=[*OPERATORS])] = "delaunay"


def _solver(text: str, *more: str) -> Parameter:
    names = [*SOLVERS, *more]
    return option(f"{text}; one of {', '.join(names)}", metavar="NAME", choices=names)


def _saved(what: str) -> Parameter:
    return option(
        f"take {what} from this file, written by spectra-kit spectrum -o, and solve nothing",
        metavar="NPZ",
    )


@grouped(_SOLVED)
@dataclass(frozen=True, kw_only=True)
class AnySolver:
    """An eigensolver, how many modes, and what it may be told."""

    k: Annotated[int | None, option("number of modes", "-k", metavar="K")] = None
    solver: Annotated[str | None, _solver("what solves")] = None
    rtol: Annotated[
        float | None,
        option(
            "largest relative residual, of solvers that go on to a tolerance (default: their own)",
            metavar="R",
        ),
    ] = None
    start: Annotated[
        str | None,
        option("subspace that a solver begins with, if it does (default: its own)", choices=STARTS),
    ] = None
    weights: Annotated[
        File, option("of neo: shipped ones by name, others by file", metavar="NAME")
    ] = "small"
    poses: Annotated[Literal[1, 2, 4], option("of neo")] = 1
    dtype: Annotated[
        Literal["float32", "bfloat16", "float16"],
        option("of neo: float32, bfloat16, float16", metavar="TYPE"),
    ] = "float32"
    device: Annotated[str, option("of neo and chebyshev: cpu, cuda", metavar="NAME")] = "cpu"


@grouped(_SOLVED)
@dataclass(frozen=True, kw_only=True)
class Solver(AnySolver):
    """The eigensolver of modes that are asked for by their number."""

    k: Annotated[int, option("number of modes", "-k", metavar="K")] = 96
    solver: Annotated[str, _solver("what solves (default: arpack)")] = "arpack"


@grouped(_SOLVED)
@dataclass(frozen=True, kw_only=True)
class VerifiedSolver(Solver):
    """One whose modes may be counted."""

    verify: Annotated[
        bool,
        option("count the eigenvalues to prove that no mode was missed (a few factorisations)"),
    ] = False


@grouped(_SOLVED)
@dataclass(frozen=True, kw_only=True)
class MatchSolver(Solver):
    """One of as many modes as a match uses."""

    k: Annotated[int, option("number of modes", "-k", metavar="K")] = 150


@dataclass(frozen=True, kw_only=True)
class _Spared(AnySolver):
    """One that is not needed where the modes are saved."""

    spectrum: Path | None = None

    @property
    def files(self) -> list[Path]:
        """What is read in its place."""
        return [self.spectrum] if self.spectrum else []


@grouped(_SOLVED)
@dataclass(frozen=True, kw_only=True)
class ShownSolver(_Spared):
    """One that finds what is to be shown, unless it is saved."""

    k: Annotated[
        int | None, option("number of modes (default: as many as are shown)", "-k", metavar="K")
    ] = None
    solver: Annotated[str, _solver("what solves (default: arpack)")] = "arpack"
    spectrum: Annotated[Path | None, _saved("the modes")] = None


@grouped(_SOLVED)
@dataclass(frozen=True, kw_only=True)
class Predictor(_Spared):
    """What predicts, and the truth it is held against."""

    k: Annotated[int, option("number of modes", "-k", metavar="K")] = 96
    solver: Annotated[str | None, _solver("what predicts (default: neo)")] = None
    against: Annotated[
        str,
        option("what solves for the truth, one of the same", metavar="NAME", choices=[*SOLVERS]),
    ] = "arpack"
    spectrum: Annotated[Path | None, _saved("the modes to compare with")] = None


@grouped(_SOLVED)
@dataclass(frozen=True, kw_only=True)
class OptionalPredictor(Predictor):
    """The same; with ``none`` there is nothing but the truth."""

    solver: Annotated[str | None, _solver("what predicts (default: neo)", "none")] = None


@grouped(_COARSE)
@dataclass(frozen=True, kw_only=True)
class CoarseSolver(_Spared):
    """What solves for the modes of a coarse space, if any."""

    k: Annotated[
        int | None,
        option(
            "number of modes (default: 24 beside those of eigenvalue 0, to compare 96)",
            "-k",
            metavar="K",
        ),
    ] = None
    solver: Annotated[str | None, _solver("what solves for modes (default: none)")] = None
    spectrum: Annotated[Path | None, _saved("the modes")] = None


@grouped(
    Group(
        "sources",
        help="the distance is to the nearest of them all; the demo has one by default",
    )
)
@dataclass(frozen=True, kw_only=True)
class Sources:
    """Where distances begin."""

    source: Annotated[
        tuple[int, ...],
        option("points of the file, counted from 0", metavar="INDEX ...", consume_multiple=True),
    ] = ()
    at: Annotated[
        tuple[tuple[float, float, float], ...],
        option("the point of the surface nearest to this place (may be repeated)", metavar="X Y Z"),
    ] = ()
    face: Annotated[
        tuple[tuple[float, float, float, float], ...],
        option(
            "a point of a face, by its barycentric coordinates (may be repeated)",
            metavar="F B0 B1 B2",
        ),
    ] = ()
    farthest: Annotated[
        int,
        option(
            "add N points, each the farthest from all sources before it (the first, where there"
            " are none, from point 0)",
            metavar="N",
        ),
    ] = 0


@grouped(Group("method"))
@dataclass(frozen=True, kw_only=True)
class Heat:
    """How the heat method works."""

    method: Annotated[
        Literal["auto", "direct", "iterative", "projected", "plain"],
        option(
            "of the linear systems: direct, by a factor; or by conjugate gradients with incomplete"
            " Cholesky: plain, or with a coarse space of modes added (iterative) or projected out"
            " (projected) (default: auto, whichever should be quicker)",
            metavar="NAME",
        ),
    ] = "auto"
    poisson_rtol: Annotated[
        float, option("relative residual at which iterations stop", metavar="R")
    ] = 1e-8
    time_coefficient: Annotated[
        float,
        option(
            "the heat diffuses for C squared typical edge lengths; more is smoother", metavar="C"
        ),
    ] = 1.0
    heat_boundary: Annotated[
        Literal["neumann", "dirichlet", "average"],
        option(
            "what heat does at a boundary: neumann, stay; dirichlet, leave; average, the mean of"
            " both",
            metavar="NAME",
        ),
    ] = "neumann"


@grouped(_REPLACED)
@dataclass(frozen=True, kw_only=True)
class Resolution:
    """How fine pictures are drawn."""

    dpi: Annotated[int, option("pixels per inch, 600 for print", metavar="N")] = 200


@grouped(_REPLACED)
@dataclass(frozen=True, kw_only=True)
class Upright:
    """What points up in pictures."""

    up: Annotated[
        Axis | None,
        option("axis that points up in the picture (default: chosen by the shape)"),
    ] = None


@grouped(_REPLACED)
@dataclass(frozen=True, kw_only=True)
class View(Upright):
    """From where pictures are drawn."""

    turn: Annotated[
        float,
        option(
            "turn it about that axis, its front to the right; 180 shows the other side",
            metavar="DEGREES",
        ),
    ] = 0.0


@grouped(_REPLACED)
@dataclass(frozen=True, kw_only=True)
class Drawing(View, Resolution):
    """From where pictures are drawn, and how fine."""


@grouped(_FILLED)
@dataclass(frozen=True, kw_only=True)
class FolderDrawing(Drawing):
    """The same, of pictures in a folder."""

    no_pictures: Annotated[bool, option("write numbers only")] = False


@grouped(_REPLACED)
@dataclass(frozen=True, kw_only=True)
class SpectrumOutput:
    """What ``spectrum`` writes and shows."""

    output: Annotated[
        Path | None, output("write the spectrum to this .npz file (default: none)", metavar="NPZ")
    ] = None
    picture: Annotated[
        Path | None,
        output(
            "draw eigenvalues, Weyl's law and residuals (.png, .pdf, .svg) (default: none)",
            "--picture",
            metavar="PNG",
        ),
    ] = None
    modes: Annotated[tuple[int, ...] | None, indices("a handful")] = None


@grouped(_REPLACED)
@dataclass(frozen=True, kw_only=True)
class ModesOutput:
    """What ``modes`` draws."""

    output: Annotated[Path, output("the picture (.png, .pdf, .svg)", metavar="PNG")] = Path(
        "modes.png"
    )
    modes: Annotated[tuple[int, ...] | None, indices("the first 12 that are not constant")] = None
    columns: Annotated[int | None, option("modes in a row (default: as fits)", metavar="N")] = None
    no_lines: Annotated[bool, option("leave the zero lines out")] = False


@grouped(_REPLACED)
@dataclass(frozen=True, kw_only=True)
class AnimateOutput:
    """What ``animate`` draws."""

    output: Annotated[
        Path,
        output("the animation: .gif, or .mp4 where imageio-ffmpeg is installed", metavar="GIF"),
    ] = Path("modes.gif")
    modes: Annotated[tuple[int, ...] | None, indices("the first 6 that are not constant")] = None
    seconds: Annotated[float, option("that each mode is shown", metavar="N")] = 2.0
    fps: Annotated[int, option("frames per second", metavar="N")] = 20
    width: Annotated[int, option("pixels", metavar="N")] = 480


@grouped(_REPLACED)
@dataclass(frozen=True, kw_only=True)
class CompareOutput:
    """What ``compare`` draws and shows."""

    picture: Annotated[
        Path | None,
        output(
            "draw exact | predicted | difference of the chosen modes (.png, .pdf, .svg)"
            " (default: none)",
            "-o",
            "--picture",
            metavar="PNG",
        ),
    ] = None
    modes: Annotated[tuple[int, ...] | None, indices("a handful")] = None


@grouped(_REPLACED)
@dataclass(frozen=True, kw_only=True)
class ExploreOutput:
    """The page that ``explore`` writes, or how it is served."""

    html: Annotated[
        Path | None,
        output(
            "the page to write: one file that needs no network (default: the name of FILE with"
            " .html, in the current folder)",
            "-o",
            "--html",
            metavar="HTML",
        ),
    ] = None
    serve: Annotated[
        bool,
        option("serve the page to this machine alone, too, until Ctrl-C"),
    ] = False
    max_points: Annotated[
        int, option("show at most so many points of a larger geometry", metavar="N")
    ] = 50_000
    port: Annotated[int, option("of --serve (default: a free one)", metavar="N")] = 0
    no_browser: Annotated[bool, option("with --serve, do not open a browser")] = False


@grouped(_FILLED)
@dataclass(frozen=True, kw_only=True)
class MatchOutput:
    """The folder that ``match`` fills."""

    output: Annotated[
        Path, output("for the maps, the report and the pictures", metavar="FOLDER")
    ] = Path("match")


@grouped(_FILLED)
@dataclass(frozen=True, kw_only=True)
class GeodesicOutput:
    """The folder that ``geodesic`` fills, and with what."""

    output: Annotated[
        Path, output("for the distances, the report and the pictures", metavar="FOLDER")
    ] = Path("geodesic")
    compare: Annotated[
        bool, option("also solve by every solver, and draw and print how each converges")
    ] = False
    spacing: Annotated[
        float | None, option("between two isolines (default: 20 to 40 lines)", metavar="D")
    ] = None


@grouped(Group("general"))
@dataclass(frozen=True, kw_only=True)
class General:
    """What every command takes."""

    json: Annotated[bool, option("print one JSON object instead of tables")] = False
    quiet: Annotated[bool, option("show no progress", "-q", "--quiet")] = False
    debug: Annotated[bool, option("show the traceback of an error")] = False


def refuse_unused(asked: Any) -> None:
    """Refuse what is for the demo on files alone, and what is for pictures where none is drawn."""
    given = vars(asked)
    if "reading" in given and DEMO not in (given.get(name) for name in _OPERANDS):
        refuse_given(asked.reading, ["points"], f"on files; name {DEMO!r} instead")
    if drawing := given.get("drawing"):
        if getattr(drawing, "no_pictures", False):
            refuse_given(drawing, _DRAWN, "with --no-pictures; let them be drawn")
        elif getattr(asked.output, "picture", ...) is None:
            refuse_given(drawing, _DRAWN, "without a picture; name one by --picture")
        if not math.isfinite(turn := getattr(drawing, "turn", 0.0)):
            raise InvalidInputError("--turn", "be a finite number of degrees", turn)


def up_of(view: Upright, file: str) -> Axis | None:
    """Return the axis that points up: the one asked for, or that of the demo; None to look."""
    return view.up or ("z" if file == DEMO else None)
