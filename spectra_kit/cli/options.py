"""What several commands can be told: each option once, with its type, its default and its help.

A command (see `program`) is a frozen dataclass of all its options; here are those that it shares.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from cyclopts import Parameter

from spectra_kit.catalogue import OPERATORS, SOLVERS, SUBSPACES
from spectra_kit.errors import InvalidInputError

DEMO = "demo"
FORMATS = "obj, off, ply, stl, glb, gltf, xyz, npy, npz"
PICTURES = (".png", ".pdf", ".svg")
NETWORK = ("weights", "poses", "dtype", "device")  # what the network alone may be told
_DRAWN = ("dpi", "up", "turn")


def _integers(_: object, tokens: Sequence[Any]) -> tuple[int, ...]:
    text = tokens[0].value
    try:
        return tuple(int(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"expected numbers like 1,2,5,10, got {text!r}") from None


def words(_: object, tokens: Sequence[Any]) -> tuple[str, ...]:
    """Return names that commas part."""
    return tuple(part.strip() for part in tokens[0].value.split(","))


def operand(name: str) -> Parameter:
    """Return what is named by its place, as geometries are."""
    text = f"a mesh or point cloud ({FORMATS}), or {DEMO!r} for an animal made on the spot"
    return Parameter(name=name, help=text)


if TYPE_CHECKING:
    File = str
else:  # a text; but of a path the shell knows how to complete it
    File = str | Path

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
    outcome: ClassVar[str]  # what one gets, in a few words
    examples: ClassVar[tuple[str, ...]]  # the first one stands in the story
    keys: ClassVar[str]  # of the object that --json prints
    run: ClassVar[str]  # a module of this package, and in it the function that does it
    operands: ClassVar[str] = "FILE [options]"
    group: ClassVar[str] = "general"  # of the options that a class adds, in the help
    notes: ClassVar[Mapping[str, str]] = {  # on groups
        "output": "a file of that name is replaced, once the new one is whole"
    }

    json: bool = False
    """print one JSON object instead of tables"""
    quiet: Annotated[bool, Parameter(alias="-q")] = False
    """show no progress"""
    debug: bool = False
    """show the traceback of an error"""

    def __init_subclass__(cls) -> None:
        cls.name = re.sub("(?<=[a-z])(?=[A-Z])", "-", cls.__name__).lower()
        cls.usage = f"usage: spectra-kit {cls.name} {cls.operands}"

    @classmethod
    def load(cls) -> Callable[[Any], None]:
        """Import what the command needs, and return its function."""
        module, _, function = cls.run.partition(".")
        run: Callable[[Any], None]
        run = getattr(import_module(f"spectra_kit.cli.{module}"), function)
        return run


@dataclass(frozen=True, kw_only=True)
class Read(Command):
    """What is done to geometries as they are read."""

    group = "input"

    cloud: int | None = None
    """sample N points on the mesh (default: none)"""
    repair: bool = False
    """join what is cut along seams, merge duplicates, drop degenerate faces and unused vertices,
    turn faces wound against the others, and say what was done"""
    largest: bool = False
    """keep the largest connected part of a mesh alone, after a repair; clouds stay whole"""
    seed: int = 0
    """of everything random"""

    @property
    def inputs(self) -> list[Path]:
        """The files that are read."""
        named = (
            "file",
            "source",
            "target",
            "spectrum",
            "landmarks",
            "initial",
            "truth",
            "labeller",
        )
        given = (getattr(self, name, None) for name in named)
        return [Path(file) for file in given if isinstance(file, str | Path) and file != DEMO]


@dataclass(frozen=True, kw_only=True)
class Reading(Read):
    """The same, where there may be a demo."""

    group = "input"

    points: int = 8000
    """vertices of the demo, 500 or more"""


@dataclass(frozen=True)
class OneFile(Reading):
    """The geometry of a command that takes one."""

    group = "input"

    file: Annotated[File, operand("FILE")]


@dataclass(frozen=True, kw_only=True)
class Operator(Read):
    """The Laplacian, and what holds at the boundary."""

    group = "operator"

    operator: OperatorName | None = None
    """Laplacian (default: robust for meshes, delaunay for clouds)"""
    boundary: Literal["neumann", "dirichlet"] = "neumann"
    """of a mesh with a boundary"""


@dataclass(frozen=True, kw_only=True)
class OnOne(OneFile, Operator):
    """A command that works with the Laplacian of one geometry."""


@dataclass(frozen=True, kw_only=True)
class Solver(Read):
    """An eigensolver, how many modes, and what it may be told."""

    group = "solver"

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
class Verified(Solver):
    """A solver whose modes may be counted."""

    group = "solver"

    verify: bool = False
    """count the eigenvalues to prove that no mode was missed (a few factorisations)"""


@dataclass(frozen=True, kw_only=True)
class Spared(Solver):
    """A solver that is not needed where the modes are saved."""

    group = "solver"

    spectrum: Path | None = None
    """take the modes from this file, written by spectra-kit spectrum -o, and solve nothing"""


@dataclass(frozen=True, kw_only=True)
class Predictor(Spared):
    """What predicts, and the truth it is held against."""

    group = "solver"

    k: Count = 96
    solver: OptionalName | None = None
    """what predicts (default: neo)"""
    against: SolverName = "lanczos"
    """what solves for the truth, one of the same"""
    spectrum: Path | None = None
    """take the truth from this file, written by spectra-kit spectrum -o, and solve for none"""


@dataclass(frozen=True, kw_only=True)
class Resolution(Command):
    """How fine pictures are drawn."""

    group = "drawing"

    dpi: int = 200
    """pixels per inch, 600 for print"""


@dataclass(frozen=True, kw_only=True)
class Upright(Command):
    """What points up in pictures."""

    group = "drawing"

    up: Axis | None = None
    """axis that points up in the picture, or down: --up=-y (default: chosen by the shape)"""

    @property
    def upwards(self) -> Axis | None:
        """The axis that points up: the one asked for, or that of the demo; None to look."""
        first = getattr(self, "file", None) or getattr(self, "source", None)
        return self.up or ("z" if first == DEMO else None)


@dataclass(frozen=True, kw_only=True)
class Turned(Upright):
    """From where pictures are drawn."""

    group = "drawing"

    turn: float = 0.0
    """turn it about that axis by X degrees, its front to the right; 180 shows the other side"""


@dataclass(frozen=True, kw_only=True)
class FolderDrawing(Turned, Resolution):
    """From where pictures in a folder are drawn, and how fine."""

    group = "drawing"
    notes: ClassVar[Mapping[str, str]] = {
        "output": "the folder is made; files of an earlier run in it are replaced"
    }

    no_pictures: bool = False
    """write numbers only"""


def refuse_given(asked: Command, names: Sequence[str], why: str) -> None:
    """Refuse options that change nothing as things are: who gives one expects something of it."""
    for field in fields(asked):
        if field.name in names and getattr(asked, field.name) != field.default:
            raise InvalidInputError(
                f"--{field.name.replace('_', '-')} has no effect {why}, or leave it out"
            )


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
