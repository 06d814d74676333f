"""From the command line to a command, and from its errors to a message and an exit code."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence

from spectra_kit._version import VERSION
from spectra_kit.cli import commands, options
from spectra_kit.cli.geodesic import geodesic_distances
from spectra_kit.cli.geodesic_options import add_geodesic_arguments
from spectra_kit.cli.match import match_shapes
from spectra_kit.errors import (
    ConvergenceError,
    InvalidSpectrumError,
    OutOfMemoryError,
    SpectraKitError,
)

_BAD_INPUT, _SOLVER_FAILED, _INTERRUPTED = 2, 3, 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``spectra-kit``.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments; by default those of the process.

    Returns
    -------
    int
        The exit code: 0 fine, 2 bad input, 3 a solver failed, 130 interrupted.

    Examples
    --------
    >>> main(["spectrum", "demo", "--points", "600", "-k", "4", "--modes", "1"])
    demo: mesh, 600 vertices, 1,196 faces...
    0
    """
    parser = argparse.ArgumentParser(
        prog="spectra-kit",
        description="Laplace-Beltrami eigenvalues and eigenfunctions of meshes and point clouds,"
        " each with a certificate of its accuracy.",
    )
    parser.add_argument("--version", action="version", version=f"spectra_kit {VERSION}")
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND")
    for name, summary, add_arguments, command in (
        ("spectrum", "compute the lowest modes", options.add_spectrum_arguments, commands.spectrum),
        (
            "compare",
            "set predicted modes beside exact ones",
            options.add_compare_arguments,
            commands.compare,
        ),
        (
            "match",
            "find the point of one shape that each point of another is",
            options.add_match_arguments,
            match_shapes,
        ),
        (
            "geodesic",
            "measure distances along a surface",
            add_geodesic_arguments,
            geodesic_distances,
        ),
        ("info", "say what a file holds and needs", options.add_info_arguments, commands.info),
    ):
        subparser = subparsers.add_parser(name, help=summary, description=summary.capitalize())
        add_arguments(subparser)
        subparser.set_defaults(command=command)
    arguments = parser.parse_args(argv)
    return run(arguments.command, arguments)


def run(command: Callable[[argparse.Namespace], None], arguments: argparse.Namespace) -> int:
    """Run a command and tell its errors on stderr.

    Parameters
    ----------
    command : callable
        Takes the arguments and writes to stdout.
    arguments : argparse.Namespace
        With ``debug``: show the traceback instead.

    Returns
    -------
    int
        The exit code, as in `main`.
    """
    try:
        command(arguments)
        sys.stdout.flush()
    except BrokenPipeError:  # the reader, such as `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        return _INTERRUPTED
    except (SpectraKitError, OSError) as error:
        if arguments.debug:
            raise
        sys.stderr.write(f"error: {error}\n")
        failed = isinstance(error, ConvergenceError | InvalidSpectrumError | OutOfMemoryError)
        return _SOLVER_FAILED if failed else _BAD_INPUT
    except MemoryError as error:
        if arguments.debug:
            raise
        sys.stderr.write(f"error: not enough memory ({error}); ask for fewer points or modes\n")
        return _BAD_INPUT
    return 0
