"""What the commands accept."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

DEMO = "demo"
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


def listed(names: Sequence[str]) -> str:
    """Return ``a, b and c``."""
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def add_spectrum_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``spectrum``."""
    add_input(parser, file=None)
    _add_operator(parser)
    _add_solver(parser)
    parser.add_argument("--solver", choices=SOLVERS, default="arpack", help="default: %(default)s")
    parser.add_argument(
        "--verify",
        action="store_true",
        help="count the eigenvalues to prove that no mode was missed (a few factorisations)",
    )
    parser.add_argument(
        "-o", "--output", type=Path, metavar="NPZ", help="write the spectrum to this .npz file"
    )
    _add_modes(parser)


def add_compare_arguments(
    parser: argparse.ArgumentParser, *, file: str | None = None, picture: str | None = None
) -> None:
    """Add the arguments of ``compare``; `file` and `picture` are defaults."""
    add_input(parser, file=file)
    _add_operator(parser)
    _add_solver(parser)
    parser.add_argument(
        "--solver",
        choices=SOLVERS,
        help="what predicts (default: neo where weights are shipped, else fourier)",
    )
    parser.add_argument(
        "--against", choices=SOLVERS, default="arpack", help="the truth (default: %(default)s)"
    )
    parser.add_argument(
        "--picture",
        type=Path,
        metavar="PNG",
        default=picture and Path(picture),
        help="draw exact | predicted | difference of the chosen modes"
        + (" (default: %(default)s)" if picture else ""),
    )
    _add_modes(parser)


def add_match_arguments(
    parser: argparse.ArgumentParser, *, files: tuple[str, str] | None = None, output: str = "match"
) -> None:
    """Add the arguments of a match of two shapes; `files` and `output` are defaults."""
    group = parser.add_argument_group("input")
    for i, name in enumerate(("source", "target")):
        _add_file(group, name, files and files[i])
    _add_reading(group)
    group.add_argument(
        "--landmarks",
        type=Path,
        metavar="TXT",
        help="corresponding points: a line for each with its number on the source and on the"
        " target, counted from 0",
    )
    group.add_argument(
        "--sides",
        choices=("either", "kept", "reversed"),
        default="either",
        help="whether the map may mirror (default: only if that is clearly better)",
    )
    group.add_argument(
        "--truth",
        type=Path,
        metavar="NPY",
        help="the true source point of each target point, to measure errors by (negative: unknown)",
    )
    _add_operator(parser)
    _add_solver(parser)
    parser.set_defaults(k=150)
    parser.add_argument("--solver", choices=SOLVERS, default="arpack", help="default: %(default)s")
    group = parser.add_argument_group("output")
    group.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FOLDER",
        default=Path(output),
        help="for the maps, the report and the pictures (default: %(default)s)",
    )
    group.add_argument("--no-pictures", action="store_true", help="write maps and report only")
    group.add_argument("--dpi", type=int, default=200, help="of the pictures (%(default)s)")
    group.add_argument(
        "--up", choices=("y", "z"), help="axis that points up in the picture (default: it looks)"
    )


def add_info_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``info``."""
    add_input(parser, file=None)
    _add_operator(parser)


def add_input(parser: argparse.ArgumentParser, *, file: str | None) -> None:
    """Add the file and how it is read."""
    group = parser.add_argument_group("input")
    _add_file(group, "file", file)
    _add_reading(group)


def _add_file(group: argparse._ArgumentGroup, name: str, default: str | None) -> None:
    group.add_argument(
        name,
        metavar=name.upper(),
        nargs="?" if default else None,
        default=default,
        help=f"a mesh or point cloud (obj, off, ply, stl, glb, gltf, xyz, npy, npz), or"
        f" {DEMO!r} for a procedural animal" + (" (default: %(default)s)" if default else ""),
    )


def _add_reading(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--points", type=int, default=8000, metavar="N", help="vertices of the demo (%(default)s)"
    )
    group.add_argument("--cloud", type=int, metavar="N", help="sample N points on the mesh")
    group.add_argument("--seed", type=int, default=0, help="of everything random (%(default)s)")
    group.add_argument(
        "--repair",
        action="store_true",
        help="merge duplicates, drop degenerate faces and unused vertices, and say what was done",
    )
    group.add_argument("--json", action="store_true", help="print JSON instead of tables")
    group.add_argument("--debug", action="store_true", help="show the traceback of an error")


def _add_operator(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("operator")
    group.add_argument(
        "--operator",
        choices=OPERATORS,
        help="Laplacian (default: robust for meshes, delaunay for clouds)",
    )
    group.add_argument(
        "--boundary",
        choices=("neumann", "dirichlet"),
        default="neumann",
        help="of a mesh with a boundary (default: %(default)s)",
    )


def _add_solver(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("solver")
    group.add_argument("-k", type=int, default=96, help="number of modes (default: %(default)s)")
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
    group.add_argument(
        "--weights", default="small", metavar="NAME|FILE", help="of neo (default: %(default)s)"
    )
    group.add_argument(
        "--poses", type=int, choices=(1, 2, 4), default=1, help="of neo (default: %(default)s)"
    )
    group.add_argument(
        "--dtype",
        choices=("float32", "bfloat16", "float16"),
        default="float32",
        help="of neo (default: %(default)s)",
    )
    group.add_argument("--device", default="cpu", help="of neo: cpu, cuda (default: %(default)s)")


def _add_modes(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--modes",
        type=_integers,
        metavar="I,J,...",
        help="modes to show, counted from 0 (default: a handful)",
    )


def _integers(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected numbers like 1,2,5,10, got {text!r}") from None
