"""Measure distance solvers side by side: iterations, seconds, errors against exact distances.

    python apps/benchmark_geodesics.py OUT                        # needs SPECTRA_KIT_DATA
    python apps/benchmark_geodesics.py OUT --meshes igea amo      # of SPECTRA_KIT_DATA/ood_public
    python apps/benchmark_geodesics.py OUT --meshes my.obj --sources 50
    python apps/benchmark_geodesics.py OUT --race                 # all meshes of the set, one table

OUT gets report.md and report.json; every measurement is a line of OUT/measurements.jsonl as soon as
it ends, so the same command after an interruption computes only what is missing. What was measured
with another code, mesh or options is measured again; exact distances, which take longest, serve
until the code changes that computes them. Nothing else should run on the machine meanwhile.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from measure.command import add_threads, exit_code, parser_of
from measure.geodesics.contenders import DIRECT, MANY, PLAIN, RACE, ROBUST
from measure.geodesics.report import write_race, write_report
from measure.geodesics.studies import Accuracy, Ball, Balls, Exact, Modes, Times
from measure.machine import describe_machine, most_memory
from measure.recipes import REAL, real_meshes
from measure.shapes import Shape, shapes_named
from measure.store import Store
from measure.study import run
from measure.worker import Limits

from spectra_kit._core.validate import check_count

MESHES = ("hammer", "bunny", "horse", "koala", "amo", "igea")


def _parser() -> argparse.ArgumentParser:
    parser = parser_of("benchmark_geodesics.py", __doc__)
    add = parser.add_argument
    add("out", type=Path, help="folder for everything")
    add("--meshes", nargs="+", metavar="FILE|NAME",
        help=f"or members of the set, by name (default: {' '.join(MESHES)}; all of the set with"
        " --race)")  # fmt: skip
    add(
        "--race",
        action="store_true",
        help="our default against potpourri3d: first field, many single calls, errors",
    )
    add("--sources", type=int, default=20, help="for the time of many (%(default)s)")
    add("--exact-sources", type=int, default=4,
        help="where errors are measured; two above 60,000 vertices (%(default)s)")  # fmt: skip
    add("--repeats", type=int, default=3, help="of each clocked run (%(default)s)")
    add_threads(parser)
    add("--seed", type=int, default=0, help="of the sources (%(default)s)")
    add("--sphere", type=int, nargs="+", default=[3, 4, 5, 6], metavar="N",
        help="subdivisions of the spheres (default: 3 4 5 6)")  # fmt: skip
    add("--warm", type=int, default=5, metavar="N",
        help="subdivisions of the sphere that each process warms up on (%(default)s)")  # fmt: skip
    add("--quick", action="store_true",
        help="everything in one process, for a look: seconds are not comparable")  # fmt: skip
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, write the report, print it; return the exit code."""
    args = _parser().parse_args(argv)
    return exit_code(lambda: print(_measure(args)))


def _shapes(args: argparse.Namespace) -> tuple[Shape, ...]:
    """Members of the set, files, or names of public meshes."""
    of_the_set = [name for name, member in REAL.items() if member.kind == "mesh"]
    names = args.meshes or (of_the_set if args.race else MESHES)
    members = real_meshes(name for name in names if args.race and name in of_the_set)
    return members + shapes_named(n for n in names if not (args.race and n in of_the_set))


def _measure(args: argparse.Namespace) -> str:
    for name in ("sources", "exact_sources", "repeats", "threads"):
        check_count(name, getattr(args, name), low=1)
    limits = Limits(threads=args.threads, memory=most_memory())
    store, shapes = Store(args.out), _shapes(args)
    jobs = 0 if args.quick else 1
    measured = partial(run, store=store, limits=limits, jobs=jobs, retry=True, progress=True)
    places = {"folder": args.out, "problems": shapes}
    modes = Modes(**places)
    exact = Exact(**places, count=args.exact_sources, seed=args.seed)
    results = {} if args.race else {"modes": measured(modes)}
    measured(exact)
    given = {**places, "modes": modes, "exact": exact, "warm": args.warm}
    machine = describe_machine(name=args.machine, threads=args.threads)
    clocked = {
        **given,
        "repeats": args.repeats,
        "seed": args.seed,
        "threads": args.threads,
        "machine": machine["name"] + " in one process" * args.quick,
    }
    if args.race:
        results["accuracy"] = measured(Accuracy(**given, contenders=(DIRECT, PLAIN, ROBUST)))
        for name, count in (("first", 0), ("many", args.sources)):
            results[name] = measured(Times(**clocked, contenders=RACE, many=count))
        return write_race(args.out, results, machine, repeats=args.repeats, sources=args.sources)
    results["accuracy"] = measured(Accuracy(**given))
    results["first"] = measured(Times(**clocked))
    results["many"] = measured(Times(**clocked, contenders=MANY, many=args.sources))
    balls = [Ball(kind, count) for kind in ("mesh", "cloud") for count in args.sphere]
    return write_report(
        args.out,
        results,
        measured(Balls(folder=args.out, problems=balls, seed=args.seed)),
        machine,
        repeats=args.repeats,
        sources=args.sources,
        quick=args.quick,
    )


if __name__ == "__main__":
    sys.exit(main())
