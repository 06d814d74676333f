"""What each command accepts; distances along a surface have a file of their own."""

from __future__ import annotations

import argparse
from pathlib import Path

from spectra_kit.cli.options import (
    SOLVERS,
    add_dpi,
    add_drawing,
    add_file,
    add_general,
    add_input,
    add_modes,
    add_operator,
    add_output,
    add_reading,
    add_saved,
    add_solver,
    completed,
)

SHELLS = ("bash", "zsh", "tcsh")
_REPLACED = "a file of that name is replaced, once the new one is whole"
_PREDICTS = "what predicts (default: neo)"


def add_info_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``info``."""
    add_input(parser, file=None)
    # The same as the robust one, in a seventh of its memory.
    add_operator(parser, default="delaunay")
    add_general(parser)


def add_spectrum_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``spectrum``."""
    add_input(parser, file=None)
    add_operator(parser)
    group = add_solver(parser)
    group.add_argument(
        "--verify",
        action="store_true",
        help="count the eigenvalues to prove that no mode was missed (a few factorisations)",
    )
    group = parser.add_argument_group("output", _REPLACED)
    add_output(group, "write the spectrum to this .npz file", "NPZ")
    add_output(
        group,
        "draw eigenvalues, Weyl's law and residuals (.png, .pdf, .svg)",
        "PNG",
        flags=("--picture",),
    )
    add_dpi(group)
    add_modes(group)
    add_general(parser)


def add_modes_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``modes``."""
    add_input(parser, file=None)
    add_operator(parser)
    add_saved(add_solver(parser, k=None))
    group = parser.add_argument_group("output", _REPLACED)
    add_output(group, "the picture (.png, .pdf, .svg)", "PNG", "modes.png")
    add_modes(group, "the first 12 that are not constant")
    group.add_argument("--columns", type=int, metavar="N", help="modes in a row (default: as fits)")
    group.add_argument("--no-lines", action="store_true", help="leave the zero lines out")
    add_drawing(group)
    add_general(parser)


def add_animate_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``animate``."""
    add_input(parser, file=None)
    add_operator(parser)
    add_saved(add_solver(parser, k=None))
    group = parser.add_argument_group("output", _REPLACED)
    add_output(
        group,
        "the animation: .gif, or .mp4 where imageio-ffmpeg is installed",
        "GIF",
        "modes.gif",
    )
    add_modes(group, "the first 6 that are not constant")
    for option, kind, default, what in (
        ("--seconds", float, 2.0, "that each mode is shown"),
        ("--fps", int, 20, "frames per second"),
        ("--width", int, 480, "pixels"),
    ):
        group.add_argument(
            option, type=kind, metavar="N", default=default, help=f"{what} (default: %(default)s)"
        )
    add_drawing(group, dpi=False)
    add_general(parser)


def add_compare_arguments(
    parser: argparse.ArgumentParser, *, file: str | None = None, picture: str | None = None
) -> None:
    """Add the arguments of ``compare``; `file` and `picture` are defaults."""
    add_input(parser, file=file)
    add_operator(parser)
    _add_both_solvers(parser)
    group = parser.add_argument_group("output", _REPLACED)
    add_output(
        group,
        "draw exact | predicted | difference of the chosen modes (.png, .pdf, .svg)",
        "PNG",
        picture,
        flags=("-o", "--picture"),
    )
    add_modes(group)
    add_drawing(group)
    add_general(parser)


def add_explore_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``explore``."""
    add_input(parser, file=None)
    add_operator(parser)
    _add_both_solvers(parser, none=True)
    group = parser.add_argument_group("output", _REPLACED)
    either = group.add_mutually_exclusive_group()
    completed(
        either.add_argument(
            "-o",
            "--html",
            type=Path,
            metavar="HTML",
            help="the page to write: one file that needs no network (default: the name of FILE"
            " with .html, in the current folder)",
        )
    )
    either.add_argument(
        "--serve",
        action="store_true",
        help="serve the page to this machine alone, too, until Ctrl-C",
    )
    group.add_argument(
        "--max-points",
        type=int,
        default=50_000,
        metavar="N",
        help="show at most so many points of a larger geometry (default: %(default)s)",
    )
    group.add_argument(
        "--port", type=int, default=0, metavar="N", help="of --serve (default: a free one)"
    )
    group.add_argument(
        "--no-browser", action="store_true", help="with --serve, do not open a browser"
    )
    add_drawing(group, dpi=False, turn=False)  # the mouse does
    add_general(parser)


def add_match_arguments(
    parser: argparse.ArgumentParser, *, files: tuple[str, str] | None = None, output: str = "match"
) -> None:
    """Add the arguments of a match of two shapes; `files` and `output` are defaults."""
    group = parser.add_argument_group("input")
    for i, name in enumerate(("source", "target")):
        add_file(group, name, files and files[i])
    add_reading(group)
    completed(
        group.add_argument(
            "--landmarks",
            type=Path,
            metavar="TXT",
            help="corresponding points: a line for each with its number on the source and on the"
            " target, counted from 0",
        )
    )
    group.add_argument(
        "--sides",
        choices=("either", "kept", "reversed"),
        default="either",
        help="whether the map may mirror (default: %(default)s, mirrored only if that is clearly"
        " better)",
    )
    completed(
        group.add_argument(
            "--truth",
            type=Path,
            metavar="NPY",
            help="the true source point of each target point, to measure errors by (negative:"
            " unknown)",
        )
    )
    add_operator(parser)
    add_solver(parser, k=150)
    add_folder(parser, "for the maps, the report and the pictures", output)
    add_general(parser)


def add_folder(parser: argparse.ArgumentParser, what: str, default: str) -> argparse._ArgumentGroup:
    """Add the folder that a command fills, and how its pictures are drawn."""
    group = parser.add_argument_group(
        "output", "the folder is made; files of an earlier run in it are replaced"
    )
    add_output(group, what, "FOLDER", default)
    group.add_argument("--no-pictures", action="store_true", help="write numbers only")
    add_drawing(group)
    return group


def add_completion_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``completion``."""
    parser.add_argument("shell", metavar="SHELL", choices=SHELLS, help=" or ".join(SHELLS))
    add_general(parser)


def _add_both_solvers(parser: argparse.ArgumentParser, *, none: bool = False) -> None:
    """Add what predicts, and the truth it is held against."""
    group = add_solver(parser, default=None, help_text=_PREDICTS, none=none)
    group.add_argument(
        "--against",
        choices=SOLVERS,
        metavar="NAME",
        default="arpack",
        help="what solves for the truth, one of the same (default: %(default)s)",
    )
    add_saved(group, "modes to compare with")
