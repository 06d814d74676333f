"""What several commands can be told: each option once, with its type, its default and its help.

A command is a frozen dataclass of all its options, beside the function that does it; here are those
that it shares. Annotations are evaluated here and there: each gets the group that the help shows it
in.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import Field, dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, get_origin

from cyclopts import Group, Parameter

from spectra_kit.catalogue import OPERATORS, SOLVERS, SUBSPACES
from spectra_kit.errors import InvalidInputError

DEMO = "demo"
FORMATS = (
    "obj, off, ply, stl, glb, gltf, vtk, vtp, vtu, gii, pial and its kin, msh, mesh, xyz, txt, csv,"
    " asc, pts, pcd, npy, npz"
)
PICTURES = (".png", ".pdf", ".svg")
NETWORK = ("weights", "poses", "dtype", "device")  # what the network alone may be told
_DRAWN = ("dpi", "up", "turn")
_READ = ("file", "source", "target", "spectrum", "landmarks", "initial", "truth", "labeller")
_PLACES = ("input", "sources", "method", "operator", "solver", "workers", "output", "drawing")
_GROUPS = {name: Group(name, sort_key=i) for i, name in enumerate((*_PLACES, "general"))}


def _integers(_: object, tokens: Sequence[Any]) -> tuple[int, ...]:
    text = tokens[0].value
    try:
        return tuple(int(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"expected numbers like 1,2,5,10, got {text!r}") from None


def words(_: object, tokens: Sequence[Any]) -> tuple[str, ...]:
    """Return names that commas part."""
    return tuple(part.strip() for part in tokens[0].value.split(","))


if TYPE_CHECKING:
    from spectra_kit.show import View

    File = str
else:  # a text; but of a path the shell knows how to complete it
    File = str | Path

_GEOMETRY = f"a mesh or point cloud (obj, ply, vtk ...), or {DEMO!r} for an animal made on the spot"
GeometryFile = Annotated[File, Parameter(help=_GEOMETRY)]
Axis = Literal["x", "y", "z", "-x", "-y", "-z"]
Count = Annotated[int, Parameter(name="-k", metavar="K")]
Indices = Annotated[tuple[int, ...], Parameter(converter=_integers, n_tokens=1, metavar="I,J,...")]
Output = Annotated[Path, Parameter(alias="-o")]
OperatorName = Annotated[str, Parameter(choices=[*OPERATORS])]
SolverName = Annotated[str, Parameter(choices=[*SOLVERS], metavar="NAME")]
OptionalName = Annotated[str, Parameter(choices=[*SOLVERS, "none"], metavar="NAME")]
StartName = Annotated[str, Parameter(choices=[s for s in SUBSPACES if s != "given"])]


@dataclass(frozen=True, kw_only=True)
class Command:
    """What every command can be told, and what is told of it."""

    name: ClassVar[str]  # as typed
    usage: ClassVar[str]
    examples: ClassVar[tuple[str, ...]]
    keys: ClassVar[str]  # of the object that --json prints
    operands: ClassVar[str] = "FILE [options]"
    needs: ClassVar[tuple[str, ...]] = ("eigen",)  # of the library, imported before it begins
    solves: ClassVar[bool] = True  # with a factor, whose loops the first call compiles
    group: ClassVar[str] = "general"  # of the options that a class adds, in the help

    json: Annotated[bool, Parameter(group=_GROUPS["general"])] = False
    """print one JSON object instead of tables"""
    quiet: Annotated[bool, Parameter(alias="-q", group=_GROUPS["general"])] = False
    """show no progress"""
    debug: Annotated[bool, Parameter(group=_GROUPS["general"])] = False
    """show the traceback of an error"""

    def __init_subclass__(cls, group: str = "output") -> None:
        words = re.sub("(?<=[a-z])(?=[A-Z])", "-", cls.__name__.removesuffix("Options"))
        cls.name = words.lower()
        cls.usage = f"usage: spectra-kit {cls.name} {cls.operands}"
        cls.group = group
        # The class that has an option first tells its group; what is named by its place is input.
        owners: dict[str, Any] = {
            name: c for c in cls.__mro__ for name in vars(c).get("__annotations__", ())
        }
        for name, kind in (own := vars(cls).get("__annotations__", {})).items():
            if get_origin(kind) is not ClassVar:
                named = isinstance(vars(cls).get(name), Field)
                place = _GROUPS["input" if named else owners[name].group]
                own[name] = Annotated[kind, Parameter(group=place)]

    @property
    def inputs(self) -> list[Path]:
        """The files that are read."""
        given = (getattr(self, name, None) for name in _READ)
        return [Path(file) for file in given if isinstance(file, str | Path) and file != DEMO]


@dataclass(frozen=True, kw_only=True)
class Read(Command, group="input"):
    """What is done to geometries as they are read."""

    cloud: int | None = None
    """sample N points on the mesh (default: none)"""
    repair: bool = False
    """join what is cut along seams, merge duplicates, drop degenerate faces and unused vertices,
    turn faces wound against the others, and say what was done"""
    largest: bool = False
    """keep the largest connected part of a mesh alone, after a repair; clouds stay whole"""
    seed: int = 0
    """of everything random"""


@dataclass(frozen=True, kw_only=True)
class Reading(Read, group="input"):
    """The same, where there may be a demo."""

    points: int = 8000
    """vertices of the demo, 500 or more"""


@dataclass(frozen=True, kw_only=True)
class OneFile(Reading, group="input"):
    """The geometry of a command that takes one."""

    file: GeometryFile = field(kw_only=False)


@dataclass(frozen=True, kw_only=True)
class Operator(Read, group="operator"):
    """The Laplacian, and what holds at the boundary."""

    operator: OperatorName | None = None
    """Laplacian (default: robust for meshes, delaunay for clouds)"""
    boundary: Literal["neumann", "dirichlet"] = "neumann"
    """of a mesh with a boundary"""
    mass: Literal["lumped", "consistent"] = "lumped"
    """areas of points, or linear elements' matrix: LaPy's, with --operator cotan"""


@dataclass(frozen=True, kw_only=True)
class OnOne(OneFile, Operator):
    """A command that works with the Laplacian of one geometry."""


@dataclass(frozen=True, kw_only=True)
class Solver(Read, group="solver"):
    """An eigensolver, how many modes, and what it may be told."""

    k: Count | None = None
    """number of modes"""
    accuracy: float | None = None
    """relative error that the eigenvalues may have in the mean, such as 1e-3: what costs least for
    it is chosen (default: none, exact)"""
    solver: SolverName | None = None
    """what solves, for those who know"""
    rtol: float | None = None
    """largest relative residual, of solvers that go on to a tolerance (default: their own)"""
    start: StartName | None = None
    """subspace that a solver begins with, if it does (default: its own)"""
    weights: File = "small"
    """of neo: shipped ones by name, others by file"""
    poses: Literal[1, 2, 4] = 1
    """of neo"""
    dtype: Literal["float32", "bfloat16", "float16"] = "float32"
    """of neo"""
    device: str = "cpu"
    """of neo, cascade and automatic: cpu, cuda"""

    def __post_init__(self) -> None:
        if self.accuracy is not None and self.solver is None:
            object.__setattr__(self, "solver", "automatic")


@dataclass(frozen=True, kw_only=True)
class Spared(Solver, group="solver"):
    """A solver that is not needed where the modes are saved."""

    spectrum: Path | None = None
    """take the modes from this file, written by spectra-kit spectrum -o, and solve nothing"""


@dataclass(frozen=True, kw_only=True)
class Predictor(Spared, group="solver"):
    """What predicts, and the truth it is held against."""

    k: Count = 96
    solver: OptionalName | None = None
    """what predicts (default: neo)"""
    against: SolverName = "lanczos"
    """what solves for the truth, one of the same"""
    spectrum: Path | None = None
    """take the truth from this file, written by spectra-kit spectrum -o, and solve for none"""


@dataclass(frozen=True, kw_only=True)
class Sides(Command, group="input"):
    """Which maps between two surfaces are wanted."""

    sides: Literal["either", "kept", "reversed"] = "either"
    """whether the map may mirror; either: only if that is clearly better"""

    @property
    def mirrored(self) -> bool | None:
        """Whether it mirrors; None where that is open."""
        return {"either": None, "kept": False, "reversed": True}[self.sides]


@dataclass(frozen=True, kw_only=True)
class Resolution(Command, group="drawing"):
    """How fine pictures are drawn."""

    dpi: int = 200
    """pixels per inch, 600 for print"""


@dataclass(frozen=True, kw_only=True)
class Upright(Command, group="drawing"):
    """What points up in pictures."""

    up: Axis | None = None
    """axis that points up in the picture, or down: --up=-y (default: chosen by the shape)"""

    @property
    def upwards(self) -> Axis | None:
        """The axis that points up: the one asked for, or that of the demo; None to look."""
        first = getattr(self, "file", None) or getattr(self, "source", None)
        return self.up or ("z" if first == DEMO else None)


@dataclass(frozen=True, kw_only=True)
class Turned(Upright, group="drawing"):
    """From where pictures are drawn."""

    turn: float = 0.0
    """turn it about that axis by X degrees, its front to the right; 180 shows the other side"""

    @property
    def view(self) -> "View":
        """From where it is looked at."""
        from spectra_kit.show import View

        return View(self.upwards, self.turn)


@dataclass(frozen=True, kw_only=True)
class FolderDrawing(Turned, Resolution, group="drawing"):
    """From where pictures in a folder are drawn, and how fine."""

    no_pictures: bool = False
    """write numbers only"""


def refuse_given(asked: Command, names: Sequence[str], why: str) -> None:
    """Refuse options that change nothing as things are: who gives one expects something of it."""
    for one in fields(asked):
        if one.name in names and getattr(asked, one.name) != one.default:
            option = one.name.replace("_", "-")
            raise InvalidInputError(f"--{option} has no effect {why}, or leave it out")


def refuse_unused(asked: Command) -> None:
    """Refuse what is for the demo on files alone, and what is for pictures where none is drawn."""
    given = vars(asked)
    if DEMO not in (given.get(name) for name in ("file", "source", "target")):
        refuse_given(asked, ["points"], f"on files; name {DEMO!r} instead")
    if given.get("no_pictures"):
        refuse_given(asked, _DRAWN, "with --no-pictures; let them be drawn")
    elif given.get("picture", ...) is None:
        refuse_given(asked, _DRAWN, "without a picture; name one by --picture")
    if not math.isfinite(turn := given.get("turn", 0.0)):
        raise InvalidInputError("--turn", "be a finite number of degrees", turn)
