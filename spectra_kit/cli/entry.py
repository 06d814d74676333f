"""From the command line to a command, and from its errors to a message and an exit code."""

from __future__ import annotations

import argparse
import os
import sys
import traceback
from collections.abc import Callable, Sequence

from spectra_kit.cli.progress import telling
from spectra_kit.cli.story import build_parser
from spectra_kit.cli.words import in_options
from spectra_kit.errors import (
    ConvergenceError,
    InvalidSpectrumError,
    OutOfMemoryError,
    SpectraKitError,
)

_BUG, _BAD_INPUT, _SOLVER_FAILED, _INTERRUPTED = 1, 2, 3, 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``spectra-kit``.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments; by default those of the process.

    Returns
    -------
    int
        The exit code: 0 fine, 1 a bug of ours, 2 bad input, 3 a solver failed, 130 interrupted.

    Examples
    --------
    >>> main(["spectrum", "demo", "--points", "600", "-k", "4", "--modes", "1"])
    demo: mesh, 600 vertices, 1,196 faces...
    0
    """
    arguments, unknown = build_parser().parse_known_args(argv)
    if unknown:  # refused by the command's own parser, which knows what may have been meant
        arguments.parser.error(f"unrecognized arguments: {' '.join(unknown)}")
    return run(arguments.command, arguments)


def run(command: Callable[[argparse.Namespace], None], arguments: argparse.Namespace) -> int:
    """Run a command and tell its errors on stderr, in a line each.

    Parameters
    ----------
    command : callable
        Takes the arguments and writes to stdout.
    arguments : argparse.Namespace
        With ``debug``: show the traceback too; ``quiet``: no progress.

    Returns
    -------
    int
        The exit code, as in `main`.
    """
    try:
        with telling(quiet=arguments.quiet):
            command(arguments)
        sys.stdout.flush()
    except BrokenPipeError:  # the reader, such as `head`, has seen enough
        _drop_stdout()
        return 0
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        return _INTERRUPTED
    except Exception as error:  # noqa: BLE001  # a person reads this: a line, not a traceback
        if arguments.debug:
            traceback.print_exc()
        code, message = _told(error)
        _flush_stdout()
        sys.stderr.write(f"error: {message}\n")
        return code
    return 0


def _told(error: Exception) -> tuple[int, str]:
    """Return the exit code and the line that an error deserves."""
    if isinstance(error, ConvergenceError | InvalidSpectrumError | OutOfMemoryError):
        return _SOLVER_FAILED, in_options(str(error))
    if isinstance(error, SpectraKitError):
        return _BAD_INPUT, in_options(str(error))
    if isinstance(error, OSError):
        what = (error.strerror or str(error)).lower()
        return _BAD_INPUT, f"{error.filename}: {what}" if error.filename else what
    if isinstance(error, MemoryError):
        return _BAD_INPUT, f"not enough memory ({error}); ask for fewer points or modes"
    return _BUG, (
        f"this is a bug of spectra_kit: {type(error).__name__}: {error}; please report it with"
        " what --debug shows"
    )


def _flush_stdout() -> None:
    """Show what was printed before an error; a stdout that takes no more is dropped."""
    try:
        sys.stdout.flush()
    except OSError:
        _drop_stdout()


def _drop_stdout() -> None:
    """Keep the interpreter from flushing into nowhere when it ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
