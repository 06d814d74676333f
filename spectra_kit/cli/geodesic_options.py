"""What the command for geodesic distances accepts."""

from __future__ import annotations

import argparse

from spectra_kit.cli.arguments import add_folder
from spectra_kit.cli.options import add_general, add_input, add_weights, completed, listed

LINEAR_SOLVERS = ("auto", "direct", "iterative", "projected", "plain")
MODES = 24  # of `Iterative`, which the help must not wait for
COMPARED_MODES = 96  # as many as the NEO paper takes
SPECTRA = ("none", "exact", "neo", "neo-polished")


def add_geodesic_arguments(
    parser: argparse.ArgumentParser, *, file: str | None = None, output: str = "geodesic"
) -> None:
    """Add the arguments of geodesic distances; `file` and `output` are defaults."""
    add_input(parser, file=file)
    _add_sources(parser)
    _add_method(parser)
    group = add_folder(parser, "for the distances, the report and the pictures", output)
    group.add_argument(
        "--compare",
        action="store_true",
        help="also solve by every solver, and draw and print how each converges",
    )
    group.add_argument(
        "--spacing", type=float, metavar="D", help="between two isolines (default: 20 to 40 lines)"
    )
    add_general(parser)


def _add_sources(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group(
        "sources", "the distance is to the nearest of them all; the demo has one by default"
    )
    group.add_argument(
        "--source",
        type=int,
        nargs="+",
        action="extend",
        default=[],
        metavar="INDEX",
        help="points of the file, counted from 0",
    )
    group.add_argument(
        "--at",
        type=float,
        nargs=3,
        action="append",
        default=[],
        metavar=("X", "Y", "Z"),
        help="the point of the surface nearest to this place (may be repeated)",
    )
    group.add_argument(
        "--face",
        type=float,
        nargs=4,
        action="append",
        default=[],
        metavar=("F", "B0", "B1", "B2"),
        help="a point of a face, by its barycentric coordinates (may be repeated)",
    )
    group.add_argument(
        "--farthest",
        type=int,
        default=0,
        metavar="N",
        help="add N points, each the farthest from all sources before it (the first, where there"
        " are none, from point 0)",
    )


def _add_method(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("method")
    group.add_argument(
        "--solver",
        choices=LINEAR_SOLVERS,
        metavar="NAME",
        default="auto",
        help="of the linear systems: direct, by a factor; or by conjugate gradients with"
        " incomplete Cholesky: plain, or with a coarse space of modes added (iterative) or"
        " projected out (projected) (default: %(default)s, whichever should be quicker)",
    )
    completed(
        group.add_argument(
            "--spectrum",
            default="none",
            metavar="NAME",
            help=f"modes for the coarse space: {listed(SPECTRA)}, or those of a file that"
            " spectra-kit spectrum wrote; left alone where auto solves directly (default:"
            " %(default)s)",
        )
    )
    group.add_argument(
        "--modes",
        type=int,
        metavar="K",
        help=f"nonzero modes to use (default: {MODES}, to compare {COMPARED_MODES})",
    )
    add_weights(group)
    group.add_argument(
        "--rtol",
        type=float,
        default=1e-8,
        metavar="R",
        help="relative residual at which iterations stop (default: %(default)g)",
    )
    group.add_argument(
        "--time-coefficient",
        type=float,
        default=1.0,
        metavar="C",
        help="the heat diffuses for C squared typical edge lengths; more is smoother (default:"
        " %(default)g)",
    )
    group.add_argument(
        "--boundary",
        choices=("neumann", "dirichlet", "average"),
        metavar="NAME",
        default="neumann",
        help="what heat does at a boundary: neumann, stay; dirichlet, leave;"
        " average, the mean of both (default: %(default)s)",
    )
