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
        robust_laplacian cholespy libigl matplotlib numba llvmlite qdldl threadpoolctl tqdm \
        contourpy cycler fonttools kiwisolver packaging pillow pyparsing python-dateutil six

then copy the tree with .wheels there and run, from its root:

    pip install --no-index --no-deps .wheels/*.whl
    PYTHONPATH=. python apps/evaluate_neo.py all OUT --device cuda

The worst modes are drawn only where PyVista is installed too.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from spectra_kit.errors import InvalidInputError, MissingDependencyError, SpectraKitError
from spectra_kit.evaluation import (
    STUDIES,
    Answer,
    Bench,
    Model,
    Settings,
    Weights,
    demo_models,
    draw_worst,
    models_in,
    procedural_models,
    run_study,
    write_report,
    write_summary,
    write_training,
)

CHAPTERS = [*STUDIES, "training"]
# A small case of everything: seconds for each study.
_QUICK = {"k": 16, "points": [512, 1024], "focus": 1024, "poses": [1, 2], "fourier": []}
_QUICK |= {"bandwidths": [7.0], "rotations": 3, "worst": 1, "limit": 1, "procedural": 1}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="evaluate_neo.py",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
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
    try:
        weights = tuple(map(Weights, args.weights))
        if args.study != "training":
            _solve(args, weights)
        if args.study in ("all", "training"):
            _show_training(args, weights)
        print(f"report: {write_summary(args.out, CHAPTERS)}")
    except SpectraKitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"\nstopped; run the same command to continue {args.out}", file=sys.stderr)
        return 130
    return 0


def _solve(args: argparse.Namespace, weights: tuple[Weights, ...]) -> None:
    """Run the studies and print their chapters."""
    bench = Bench(args.out, k=args.k)
    settings = Settings(
        sets=_sets(args),
        weights=weights,
        agnostic=tuple(map(Weights, args.agnostic_weights)),
        points=tuple(args.points),
        focus=args.focus,
        few=args.few,
        poses=tuple(args.poses),
        fourier=tuple(args.fourier),
        bandwidths=tuple(args.bandwidths),
        rotations=args.rotations,
        device=args.device,
    )
    for name in STUDIES if args.study == "all" else [args.study]:
        answer = run_study(name, settings, bench, progress=True)
        pictures = _pictures(answer, bench, args.out / "figures", args.worst)
        print(write_report(answer, args.out, pictures=pictures).read_text(), flush=True)


def _show_training(args: argparse.Namespace, weights: tuple[Weights, ...]) -> None:
    """Print the chapter on training; among others it may be missing."""
    try:
        path = write_training([*weights, *map(Weights, args.agnostic_weights)], args.out)
        print(path.read_text(), flush=True)
    except InvalidInputError as error:
        if args.study == "training":
            raise
        print(f"training is not drawn: {error}", file=sys.stderr)


def _sets(args: argparse.Namespace) -> dict[str, tuple[Model, ...]]:
    """Real models and procedural ones; the demo where a quick trial finds no data."""
    sets: dict[str, tuple[Model, ...]] = {}
    root = os.environ.get("SPECTRA_KIT_DATA")
    folder = args.data or (Path(root) / "ood_public" if root else None)
    if folder is not None:
        sets["real"] = models_in(folder, args.limit)
    elif args.quick:
        sets["demo"] = demo_models(args.limit)
    if args.procedural:
        sets["procedural"] = procedural_models(args.procedural, seed=args.seed)
    return sets


def _pictures(answer: Answer, bench: Bench, folder: Path, count: int) -> list[Path]:
    if answer.name != "worst":
        return []
    folder.mkdir(parents=True, exist_ok=True)
    try:
        return draw_worst(answer, bench, folder, count=count)
    except MissingDependencyError as error:
        print(f"the worst modes are not drawn: {error}", file=sys.stderr)
        return []


if __name__ == "__main__":
    sys.exit(main())
