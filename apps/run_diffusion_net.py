r"""Run DiffusionNet's own layers and published weights on our operators, and on its own.

    python apps/run_diffusion_net.py --peer FOLDER OUT
    python apps/run_diffusion_net.py --peer FOLDER --data DATA/tasks --vertices 100000 OUT

FOLDER holds the authors' package diffusion_net/ and pretrained/human_seg_hks_4x128.pth and
human_seg_xyz_4x128.pth; it is imported as it is, and needs scikit-learn beside what we need.
The weights tell the parts of human bodies; they are asked about the faces of the test bodies of
human_seg_meshcnn.npz, which are simplified to 1,500 faces, with operators of four makers. Then
the operators of one animal are made by each, and timed. OUT gets diffusion_net.md and .json.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from measure.command import exit_code, parser_of
from measure.learning.labelled import SEGMENTED, labelled_set
from measure.learning.published import INPUTS, Marks, Published, mark, seconds
from measure.machine import describe_machine, machine_line
from measure.shapes import data_folder
from measure.tables import table, write_json, write_markdown

from spectra_kit.geometry import creature


def _parser() -> argparse.ArgumentParser:
    parser = parser_of("run_diffusion_net.py", __doc__)
    add = parser.add_argument
    add("out", type=Path, help="folder for the report")
    add("--peer", type=Path, required=True, help="folder of the authors' package and weights")
    add("--data", type=Path, help="folder of the sets (default: $SPECTRA_KIT_DATA/tasks)")
    add("--bodies", type=int, help="only so many test bodies")
    add("--vertices", type=int, default=100_000, help="of the mesh that is timed (%(default)s)")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, write and print the report; return the exit code."""
    args = _parser().parse_args(argv)
    return exit_code(lambda: _run(args))


def _run(args: argparse.Namespace) -> None:
    published = Published.from_folder(args.peer)
    bodies = labelled_set("human", args.data or data_folder("tasks"), SEGMENTED)
    chosen = bodies.test[: args.bodies].tolist()
    marks = mark(published, bodies, chosen, told=lambda line: print(line, file=sys.stderr))
    mesh = creature(args.vertices)
    times = seconds(published, mesh)
    machine = describe_machine(threads=torch.get_num_threads())
    args.out.mkdir(parents=True, exist_ok=True)
    write_json(
        args.out / "diffusion_net.json",
        {
            "marks": marks,
            "bodies": chosen,
            "seconds": times,
            "vertices": mesh.n,
            "machine": machine,
        },
    )
    print(
        write_markdown(
            args.out / "diffusion_net.md",
            [
                "# DiffusionNet's layers and published weights, on operators of several makers",
                f"Faces labelled right, in percent, on {len(chosen)} test bodies: mean, and worst"
                " body; the difference from their own operators in points; and faces labelled as"
                " with these, right or wrong.",
                _accuracy(marks, chosen),
                f"Seconds of CPU time for all seven tensors of an animal of {mesh.n} vertices, 128"
                " modes.",
                _seconds(times),
                machine_line(machine),
            ],
        )
    )


def _accuracy(marks: list[Marks], chosen: list[int]) -> str:
    theirs = {inputs: next(m for m in marks if m.inputs == inputs) for inputs in INPUTS}
    return table(
        ("operators", "inputs", "mean", "difference", "worst", "body", "same labels"),
        [
            (
                *(one.maker, one.inputs, f"{one.right.mean():.2f}"),
                f"{one.right.mean() - theirs[one.inputs].right.mean():+.2f}",
                f"{one.right.min():.2f}",
                str(chosen[int(np.argmin(one.right))]),
                f"{one.as_theirs.mean():.2f}",
            )
            for inputs in INPUTS
            for one in marks
            if one.inputs == inputs
        ],
    )


def _seconds(times: dict[str, dict[str, float]]) -> str:
    def row(name: str, stages: dict[str, float]) -> tuple[str, ...]:
        parts = ", ".join(f"{stage} {value:.2f}" for stage, value in stages.items())
        return name, f"{sum(stages.values()):.1f}", parts if len(stages) > 1 else ""

    return table(("operators", "seconds", "stages"), [row(*item) for item in times.items()])


if __name__ == "__main__":
    sys.exit(main())
