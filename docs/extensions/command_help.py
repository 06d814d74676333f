"""What ``spectra-kit --help`` and its commands print, written into ``docs/command_line.md``.

It stands in the file itself, where the repository shows it too. The build writes it, and so does
``python docs/extensions/command_help.py``; a test holds it to what the commands say.
"""

from __future__ import annotations

import io
import os
from contextlib import redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING
from unittest import mock

if TYPE_CHECKING:
    from sphinx.application import Sphinx

PAGE = Path(__file__).parents[1] / "command_line.md"
BEGIN = "<!-- written by docs/extensions/command_help.py -->\n"
_PLAIN = {"COLUMNS": "80", "NO_COLOR": "1"}  # whatever terminal prints it


def help_text(*command: str) -> str:
    """Return the help of a command, of the program itself where none is named."""
    from spectra_kit.cli import main

    printed = io.StringIO()
    with mock.patch.dict(os.environ, _PLAIN), redirect_stdout(printed):
        main([*command, "--help"])
    return "\n".join(map(str.rstrip, printed.getvalue().rstrip().splitlines()))


def help_section() -> str:
    """Return the help of the program, and a section with that of each command."""
    from spectra_kit.cli.program import COMMANDS

    boxes = [f"```text\n{help_text()}\n```\n"]
    boxes += [f"## {name}\n\n```text\n{help_text(name)}\n```\n" for name in COMMANDS]
    return "\n".join(boxes)


def whole(page: str) -> str:
    """Return the page with what the commands say today."""
    return page.partition(BEGIN)[0] + BEGIN + "\n" + help_section()


def write() -> None:
    """Bring the page up to date."""
    before = PAGE.read_text()
    if (now := whole(before)) != before:
        PAGE.write_text(now)


def setup(app: Sphinx) -> dict[str, bool]:
    write()
    return {"parallel_read_safe": True, "parallel_write_safe": True}


if __name__ == "__main__":
    write()
