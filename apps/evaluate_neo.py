r"""Measure the network: its accuracy, precision, redundancy, worst models and more.

Every number and figure at once, or one study:

    python apps/evaluate_neo.py all OUT
    python apps/evaluate_neo.py accuracy OUT --points 2048 8192 --limit 5

OUT gets a Markdown and a JSON file for each study, figures, and what was measured: the same command
after an interruption, or with more models, computes only what is missing. `training` solves
nothing: it draws the validations that lie in the weights files.

On a machine with PyTorch but no network and nothing installed, such as one lent for its GPU, first
fetch the other packages where there is a network (--python-version is the other machine's):

    pip download -d .wheels --only-binary=:all: --no-deps --python-version 3.12 \
        robust_laplacian libigl matplotlib numba llvmlite threadpoolctl tqdm \
        contourpy cycler fonttools kiwisolver packaging pillow pyparsing python-dateutil six

then copy the tree with .wheels there and run, from its root:

    pip install --no-index --no-deps .wheels/*.whl
    PYTHONPATH=. python apps/evaluate_neo.py all OUT --device cuda

The worst modes are drawn only where PyVista is installed too.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from measure.command import exit_code, parser_of
from measure.network.cases import procedural_shapes
from measure.network.questions import QUESTIONS, Answer, Settings, ask
from measure.network.report import draw_worst, write_answer, write_summary
from measure.network.training import write_training
from measure.shapes import Shape, data_folder, demo_shapes, shapes_in
from measure.store import Store

from spectra_kit.errors import InvalidInputError, MissingDependencyError

CHAPTERS = [*QUESTIONS, "training"]
# A small case of everything: seconds for each study.
_QUICK = {"k": 16, "points": [512, 1024], "focus": 1024, "poses": [1, 2], "fourier": []}
_QUICK |= {"bandwidths": [7.0], "rotations": 3, "worst": 1, "limit": 1, "procedural": 1}


def _parser() -> argparse.ArgumentParser:
    parser = parser_of("evaluate_neo.py", __doc__)
    add = parser.add_argument
    add("study", choices=["all", *CHAPTERS], help="what to measure")
    add("out", type=Path, help="folder for reports, figures and measurements")
    add("--weights", nargs="+", default=["small"], help="names or files (default: small)")
    add("--agnostic-weights", nargs="*", default=[], help="files trained without masses")
    add("--data", type=Path, help="folder of meshes (default: $SPECTRA_KIT_DATA/ood_public)")
    add("--limit", type=int, help="only the first so many of these")
    add("--procedural", type=int, default=32, help="unseen procedural models (%(default)s)")
    add("--seed", type=int, default=777, help="of these; none that training used (%(default)s)")
    add("-k", type=int, default=96, help="modes (%(default)s)")
    add("--points", type=int, nargs="+", default=[512, 2048, 8192, 65536], help="on each model")
    add("--few", type=int, help="only so many models of each set beyond 16,384 points")
    add("--focus", type=int, default=8192, help="points in studies of one number (%(default)s)")
    add("--poses", type=int, nargs="+", default=[1, 2, 4], help="of the networks")
    add("--fourier", type=int, nargs="*", default=[640], help="functions of AmbientFourier")
    add("--bandwidths", type=float, nargs="+", default=[7.0, 10.0], help="of AmbientFourier")
    add("--rotations", type=int, default=10, help="of each cloud (%(default)s)")
    add("--worst", type=int, default=3, help="models to draw (%(default)s)")
    add("--device", default="cpu", help="of networks and dense algebra (%(default)s)")
    add("--quick", action="store_true", help="a small case of everything, also without data")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Evaluate and print; return the exit code."""
    args = _parser().parse_args(argv)
    if args.quick:
        vars(args).update(_QUICK)
    return exit_code(lambda: _evaluate(args))


def _evaluate(args: argparse.Namespace) -> None:
    if args.study != "training":
        settings = Settings(
            sets=_sets(args),
            weights=tuple(args.weights),
            agnostic=tuple(args.agnostic_weights),
            k=args.k,
            points=tuple(args.points),
            focus=args.focus,
            few=args.few,
            poses=tuple(args.poses),
            fourier=tuple(args.fourier),
            bandwidths=tuple(args.bandwidths),
            rotations=args.rotations,
            device=args.device,
        )
        store = Store(args.out)
        for name in QUESTIONS if args.study == "all" else [args.study]:
            answer = ask(name, settings, store, progress=True)
            pictures = _pictures(answer, args.out / "figures", args.worst)
            print(write_answer(answer, args.out, pictures=pictures), flush=True)
    if args.study in ("all", "training"):
        try:
            print(write_training([*args.weights, *args.agnostic_weights], args.out), flush=True)
        except InvalidInputError as error:
            if args.study == "training":
                raise
            print(f"training is not drawn: {error}", file=sys.stderr)
    print(f"report: {write_summary(args.out, CHAPTERS)}")


def _sets(args: argparse.Namespace) -> dict[str, tuple[Shape, ...]]:
    """Real models and procedural ones; the demo where a quick trial finds no data."""
    sets: dict[str, tuple[Shape, ...]] = {}
    folder = args.data or data_folder("ood_public")
    if folder is not None:
        sets["real"] = shapes_in(folder, args.limit)
    elif args.quick:
        sets["demo"] = demo_shapes(args.limit)
    if args.procedural:
        sets["procedural"] = procedural_shapes(args.procedural, seed=args.seed)
    return sets


def _pictures(answer: Answer, folder: Path, count: int) -> list[Path]:
    if answer.name != "models":
        return []
    folder.mkdir(parents=True, exist_ok=True)
    try:
        return draw_worst(answer, folder, count=count)
    except MissingDependencyError as error:
        print(f"the worst modes are not drawn: {error}", file=sys.stderr)
        return []


if __name__ == "__main__":
    sys.exit(main())
