"""What the commands that measure have in common."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable

from spectra_kit.errors import SpectraKitError


def parser_of(name: str, doc: str | None) -> argparse.ArgumentParser:
    """Return a parser that shows the text of a command as it is."""
    return argparse.ArgumentParser(
        prog=name, description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def add_threads(parser: argparse.ArgumentParser) -> None:
    """Add ``--threads`` and ``--machine``, which decide seconds."""
    cores = os.cpu_count() or 1
    parser.add_argument(
        "--threads", type=int, default=cores, help="for all alike (default: all cores)"
    )
    parser.add_argument("--machine", default="", help="name for the record (default: the host's)")


def exit_code(work: Callable[[], object]) -> int:
    """Do the work of a command: 0, 1 for False, 2 for an error that is told, 130 after Ctrl-C."""
    try:
        answer = work()
    except SpectraKitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\nstopped; the same command goes on from here", file=sys.stderr)
        return 130
    return int(answer is False)
