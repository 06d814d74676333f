"""The command that says what is in a file."""

import dataclasses
from contextlib import nullcontext
from dataclasses import dataclass

import spectra_kit as sk
from spectra_kit._core.warn import hearing
from spectra_kit.cli import options, tables
from spectra_kit.cli.inputs import assemble, load
from spectra_kit.cli.output import tell
from spectra_kit.cli.progress import step
from spectra_kit.cli.words import told
from spectra_kit.errors import InvalidInputError


@dataclass(frozen=True, kw_only=True)
class InfoOptions(options.OnOne):
    """Say what a file holds, what is wrong with it and what can be made of it."""

    examples = ("info bunny.obj", "info scan.ply --repair", "info bunny.obj --json")
    keys = "input, kind, diagnosis, problems, operator"
    solves = False

    operator: options.OperatorName | None = "delaunay"
    """Laplacian; delaunay is robust on meshes, too, with less memory"""


def info(asked: InfoOptions) -> None:
    """Say what a file holds, what is wrong with it, and what the operator makes of it."""
    geometry, _ = load(asked.file, asked)
    with step("looking at it"):
        diagnosis = sk.geometry.diagnose(geometry)
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
