"""Time every backend and every installed peer, side by side: seconds, memory, residuals, errors.

    python apps/benchmark_eigensolvers.py OUT                 # hours: all sizes
    python apps/benchmark_eigensolvers.py OUT --sizes 64000 --methods arpack neo eigsh
    python apps/benchmark_eigensolvers.py OUT --file bunny.obj
    python apps/benchmark_eigensolvers.py OUT --quick        # without the slowest methods

Without --file the demo animal is solved at each size; clouds are drawn from the surface and get the
Delaunay operator, meshes the robust one. OUT gets
benchmark.json, benchmark.md and the plots; every solve is a line of OUT/measurements.jsonl as soon
as it ends, so the same command after an interruption, or with more sizes, computes only what is
missing. Delete that file, or take another folder, to measure anew. Nothing else should run on the
machine meanwhile; the report says if something did.

Other packages are optional: pip install lapy pyamg. For a machine without network, fetch the wheels
as evaluate_neo.py explains, these two among them. Results from machines with an accelerator are
kept as apps/results/MACHINE.json and .md (copies of benchmark.json and benchmark.md).
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from spectra_kit.benchmarks import METHODS, Settings, measure, summarize, write_report
from spectra_kit.benchmarks.methods import QUICK
from spectra_kit.benchmarks.problems import KINDS
from spectra_kit.errors import SpectraKitError

DEFAULTS = Settings(machine="", commit="")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="benchmark_eigensolvers.py",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("out", type=Path, help="folder for measurements, tables and plots")
    add("--file", type=Path, help="a mesh (default: the demo animal)")
    add("--sizes", type=int, nargs="+", default=list(DEFAULTS.sizes), metavar="N", help="points")
    add("-k", type=int, default=DEFAULTS.k, help="modes (%(default)s)")
    add("--geometry", nargs="+", choices=KINDS, default=list(KINDS), help="default: both")
    which = parser.add_mutually_exclusive_group()
    which.add_argument(
        "--methods",
        nargs="+",
        choices=list(METHODS),
        default=list(METHODS),
        metavar="NAME",
        help=f"of {', '.join(METHODS)} (default: all)",
    )
    which.add_argument(
        "--quick",
        action="store_const",
        const=list(QUICK),
        dest="methods",
        help=f"all but {', '.join(name for name in METHODS if name not in QUICK)}",
    )
    add("--device", nargs="+", choices=("cpu", "cuda"), default=["cpu"], help="default: cpu")
    add("--repeats", type=int, default=DEFAULTS.repeats, help="of each solve (%(default)s)")
    add(
        "--time-limit",
        type=float,
        default=DEFAULTS.time_limit,
        metavar="S",
        help="seconds for one solve; a method that takes longer ends there (%(default)g)",
    )
    add(
        "--exact-limit",
        type=float,
        default=DEFAULTS.exact_limit,
        metavar="S",
        help="seconds for the exact modes; without them there are no errors (%(default)g)",
    )
    add(
        "--memory", type=float, metavar="GB", help="for one process (default: most of what is free)"
    )
    add("--threads", type=int, default=os.cpu_count(), help="for all alike (default: all cores)")
    add("--machine", help="name for the record (default: the host's)")
    add("--commit", help="for the record (default: asked of git)")
    add("--retry", action="store_true", help="measure again what had failed or was stopped")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, write the report, print its tables and return the exit code."""
    args = _parser().parse_args(argv)
    named = {name: getattr(args, name) for name in ("machine", "commit") if getattr(args, name)}
    try:
        settings = Settings(
            sizes=tuple(args.sizes),
            k=args.k,
            methods=tuple(name for name in METHODS if name in args.methods),
            kinds=tuple(args.geometry),
            file=str(args.file or ""),
            devices=tuple(args.device),
            repeats=args.repeats,
            time_limit=args.time_limit,
            exact_limit=args.exact_limit,
            memory_limit=None if args.memory is None else int(args.memory * 1e9),
            threads=args.threads,
            retry=args.retry,
            **named,
        )
        results = summarize(measure(settings, args.out, progress=True))
        paths = write_report(results, settings, args.out)
    except SpectraKitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("stopped; the same command goes on from here", file=sys.stderr)
        return 130
    print(paths[1].read_text())
    print("written:", *paths, sep="\n  ")
    return 0


if __name__ == "__main__":
    sys.exit(main())
