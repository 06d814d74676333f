r"""Measure the network: its accuracy, precision, redundancy, worst models and more.

Every number and figure at once, or one question:

    python apps/studies/run.py network OUT all
    python apps/studies/run.py network OUT accuracy --points 2048 8192 --limit 5

OUT gets tables of each question, and pictures of the worst modes. `training` solves nothing: it
draws the validations that lie in the weights files. Figures are statistics over models of each
model's mean over modes; times are medians of wall time and leave out assembly and certificates: the
study `eigensolvers` compares them better.

- precision: the dense algebra is float64 throughout.
- sampling: of non-uniform samples the density falls off like a Gaussian around a random point.
  `masses of one` gives the attention of the same network equal masses; frame and Rayleigh-Ritz keep
  the true ones.
- operators: the network saw Laplacians of clouds in training. Meshes enter with their vertices as
  points. Each operator has its own exact modes.
- redundancy: one network for each m.
- rotation: each cloud in several random rotations, with the operator it had: the spread is the
  network's and the frame's alone.
- models: `Neo()` by default, the worst model first, beside plane waves of equal m that are smoothed
  alike: by one step each, and until the same target is met. *Before*: in the span of all functions;
  *after*: in that of the modes. Ratios are those of the waves' error to the network's, with
  geometric means; the worst ratio is the least. The worst modes are drawn where PyVista is
  installed.
- training: span errors of the validation samples during the last run of each network, as predicted
  and, where that was measured, after the smoothing of the loss. The law, error = c (samples +
  s0)^-p, is fitted to logarithms of all of them, so it goes through validations at rates that had
  not fallen yet. *Promise*: how many times less error ten times the hours of the run promise.

What the paper tells of the same (see `paper`) stands beside it.

On a machine with PyTorch but no network and nothing installed, such as one lent for its GPU, first
fetch the other packages where there is a network (--python-version is the other machine's):

    pip download -d .wheels --only-binary=:all: --no-deps --python-version 3.12 \
        robust_laplacian libigl matplotlib numba llvmlite threadpoolctl tqdm \
        contourpy cycler fonttools kiwisolver packaging pillow pyparsing python-dateutil six

then copy the tree with .wheels there and run, from its root:

    pip install --no-index --no-deps .wheels/*.whl
    PYTHONPATH=. python apps/studies/run.py network OUT all --device cuda
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np
import torch

from spectra_kit._core.types import Floats
from spectra_kit.errors import InvalidInputError
from spectra_kit.show import Page, plot_comparison
from studies import paper
from studies.machine import describe_machine
from studies.network.cases import procedural_shapes
from studies.network.findings import (
    WORST,
    Beside,
    Labels,
    Row,
    beside,
    lead,
    mean,
    over,
    worst,
)
from studies.network.questions import QUESTIONS, Answer, Settings, ask
from studies.network.training import write_training
from studies.report import Table, unless_missing, write_report
from studies.shapes import Shape, data_folder, demo_shapes, shapes_in
from studies.store import Record, Store

CHAPTERS = [*QUESTIONS, "training"]
ERRORS = {"span": "span error", "vector": "eigenvector error", "value": "eigenvalue error"}
_DRAWN = 3  # modes of a shape
# A small case of everything: seconds for each question.
_QUICK = {"k": 16, "points": [512, 1024], "focus": 1024, "poses": [1, 2], "fourier": []}
_QUICK |= {"bandwidths": [7.0], "rotations": 3, "worst": 1, "limit": 1, "procedural": 1}


def options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("question", choices=["all", *CHAPTERS], help="what to measure")
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


def measure(args: argparse.Namespace) -> None:
    if args.quick:
        vars(args).update(_QUICK)
    if args.question != "training":
        names = {field.name for field in fields(Settings)} & vars(args).keys()
        given = {name: getattr(args, name) for name in names}
        settings = Settings(sets=_sets(args), agnostic=args.agnostic_weights, **given)
        store = Store(args.out)
        for name in QUESTIONS if args.question == "all" else [args.question]:
            answer = ask(name, settings, store, progress=True)
            write_answer(answer, args.out, worst=args.worst)
    if args.question in ("all", "training"):
        try:
            write_training([*args.weights, *args.agnostic_weights], args.out)
        except InvalidInputError as error:
            if args.question == "training":
                raise
            print(f"training is not drawn: {error}", file=sys.stderr)


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


# --- tables ---


def write_answer(answer: Answer, folder: Path, *, worst: int = 0) -> Path:
    """Write the tables of a question, and draw so many of the worst models."""
    rows, drawn = [row for row in answer.rows if row.cases], list[Path]()
    if answer.name == "models" and worst:
        (folder / "figures").mkdir(parents=True, exist_ok=True)
        with unless_missing("the worst modes are"):
            drawn += draw_worst(answer, folder / "figures", count=worst)
    names = dict.fromkeys((name for row in rows for name in row.labels), "")
    errors = {
        f"{title}, {figure}": ".3g"
        for title in ERRORS.values()
        for figure in ("mean", "std", "median", "iqr", "the paper's")
    }
    times = {_over(labels): ".3g" for labels in answer.question.against}
    times |= {_LEAD: ".3g"} if answer.name == "accuracy" else {}
    seconds = {"seconds": ".2f", "exact s": ".2f"}
    shown = {**names, "functions": "d", "clouds": "d", **errors, **times, **seconds}
    tables = [
        Table(answer.question.title, [_told(row, rows, answer) for row in rows], shown),
    ]
    if answer.name == "rotation":
        spread = dict.fromkeys(("std / mean", "max / min"), ".3f")
        tables[0] = Table(
            answer.question.title,
            [_spread_of(row) for row in rows],
            {**names, "rotations": "d", "mean span error": ".3g", **spread},
        )
    if answer.name == "models":
        tables[:1] = [
            Table(str(one.place), _ranked(one), {"model": "", **dict.fromkeys(one.columns, ".3g")})
            for one in beside(rows)
        ]
    device = "cuda" if torch.cuda.is_available() else "cpu"
    machine = describe_machine(threads=torch.get_num_threads(), device=device)
    return write_report(folder, answer.name, answer.results, tables, machine, figures=drawn)


_LEAD = "times less than as many waves"


def _over(labels: Labels) -> str:
    return f"over {', '.join(map(str, labels.values()))}"


def _told(row: Row, rows: Sequence[Row], answer: Answer) -> Record:
    """Statistics over cases of each error, with the mean of each case, the paper's, and ratios."""
    record: Record = {**row.labels, "method": row.method.facts, "functions": row.method.columns}
    record |= {"clouds": len(row.cases), "seconds": row.seconds, "exact s": row.exact_seconds}
    record |= {_over(labels): over(row, rows, **labels) for labels in answer.question.against}
    record[_LEAD] = lead(row, rows)
    theirs = _told_by_paper(answer.name, row)
    for error, title in ERRORS.items():
        means = row.means(error)
        record |= {f"{title}, {name}": value for name, value in statistics(means).items()}
        record[f"{title}, the paper's"] = getattr(theirs, error, None)
        record[f"{title}, of each"] = dict(
            zip((str(case.shape) for case in row.cases), means.tolist(), strict=True)
        )
    return record


def statistics(values: Floats) -> dict[str, float]:
    """Return mean, standard deviation (of the population), median, quartiles and their range."""
    low, median, high = map(float, np.percentile(values, (25, 50, 75)))
    spread = {"median": median, "q25": low, "q75": high, "iqr": high - low}
    return {"mean": float(values.mean()), "std": float(values.std()), **spread}


def _told_by_paper(question: str, row: Row) -> paper.Told | None:
    """Return the paper's figures where the row is the network's alone, in one pose, unsmoothed."""
    alone = row.method.poses == 1 and row.method.solver is None
    return paper.errors_told(question, row.labels) if alone else None


def _spread_of(row: Row) -> Record:
    means = row.means()
    return {
        **{**row.labels, "rotations": len(means), "mean span error": means.mean()},
        **{"std / mean": means.std() / means.mean(), "max / min": means.max() / means.min()},
    }


def _ranked(one: Beside) -> list[Record]:
    """Return a row for each model, the worst first, and for the mean and the worst of all."""
    rows: list[Record] = [
        {"model": str(one.cases[i].shape), **{name: x[i] for name, x in one.columns.items()}}
        for i in one.worst_first
    ]
    for title, pick in (("mean", mean), ("worst", worst)):
        picked = {name: pick(name, values) for name, values in one.columns.items()}
        rows.append({"model": title, **picked, "best": True})
    return rows


# --- figures ---


def draw_worst(answer: Answer, folder: Path, *, count: int = 3) -> list[Path]:
    """Draw the worst modes of the models that `Neo` does worst: exact, predicted, difference."""
    drawn = []
    for one in beside(answer.rows):
        for rank, i in enumerate(one.worst_first[:count], start=1):
            case, error = one.cases[i], one.columns[WORST][i]
            exact, predicted, comparison = answer.study.compare(one.method, case)
            name = f"worst-{_slug(one.place.models)}-{rank}-{_slug(case.shape.name)}.png"
            plot_comparison(
                case.geometry(),
                exact,
                predicted,
                comparison,
                path=folder / name,
                modes=[int(mode) for mode in np.argsort(-comparison.span_error)[:_DRAWN]],
                page=Page(
                    f"{case}: the worst of {exact.k} modes",
                    f"{one.method}; mean eigenvalue error {error:.1e}",
                    dpi=120,
                ),
            )
            drawn.append(folder / name)
    return drawn


def _slug(text: str) -> str:
    return text.replace(", ", "-").replace(" ", "-")
