"""Measure distance solvers side by side: iterations, seconds, errors against exact distances.

    python apps/studies/run.py geodesics OUT                     # needs SPECTRA_KIT_DATA
    python apps/studies/run.py geodesics OUT --meshes igea amo   # of SPECTRA_KIT_DATA/ood_public
    python apps/studies/run.py geodesics OUT --meshes my.obj --sources 50
    python apps/studies/run.py geodesics OUT --race              # all meshes of the set

Exact distances, which take longest, serve until the code changes that computes them. Nothing else
should run on the machine meanwhile.

Iterations are those of the Poisson step to a relative residual of 1e-8, the median of the sources;
*fewer*: how many times fewer than ICPCG takes. *Apart*: the largest difference from the fields of
the direct solver, over the largest distance. Modes are handed to a solver that has some: what they
took is in geodesics.csv.

Seconds to the first field go from the arrays of vertices and faces to the distances from one
source: checks, triangulation, factors or preconditioner, heat and Poisson step; of other packages,
building the solver and its first solve. Each run has a process of its own that has solved on a
small sphere before, all contenders by turns; *seconds* are the median of runs, *least* and
*processor* (of all threads) the best. Many sources are asked for at once, and nobody is handed
modes. With --race what comes without options meets potpourri3d both ways. *Times ours*: over what
comes without options, by the best runs.

Errors |d - d*| / d* against exact distances are in per cent, the sources aside: the mean over
vertices, and the largest; averaged over sources, half of them drawn at random, half far from those
before. Over the meshes stand a geometric mean and the worst, the mean only of who solved them all.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from spectra_kit._core.validate import check_count
from studies.command import add_threads
from studies.geodesics.contenders import (
    CONTENDERS,
    DIRECT,
    ICPCG,
    MANY,
    PLAIN,
    RACE,
    ROBUST,
    UNAIDED,
)
from studies.geodesics.distances import Accuracy, Exact, Modes, Times
from studies.machine import describe_machine, most_memory
from studies.recipes import MEMBERS, REAL, meshes_of
from studies.report import Table, ratio, write_report
from studies.shapes import Shape, shapes_named
from studies.store import Record, Store
from studies.study import Repeats, Result, repeats_of, run
from studies.worker import Limits

MESHES = ("hammer", "bunny", "horse", "koala", "amo", "igea")
Results = Mapping[str, Sequence[Result[str, Shape]]]


def options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
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
    add("--warm", type=int, default=5, metavar="N",
        help="subdivisions of the sphere that each process warms up on (%(default)s)")  # fmt: skip
    add("--quick", action="store_true",
        help="everything in one process, for a look: seconds are not comparable")  # fmt: skip


def _shapes(args: argparse.Namespace) -> tuple[Shape, ...]:
    """Members of the set, files, or names of public meshes."""
    of_the_set = [name for name, member in REAL.items() if member.kind == "mesh"]
    names = args.meshes or (of_the_set if args.race else MESHES)
    made = [name for name in names if args.race and name in MEMBERS]
    return meshes_of(made) + shapes_named(name for name in names if name not in made)


def measure(args: argparse.Namespace) -> None:
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
    compared = (DIRECT, PLAIN, ROBUST) if args.race else None
    first, many = (RACE, RACE) if args.race else (None, MANY)
    results["accuracy"] = measured(Accuracy(**given, **_only(compared)))
    results["first"] = measured(Times(**clocked, **_only(first)))
    results["many"] = measured(Times(**clocked, **_only(many), many=args.sources))
    rows = told(results)
    write_report(
        args.out,
        "geodesics",
        [result for some in results.values() for result in some],
        [
            Table("Over the meshes", over_meshes(rows), _OVER),
            Table("Seconds to the first field", rows, _FIRST),
            Table("Seconds for many sources", rows, _MANY),
            Table("Iterations, and errors against exact distances", rows, _ERRORS),
        ],
        machine,
        settings={"repeats": args.repeats, "sources": args.sources, "one process": args.quick},
    )


def _only(names: Sequence[str] | None) -> dict[str, Any]:
    return {} if names is None else {"contenders": names}


# --- tables ---

_WHO = {"mesh": "", "vertices": ",d", "solver": ""}
# What is clocked -> the best of it, and how many times that of what comes without options.
_BEST = {
    "seconds": ("least", "times ours"),
    "processor_seconds": ("processor", "its times ours"),
}
_FIRST = {
    **_WHO,
    **dict.fromkeys(("seconds", *_BEST["seconds"], *_BEST["processor_seconds"]), ".2f"),
}
_MANY = {**_WHO, **{f"many: {name}": ".2f" for name in _FIRST if name not in _WHO}}
_ERRORS = {
    **_WHO,
    **{"iterations": ".0f", "fewer": ".2f", "apart": ".1e", "mean %": ".3g", "largest %": ".3g"},
}
_OVER = {"solver": "", "figure": "", "mean": ".2f", "worst": ".3g", "on": ""}
#: Of figures that are told over all meshes: which is the worst.
_WORST = {
    **dict.fromkeys(("times ours", "its times ours", "fewer"), min),
    **dict.fromkeys(("many: times ours", "many: its times ours"), min),
    "apart": max,
}


def told(results: Results) -> list[Record]:
    """Gather what was measured of each contender on each mesh, from the results of the studies.

    These are "modes", "accuracy", "first" and "many", as far as they are there.
    """
    rows = {
        (study, row.problem.name, row.contender): row
        for study, some in results.items()
        for row in repeats_of(some)
    }
    shapes = {row.problem.name: row.problem for row in rows.values()}
    measured = {name for study, _, name in rows if study != "modes"}
    lines = []
    for shape in shapes.values():
        here = {(study, who): row for (study, mesh, who), row in rows.items() if mesh == shape.name}
        lines += [_line(shape, name, here) for name in CONTENDERS if name in measured]
    return lines


def _line(shape: Shape, name: str, rows: Mapping[tuple[str, str], Repeats[str, Shape]]) -> Record:
    def iterations(who: str) -> float | None:
        row = rows.get(("accuracy", who))
        counts = [count for count in (row and row.first("iterations")) or [] if count is not None]
        return statistics.median(counts) if counts else None

    line: Record = {"mesh": shape.name, "vertices": shape.mesh.n, "solver": name}
    for study, prefix in (("first", ""), ("many", "many: ")):
        own, ours = (rows.get((study, who)) for who in (name, UNAIDED))
        line[f"{prefix}seconds"] = own and own.median("seconds")
        for unit, (least, times) in _BEST.items():
            clocked = (row.values(unit) if row else [] for row in (own, ours))
            best, base = (min(values, default=None) for values in clocked)
            line |= {prefix + least: best, prefix + times: ratio(best, base)}
    line |= {"iterations": iterations(name), "fewer": ratio(iterations(ICPCG), iterations(name))}
    accuracy = rows.get(("accuracy", name))
    line["apart"] = accuracy and accuracy.first("difference")
    if errors := accuracy and accuracy.first("errors"):
        for which in ("mean", "largest"):
            line[f"{which} %"] = 100 * statistics.fmean(error[which] for error in errors)
    return line


def over_meshes(rows: Sequence[Record]) -> list[Record]:
    """Tell the mean of each ratio, where it is known of every mesh, and the worst with its mesh."""
    found = []
    for name in dict.fromkeys(row["solver"] for row in rows):
        mine = [row for row in rows if row["solver"] == name]
        for figure, pick in _WORST.items():
            known = [row for row in mine if row[figure]]
            if known:
                values = [row[figure] for row in known]
                worst = known[values.index(pick(values))]
                mean = statistics.geometric_mean(values) if len(known) == len(mine) else None
                line = {"solver": name, "figure": figure, "mean": mean}
                found.append({**line, "worst": worst[figure], "on": worst["mesh"]})
    return found
