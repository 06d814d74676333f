"""Completion in the shell: commands, options, their choices, and names of files."""

from __future__ import annotations

import sys

from spectra_kit.cli import program
from spectra_kit.cli.output import print_json


def completion(asked: program.Completion) -> None:
    """Print what a shell has to run."""
    script = program.app().generate_completion(shell=asked.shell)
    if asked.general.json:
        print_json(shell=asked.shell, script=script)
    else:
        sys.stdout.write(script)
