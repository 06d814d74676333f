"""How the command line is read, and how its help looks."""

from __future__ import annotations

import argparse
import difflib
import re
import shutil
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

WIDTH = 80  # lines of help are at most this long, and shorter on a narrower terminal
_OPTION_COLUMN = 24


class Parser(argparse.ArgumentParser):
    """A parser whose refusals say what may have been meant.

    Parameters
    ----------
    prog : str
        Name of the program, with its command.
    usage : str
        Its one line; argparse's own would list every option again.
    purpose : str
        What the command does, as the help begins.
    examples : sequence of str
        Whole command lines.
    notes : str
        The end of the help.
    """

    def __init__(
        self,
        prog: str,
        *,
        usage: str = "%(prog)s FILE [options]",
        purpose: str = "",
        examples: Sequence[str] = (),
        notes: str = "",
    ) -> None:
        shown = "\n".join(f"  {line}" for line in examples)
        super().__init__(
            prog=prog,
            usage=usage,
            description=purpose + (f"\n\nexamples:\n{shown}" if examples else ""),
            epilog=notes,
            formatter_class=_Formatter,
            add_help=False,  # it has its place among the general options
        )

    def error(self, message: str) -> NoReturn:
        """Refuse the command line: one line of usage, what is wrong, what to do; exit code 2."""
        hint = meant(message, self.format_help())
        more = f"see {self.prog} --help"
        self.exit(2, f"{self.format_usage()}error: {message.removesuffix('.')}; {hint or more}\n")

    def _print_message(self, message: str, file: Any = None) -> None:
        """Print; argparse's own would keep a full disk behind the stream to itself."""
        (file or sys.stderr).write(message)


class _Formatter(argparse.RawDescriptionHelpFormatter):
    """Paragraphs as they are written, options in two columns."""

    def __init__(self, prog: str) -> None:
        width = min(shutil.get_terminal_size().columns, WIDTH) - 1
        super().__init__(prog, max_help_position=_OPTION_COLUMN, width=width)


def meant(message: str, help_text: str) -> str:
    """Return "did you mean ...?" for a word that argparse refused, or nothing.

    Examples
    --------
    >>> from spectra_kit.cli.parser import meant
    >>> meant("argument --solver: invalid choice: 'apack' (choose from 'arpack', 'neo')", "")
    "did you mean 'arpack'?"
    >>> meant("unrecognized arguments: --sovler", "--solver NAME  what solves")
    "did you mean '--solver'?"
    >>> meant("unrecognized arguments: --ks 5", "-k K  number of modes, --seed N  of all")
    "did you mean '-k'?"
    """
    if choice := re.search(r"invalid choice: '([^']*)' \(choose from (.*)\)", message):
        wrong, known = choice[1], re.findall(r"[\w-]+", choice[2])
    elif option := re.search(r"unrecognized arguments: (--[\w-]+)", message):
        wrong, known = option[1], re.findall(r"(?<![\w-])--?[a-z][\w-]*", help_text)
    else:
        return ""
    return did_you_mean(wrong, known)


def did_you_mean(wrong: str, known: Sequence[str]) -> str:
    """Return "did you mean ...?" with the likeliest of `known`, or nothing if none is near."""
    near = difflib.get_close_matches(wrong, known, n=1)
    return f"did you mean {near[0]!r}?" if near else ""
