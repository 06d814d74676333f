"""Time every backend and every installed peer, side by side: seconds, memory, residuals, errors.

    python apps/benchmark_eigensolvers.py OUT                 # hours; needs SPECTRA_KIT_DATA
    python apps/benchmark_eigensolvers.py OUT --members hippo "bunny cloud" --methods cascade eigsh
    python apps/benchmark_eigensolvers.py OUT --quick        # without the slowest methods
    python apps/benchmark_eigensolvers.py OUT --file bunny.obj --sizes 8000 64000 512000
    python apps/benchmark_eigensolvers.py OUT --set models --models 26 26 8 --repeats 1
    python apps/benchmark_eigensolvers.py OUT --set demo --sizes 1000 2000 -k 16    # a small trial

By default the set of real meshes and clouds of measure/recipes.py is solved: means over it and the
worst of it, also of the members that no constant was tuned on; OUT gets benchmark.json, .md and a
plot. Clouds of well-known models, of a file or of the demo, of some sizes, tell how times grow and
where the network pays: OUT gets sizes.json, .md and .png, with a panel for each size. Clouds get
the Delaunay operator, meshes the robust one. Every solve is a line of OUT/measurements.jsonl as
soon as it ends, so the same command after an interruption, or with more sizes, computes only what
is missing. What was measured with another code or other options is measured again. Nothing else
should run on the machine meanwhile; the report says if something did.

Other packages are optional: pip install lapy. For a machine without network, fetch the wheels,
that of lapy among them, as evaluate_neo.py explains. Results from machines with an accelerator are
kept as apps/results/MACHINE.json and .md (copies of benchmark.json and benchmark.md).
"""

from __future__ import annotations

import argparse
import platform
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from measure.command import add_threads, exit_code, parser_of
from measure.eigensolvers.methods import METHODS, QUICK, STARTS, contenders
from measure.eigensolvers.report import write_report
from measure.eigensolvers.sizes import write_sizes
from measure.eigensolvers.studies import KINDS, Preparation, Solves, clouds_of
from measure.machine import describe_machine, most_memory
from measure.recipes import REAL, Recipe, model_sources
from measure.store import Store
from measure.study import run
from measure.worker import Limits

from spectra_kit._core.validate import check_count

# Points by default: the NEO paper has times of about as many.
_SIZES = [8192, 65536, 500_000]
_DEMO = ("creature:2000", "creature:4000")


def _parser() -> argparse.ArgumentParser:
    parser = parser_of("benchmark_eigensolvers.py", __doc__)
    add = parser.add_argument
    add("out", type=Path, help="folder for measurements, tables and plots")
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--set", choices=("real", "models", "demo"), default="real",
        help="default: real")  # fmt: skip
    what.add_argument("--members", nargs="+", choices=list(REAL), metavar="NAME",
        help=f"of the real ones: {', '.join(REAL)}")  # fmt: skip
    what.add_argument("--file", default="", help="a mesh instead")
    add("--sizes", type=int, nargs="+", metavar="N",
        help="points of clouds from models, the demo or a file")  # fmt: skip
    add("--models", type=int, nargs="+", default=[], metavar="N",
        help="only so many models at each of the sizes (default: all)")  # fmt: skip
    add("-k", type=int, default=96, help="modes (%(default)s)")
    add("--geometry", nargs="+", choices=KINDS, default=list(KINDS), help="default: both")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--methods", nargs="+", choices=list(METHODS), metavar="NAME",
        help=f"of {', '.join(METHODS)} (default: all; of models {', '.join(STARTS)})")  # fmt: skip
    slow = ", ".join(name for name in METHODS if name not in QUICK)
    which.add_argument("--quick", action="store_const", const=list(QUICK), dest="methods",
        help=f"all but {slow}")  # fmt: skip
    add("--device", nargs="+", choices=("cpu", "cuda"), default=["cpu"], help="default: cpu")
    add("--repeats", type=int, default=3, help="of each solve (%(default)s)")
    add("--time-limit", type=float, default=300.0, metavar="S",
        help="seconds for one solve; a slower method ends there (%(default)g)")  # fmt: skip
    add("--exact-limit", type=float, default=3600.0, metavar="S",
        help="for the exact modes, without which there are no errors (%(default)g)")  # fmt: skip
    add("--memory", type=float, metavar="GB",
        help="for one process (default: most of what is free)")  # fmt: skip
    add_threads(parser)
    add("--commit", default="", help="for the record (default: asked of git)")
    add("--retry", action="store_true", help="measure again what had failed or was stopped")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, write the report, print its tables and return the exit code."""
    args = _parser().parse_args(argv)
    return exit_code(lambda: _measure(args))


def _of_sizes(args: argparse.Namespace) -> bool:
    return bool(args.file) or args.set in ("models", "demo")


def _problems(args: argparse.Namespace) -> list[Recipe]:
    if _of_sizes(args):
        sources = (args.file,) if args.file else _DEMO if args.set == "demo" else model_sources()
        return clouds_of(sources, args.sizes or _SIZES, args.models)
    return [REAL[name] for name in args.members or REAL if REAL[name].kind in args.geometry]


def _measure(args: argparse.Namespace) -> None:
    for name in ("k", "repeats", "threads"):
        check_count(name, getattr(args, name), low=1)
    limits = Limits(
        threads=args.threads,
        seconds=args.time_limit,
        memory=most_memory() if args.memory is None else args.memory * 1e9,
    )
    prepared = Preparation(folder=args.out, problems=_problems(args), k=args.k)
    of_sizes = _of_sizes(args)
    methods = args.methods or (STARTS if of_sizes else METHODS)
    store = Store(args.out)
    made = run(
        prepared,
        store,
        limits=replace(limits, seconds=args.exact_limit),
        retry=args.retry,
        progress=True,
    )
    study = Solves(
        folder=args.out,
        problems=prepared.problems,
        prepared=prepared,
        contenders=contenders(methods, args.device),
        repeats=args.repeats,
        threads=args.threads,
        machine=args.machine or platform.node(),
    )
    results = run(study, store, limits=limits, retry=args.retry, progress=True)
    machine = describe_machine(
        name=study.machine,
        threads=args.threads,
        device="cuda" if "cuda" in args.device else "cpu",
        commit=args.commit,
    )
    paths = (write_sizes if of_sizes else write_report)(study, results, made, machine)
    print(paths[1].read_text())
    print("written:", *paths, sep="\n  ")


if __name__ == "__main__":
    sys.exit(main())
