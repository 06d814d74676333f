"""Options that several commands share, in groups."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import shtab

DEMO = "demo"
FORMATS = "obj, off, ply, stl, glb, gltf, xyz, npy, npz"
OPERATORS = ("robust", "cotan", "knn", "delaunay")
SOLVERS = (
    "arpack",
    "multilevel",
    "refined",
    "lobpcg",
    "dense",
    "polished",
    "capped",
    "fourier",
    "neo",
)
# The solvers that know what an option asks for; the others have no use for it.
TAKERS = {
    "rtol": ("refined", "multilevel", "lobpcg"),
    "start": ("refined", "polished", "capped"),
}
# Options of the network, and their defaults.
NETWORK = {"weights": "small", "poses": 1, "dtype": "float32", "device": "cpu"}
# Options of the demo, and of pictures.
MAKING = {"points": 8000}
DRAWING = {"dpi": 200, "up": None, "turn": 0.0}
Up = Literal["x", "y", "z"]
PICTURES = (".png", ".pdf", ".svg")
DEFAULT = "(default: %(default)s)"

FILE, FOLDER = shtab.FILE, shtab.DIRECTORY
GEOMETRY = {
    **shtab.FILE,
    "bash": "_spectra_kit_geometry",
    "preamble": {
        "bash": f"""\
_spectra_kit_geometry() {{
  compgen -f -- "$1"
  compgen -W {DEMO} -- "$1"
}}
"""
    },
}


def listed(names: Sequence[str]) -> str:
    """Return ``a, b and c``."""
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def completed(action: argparse.Action, by: Any = FILE) -> None:
    """Let the shell complete the value of an option."""
    action.complete = by  # type: ignore[attr-defined]  # where shtab looks for it


def add_input(parser: argparse.ArgumentParser, *, file: str | None) -> None:
    """Add the file and how it is read; `file` is a default."""
    group = parser.add_argument_group("input")
    add_file(group, "file", file)
    add_reading(group)


def add_file(group: argparse._ArgumentGroup, name: str, default: str | None) -> None:
    """Add one geometry."""
    completed(
        group.add_argument(
            name,
            metavar=name.upper(),
            nargs="?" if default else None,
            default=default,
            help=f"a mesh or point cloud ({FORMATS}), or {DEMO!r} for an animal made on the spot"
            + (f" {DEFAULT}" if default else ""),
        ),
        GEOMETRY,
    )


def add_reading(group: argparse._ArgumentGroup) -> None:
    """Add what is done to geometries as they are read."""
    group.add_argument(
        "--points",
        type=int,
        default=MAKING["points"],
        metavar="N",
        help=f"vertices of the demo, 500 or more {DEFAULT}",
    )
    group.add_argument(
        "--cloud", type=int, metavar="N", help="sample N points on the mesh (default: none)"
    )
    group.add_argument(
        "--repair",
        action="store_true",
        help="merge duplicates, drop degenerate faces and unused vertices, and say what was done",
    )
    group.add_argument(
        "--seed", type=int, default=0, metavar="N", help=f"of everything random {DEFAULT}"
    )


def add_operator(parser: argparse.ArgumentParser, *, default: str | None = None) -> None:
    """Add the choice of the Laplacian; by default its kind depends on that of the geometry."""
    group = parser.add_argument_group("operator")
    group.add_argument(
        "--operator",
        choices=OPERATORS,
        default=default,
        help=f"Laplacian (default: {default or 'robust for meshes, delaunay for clouds'})",
    )
    group.add_argument(
        "--boundary",
        choices=("neumann", "dirichlet"),
        default="neumann",
        help=f"of a mesh with a boundary {DEFAULT}",
    )


def add_solver(
    parser: argparse.ArgumentParser,
    *,
    k: int | None = 96,
    default: str | None = "arpack",
    help_text: str = f"what solves {DEFAULT}",
    none: bool = False,
) -> argparse._ArgumentGroup:
    """Add the choice of the eigensolver; with `none` it may be left out."""
    group = parser.add_argument_group("solver")
    group.add_argument(
        "-k",
        type=int,
        default=k,
        help="number of modes " + (DEFAULT if k else "(default: as many as are shown)"),
    )
    group.add_argument(
        "--solver",
        choices=(*SOLVERS, "none") if none else SOLVERS,
        metavar="NAME",
        default=default,
        help=f"{help_text}; one of {', '.join(SOLVERS)}" + (", none" if none else ""),
    )
    group.add_argument(
        "--rtol",
        type=float,
        metavar="R",
        help=f"largest relative residual of {listed(TAKERS['rtol'])} (default: their own)",
    )
    group.add_argument(
        "--start",
        choices=("fourier", "neo", "random"),
        help=f"subspace that {listed(TAKERS['start'])} begin with (default: fourier)",
    )
    add_weights(group)
    group.add_argument("--poses", type=int, choices=(1, 2, 4), default=1, help=f"of neo {DEFAULT}")
    group.add_argument(
        "--dtype",
        choices=("float32", "bfloat16", "float16"),
        default="float32",
        metavar="TYPE",
        help=f"of neo: float32, bfloat16, float16 {DEFAULT}",
    )
    group.add_argument("--device", default="cpu", help=f"of neo: cpu, cuda {DEFAULT}")
    return group


def add_weights(group: argparse._ArgumentGroup) -> None:
    """Add the weights of the network."""
    completed(
        group.add_argument(
            "--weights",
            default="small",
            metavar="NAME",
            help=f"of neo: shipped ones by name, others by file {DEFAULT}",
        )
    )


def add_saved(group: argparse._ArgumentGroup, what: str = "modes") -> None:
    """Add the spectrum that is at hand already."""
    completed(
        group.add_argument(
            "--spectrum",
            type=Path,
            metavar="NPZ",
            help=f"take the {what} from this file, written by spectra-kit spectrum -o, and solve"
            " nothing",
        )
    )


def add_modes(group: argparse._ArgumentGroup, default: str = "a handful") -> None:
    """Add the choice of modes."""
    group.add_argument(
        "--modes",
        type=_integers,
        metavar="I,J,...",
        help=f"modes to show, counted from 0 (default: {default})",
    )


def add_output(
    group: argparse._ArgumentGroup,
    what: str,
    metavar: str,
    default: str | None = None,
    *,
    flags: Sequence[str] = ("-o", "--output"),
) -> None:
    """Add a file to write, or with the metavar FOLDER a folder."""
    completed(
        group.add_argument(
            *flags,
            type=Path,
            metavar=metavar,
            default=default and Path(default),
            help=f"{what} " + (DEFAULT if default else "(default: none)"),
        ),
        FOLDER if metavar == "FOLDER" else FILE,
    )


def add_dpi(group: argparse._ArgumentGroup) -> None:
    """Add how fine pictures are drawn."""
    group.add_argument(
        "--dpi",
        type=int,
        default=DRAWING["dpi"],
        metavar="N",
        help=f"pixels per inch, 600 for print {DEFAULT}",
    )


def add_drawing(group: argparse._ArgumentGroup, *, dpi: bool = True, turn: bool = True) -> None:
    """Add how pictures are drawn, and from where."""
    if dpi:
        add_dpi(group)
    group.add_argument(
        "--up",
        choices=("x", "y", "z"),
        help="axis that points up in the picture (default: chosen by the shape)",
    )
    if turn:
        group.add_argument(
            "--turn",
            type=float,
            default=DRAWING["turn"],
            metavar="DEGREES",
            help="turn it about that axis, its front to the right; 180 shows the other side"
            " (default: %(default)g)",
        )


def add_general(parser: argparse.ArgumentParser) -> None:
    """Add what every command takes."""
    group = parser.add_argument_group("general")
    group.add_argument("-h", "--help", action="help", help="show this and exit")
    group.add_argument(
        "--json", action="store_true", help="print one JSON object instead of tables"
    )
    group.add_argument("-q", "--quiet", action="store_true", help="show no progress")
    group.add_argument("--debug", action="store_true", help="show the traceback of an error")


def up_of(arguments: argparse.Namespace, file: str | None = None) -> Up | None:
    """Return the axis that points up: the one asked for, or that of the demo; None to look."""
    up: Up | None = arguments.up
    return up or ("z" if (file or arguments.file) == DEMO else None)


def _integers(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected numbers like 1,2,5,10, got {text!r}") from None
