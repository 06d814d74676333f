"""From the command line to a command, and from its errors to a message and an exit code."""

from __future__ import annotations

import errno
import io
import os
import sys
import traceback
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from operator import attrgetter
from typing import Any, TextIO

import spectra_kit as sk
from spectra_kit._core.files import naming
from spectra_kit._core.shown import printable
from spectra_kit._core.version import VERSION
from spectra_kit.cli.options import refuse_unused
from spectra_kit.cli.program import UsageError, help_text, parse
from spectra_kit.cli.progress import STDOUT, telling
from spectra_kit.cli.words import told
from spectra_kit.errors import (
    ConvergenceError,
    InvalidSpectrumError,
    OutOfMemoryError,
    SpectraKitError,
)

_BUG, _BAD_INPUT, _SOLVER_FAILED, _INTERRUPTED = 1, 2, 3, 130


def main(argv: Sequence[str] | None = None, *, ready: Callable[[], object] = lambda: None) -> int:
    """Run ``spectra-kit``.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments; by default those of the process.
    ready : callable, optional
        Called once everything is imported, before the command begins.

    Returns
    -------
    int
        The exit code: 0 fine, 1 a bug of ours, 2 bad input, 3 a solver failed, 130 interrupted.

    Examples
    --------
    >>> from spectra_kit.cli import main
    >>> main(["spectrum", "demo", "--points", "600", "-k", "4", "--modes", "1"])
    demo: mesh, 600 vertices, 1,196 faces...
    0
    """
    is_program = argv is None
    if argv is None:
        _prepare_streams()
        argv = sys.argv[1:]
    asked: Any = None
    text = ""
    try:
        if argv[:1] == ["--version"]:
            text = f"spectra_kit {VERSION}\n"
        elif {"-h", "--help"}.intersection(argv):  # found here, it costs no console
            text = help_text(argv[0])
        else:
            asked, command = parse(argv)
            for name in asked.needs:
                attrgetter(name)(sk)
            ready()
            with telling(quiet=asked.quiet):
                refuse_unused(asked)
                with _two_compilers() if is_program and asked.solves else nullcontext():
                    command(asked)
        with naming(STDOUT):
            sys.stdout.write(text)
            sys.stdout.flush()
    except KeyboardInterrupt:
        _complain("interrupted")
        return _INTERRUPTED
    except Exception as error:  # noqa: BLE001  # a person reads this: a line, not a traceback
        if isinstance(error, BrokenPipeError) and error.filename in (None, STDOUT):
            _drop(sys.stdout)  # its reader, such as `head`, has seen enough
            return 0
        if asked is not None and asked.debug:
            sys.stderr.write(printable(traceback.format_exc(), lines=True))
        return _tell(error)
    return 0


def _tell(error: Exception) -> int:
    """Write the lines that an error deserves, behind what was printed; return its exit code."""
    try:
        sys.stdout.flush()
    except OSError:
        _drop(sys.stdout)
    code, message = _BAD_INPUT, told(error)
    if isinstance(error, UsageError):
        command = error.command
        _complain(command.usage if command else "usage: spectra-kit COMMAND FILE [options]")
        if "Did you mean" not in message:
            message += f"; see spectra-kit{f' {command.name}' if command else ''} --help"
    elif isinstance(error, ConvergenceError | InvalidSpectrumError | OutOfMemoryError):
        code = _SOLVER_FAILED
    elif isinstance(error, OSError) and not isinstance(error, SpectraKitError):
        what = (error.strerror or message).lower()
        message = f"{error.filename}: {what}" if error.filename else what
    elif isinstance(error, MemoryError):
        message = f"not enough memory ({message}); ask for fewer points or modes"
    elif not isinstance(error, SpectraKitError):
        code, found = _BUG, f"{type(error).__name__}: {message}"
        message = f"this is a bug of spectra_kit: {found}; please report it with what --debug shows"
    _complain(f"error: {printable(message)}")
    return code


def _complain(text: str) -> None:
    """Write a line to stderr; where that is full, the exit code has to do."""
    try:
        sys.stderr.write(f"{text}\n")
        sys.stderr.flush()
    except OSError:
        _drop(sys.stderr)


def _prepare_streams() -> None:
    """Let whatever is printed go somewhere: a closed stream nowhere, odd characters as they can."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.write(number, b"") if number else os.read(number, 0)
            closed = getattr(sys, name) is None
        except OSError as error:  # the number may be that of a file that Python reads now
            closed = error.errno == errno.EBADF
        if closed:  # else some output would get the number, and what is printed
            descriptor = os.open(os.devnull, os.O_RDWR)
            setattr(sys, name, os.fdopen(descriptor, "r" if number == 0 else "w"))
    if isinstance(sys.stdout, io.TextIOWrapper):
        # Names of files are any bytes; other encodings than UTF-8 lack most letters.
        unicode = sys.stdout.encoding.lower().startswith("utf")
        sys.stdout.reconfigure(errors="surrogateescape" if unicode else "backslashreplace")


def _drop(stream: TextIO) -> None:
    """Keep the interpreter from flushing into nowhere when it ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _two_compilers() -> AbstractContextManager[None]:
    from spectra_kit._sparse.first_call import compiled_beside

    return compiled_beside()
