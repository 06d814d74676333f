"""What can be asked for: one frozen dataclass for each group of options.

Each option stands once, with its type, its default and, below it, its help; a command takes a few
groups (see `program`), and its functions the groups that they need.
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
NETWORK = ("weights", "poses", "dtype", "device")  # what the network alone may be told
_DRAWN = ("dpi", "up", "turn")
_OPERANDS = ("file", "source", "target")


def grouped(name: str, note: str = "") -> Parameter:
    """Return what makes a dataclass a group of options, under their own names."""
    return Parameter(name="*", group=Group(name, help=note), negative="")


def operand(name: str) -> Parameter:
    """Return what is named by its place, as geometries are."""
    text = f"a mesh or point cloud ({FORMATS}), or {DEMO!r} for an animal made on the spot"
    return Parameter(name=name, help=text, group=Group("input"))


if TYPE_CHECKING:
    File = str
else:  # a text; but of a path the shell knows how to complete it
    File = str | Path

Count = Annotated[int, Parameter(name="-k", metavar="K")]
SolverName = Annotated[str, Parameter(choices=[*SOLVERS], metavar="NAME")]
OptionalName = Annotated[str, Parameter(choices=[*SOLVERS, "none"], metavar="NAME")]
StartName = Annotated[str, Parameter(choices=[s for s in SUBSPACES if s != "given"])]
OperatorName = Annotated[str, Parameter(choices=[*OPERATORS])]


@grouped("input")
@dataclass(frozen=True, kw_only=True)
class Reading:
    """What is done to geometries as they are read."""

    points: int = 8000
    """vertices of the demo, 500 or more"""
    cloud: int | None = None
    """sample N points on the mesh (default: none)"""
    repair: bool = False
    """merge duplicates, drop degenerate faces and unused vertices, and say what was done"""
    seed: int = 0
    """of everything random"""

    @property
    def changed(self) -> bool:
        """Whether points are numbered otherwise than in their file."""
        return self.repair or self.cloud is not None


@grouped("input")
@dataclass(frozen=True, kw_only=True)
class Known:
    """What is known of how two geometries correspond."""

    landmarks: Path | None = None
    """corresponding points: a line for each with its number on the source and on the target,
    counted from 0"""
    sides: Literal["either", "kept", "reversed"] = "either"
    """whether the map may mirror (default: either, mirrored only if that is clearly better)"""
    truth: Path | None = None
    """the true source point of each target point, an .npy file to measure errors by (negative:
    unknown)"""


@grouped("operator")
@dataclass(frozen=True, kw_only=True)
class Operator:
    """The Laplacian, and what holds at the boundary."""

    operator: OperatorName | None = None
    """Laplacian (default: robust for meshes, delaunay for clouds)"""
    boundary: Literal["neumann", "dirichlet"] = "neumann"
    """of a mesh with a boundary"""


@grouped("operator")
@dataclass(frozen=True, kw_only=True)
class LeanOperator(Operator):
    """By default the same of meshes as `robust`, made in a seventh of its memory."""

    operator: OperatorName | None = "delaunay"
    """Laplacian (default: delaunay, which of a mesh is robust with less memory)"""


@grouped("solver")
@dataclass(frozen=True, kw_only=True)
class AnySolver:
    """An eigensolver, how many modes, and what it may be told."""

    k: Count | None = None
    """number of modes"""
    solver: SolverName | None = None
    """what solves"""
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
    """of neo and chebyshev: cpu, cuda"""


@grouped("solver")
@dataclass(frozen=True, kw_only=True)
class Solver(AnySolver):
    """The eigensolver of modes that are asked for by their number."""

    k: Count = 96
    """number of modes"""
    solver: SolverName = "arpack"


@grouped("solver")
@dataclass(frozen=True, kw_only=True)
class VerifiedSolver(Solver):
    """One whose modes may be counted."""

    verify: bool = False
    """count the eigenvalues to prove that no mode was missed (a few factorisations)"""


@grouped("solver")
@dataclass(frozen=True, kw_only=True)
class MatchSolver(Solver):
    """One of as many modes as a match uses."""

    k: Count = 150


@dataclass(frozen=True, kw_only=True)
class _Spared(AnySolver):
    """One that is not needed where the modes are saved."""

    spectrum: Path | None = None
    """take the modes from this file, written by spectra-kit spectrum -o, and solve nothing"""

    @property
    def files(self) -> list[Path]:
        """What is read in its place."""
        return [self.spectrum] if self.spectrum else []


@grouped("solver")
@dataclass(frozen=True, kw_only=True)
class ShownSolver(_Spared):
    """One that finds what is to be shown, unless it is saved."""

    k: Count | None = None
    """number of modes (default: as many as are shown)"""
    solver: SolverName = "arpack"


@grouped("solver")
@dataclass(frozen=True, kw_only=True)
class Predictor(_Spared):
    """What predicts, and the truth it is held against."""

    k: Count = 96
    solver: SolverName | None = None
    """what predicts (default: neo)"""
    against: SolverName = "arpack"
    """what solves for the truth, one of the same"""
    spectrum: Path | None = None
    """take the truth from this file, written by spectra-kit spectrum -o, and solve for none"""


@grouped("solver")
@dataclass(frozen=True, kw_only=True)
class OptionalPredictor(Predictor):
    """The same; with ``none`` there is nothing but the truth."""

    solver: OptionalName | None = None
    """what predicts, or none (default: neo)"""


@grouped("modes", "for the coarse space of the linear solver, which may do without")
@dataclass(frozen=True, kw_only=True)
class CoarseSolver(_Spared):
    """What solves for the modes of a coarse space, if any."""

    k: Count | None = None
    """number of modes (default: 24 beside those of eigenvalue 0, to compare 96)"""
    solver: SolverName | None = None
    """what solves for modes (default: none)"""


@grouped("general")
@dataclass(frozen=True, kw_only=True)
class General:
    """What every command takes."""

    json: bool = False
    """print one JSON object instead of tables"""
    quiet: Annotated[bool, Parameter(alias="-q")] = False
    """show no progress"""
    debug: bool = False
    """show the traceback of an error"""


def refuse_given(group: object, names: Sequence[str], why: str) -> None:
    """Refuse options that change nothing as things are: who gives one expects something of it."""
    for field in fields(group):  # type: ignore[arg-type]  # a group is a dataclass
        if field.name in names and getattr(group, field.name) != field.default:
            raise InvalidInputError(
                f"--{field.name.replace('_', '-')} has no effect {why}, or leave it out"
            )


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
