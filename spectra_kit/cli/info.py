"""The command that says what is in a file."""

from __future__ import annotations

import dataclasses

from spectra_kit.cli import program, tables
from spectra_kit.cli.inputs import assemble, load
from spectra_kit.cli.output import print_blocks, print_json
from spectra_kit.cli.progress import step
from spectra_kit.cli.words import told
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import diagnose


def info(asked: program.Info) -> None:
    """Say what a file holds, what is wrong with it, and what the operator makes of it."""
    geometry = load(asked.file, asked.reading)
    with step("looking at it"):
        diagnosis = diagnose(geometry)
    try:
        with step("assembling the Laplacian"):
            operator = tables.operator_record(assemble(asked.operator, geometry))
    except InvalidInputError as error:
        operator = {"refused": told(error)}
    if asked.general.json:
        print_json(
            input=asked.file,
            kind=tables.kind(geometry),
            diagnosis=dataclasses.asdict(diagnosis),
            problems=[told(problem) for problem in diagnosis.problems],
            operator=operator,
        )
        return
    print_blocks(tables.diagnosis_lines(asked.file, geometry, diagnosis), tables.pairs(operator))
