"""Completion in the shell: commands, options, their choices, and names of files."""

from __future__ import annotations

import argparse
import sys

import shtab

from spectra_kit.cli.output import print_json


def completion(arguments: argparse.Namespace) -> None:
    """Print what a shell has to run."""
    script = shtab.complete(arguments.root, arguments.shell)
    if arguments.json:
        print_json(shell=arguments.shell, script=script)
    else:
        sys.stdout.write(script)
