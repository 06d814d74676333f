"""The commands that say what is in a file, and what a shell needs to complete a command line."""

from __future__ import annotations

import dataclasses
from contextlib import nullcontext

from spectra_kit._core.validate import hearing
from spectra_kit.cli import program, tables
from spectra_kit.cli.inputs import assemble, load
from spectra_kit.cli.output import tell
from spectra_kit.cli.progress import step
from spectra_kit.cli.words import told
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import diagnose


def info(asked: program.Info) -> None:
    """Say what a file holds, what is wrong with it, and what the operator makes of it."""
    geometry, _ = load(asked.file, asked)
    with step("looking at it"):
        diagnosis = diagnose(geometry)
    try:
        is_cut = diagnosis.seam_edges or diagnosis.hanging_vertices  # which the diagnosis tells
        told_of = hearing() if is_cut else nullcontext()
        with step("assembling the Laplacian"), told_of:
            operator = tables.operator_record(assemble(asked, geometry))
    except InvalidInputError as error:
        operator = {"refused": told(error)}
    record = {
        "input": asked.file,
        "kind": tables.kind(geometry),
        "diagnosis": dataclasses.asdict(diagnosis),
        "problems": [told(problem) for problem in diagnosis.problems],
        "operator": operator,
    }
    lines = tables.diagnosis_lines(asked.file, geometry, diagnosis)
    tell(asked, record, lines, tables.pairs(operator))


def completion(asked: program.Completion) -> None:
    """Print what a shell has to run."""
    script = program.app().generate_completion(shell=asked.shell)
    tell(asked, {"shell": asked.shell, "script": script}, script.removesuffix("\n"))
