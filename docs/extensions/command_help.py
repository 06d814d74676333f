"""The directive ``command-help``: what ``spectra-kit --help`` and its commands print today."""

from __future__ import annotations

import io
import os
from contextlib import redirect_stdout
from unittest import mock

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

_PLAIN = {"COLUMNS": "80", "NO_COLOR": "1"}  # whatever terminal builds the pages


def help_text(*command: str) -> str:
    """Return the help of a command, of the program itself where none is named."""
    from spectra_kit.cli import main

    printed = io.StringIO()
    with mock.patch.dict(os.environ, _PLAIN), redirect_stdout(printed):
        main([*command, "--help"])
    return printed.getvalue().rstrip()


class CommandHelp(SphinxDirective):
    """The help of the program, and a section with that of each command."""

    def run(self) -> list[nodes.Node]:
        from spectra_kit.cli.program import COMMANDS

        content: list[nodes.Node] = [self._box()]
        for command in COMMANDS:
            section = nodes.section(ids=[nodes.make_id(command.name)], names=[command.name])
            section += nodes.title("", "", nodes.literal("", command.name))
            section += self._box(command.name)
            content.append(section)
        return content

    def _box(self, *command: str) -> nodes.literal_block:
        text = help_text(*command)
        if not text.startswith("usage"):
            raise self.error(f"no help came from: spectra-kit {' '.join(command)}")
        return nodes.literal_block(text, text, language="text")


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_directive("command-help", CommandHelp)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
