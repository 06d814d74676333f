"""Time every backend and every installed peer, side by side: seconds, memory, residuals, errors.

    python apps/studies/run.py eigensolvers OUT                 # hours; needs SPECTRA_KIT_DATA
    python apps/studies/run.py eigensolvers OUT --members hippo "bunny cloud" --methods neo eigsh
    python apps/studies/run.py eigensolvers OUT --quick         # without the slowest methods
    python apps/studies/run.py eigensolvers OUT --file bunny.obj --sizes 8000 64000 512000
    python apps/studies/run.py eigensolvers OUT --set models --models 26 26 8 --repeats 1
    python apps/studies/run.py eigensolvers OUT --set demo --sizes 1000 2000 -k 16   # a small trial

By default the set of real meshes and clouds of studies/recipes.py is solved: means over it and the
worst of it, also of the members that no constant was tuned on. Clouds of well-known models, of a
file or of the demo, of some sizes, tell where the network pays. Clouds get the
Delaunay operator, meshes the robust one. Nothing else should run on the machine meanwhile:
`waiting` is the share of a solve's time that it had no core.

Seconds leave out assembly and certificate; each solve has a process of its own, which has solved
something small before. Speed-ups are over scipy's eigsh. GB: peak above the operator. Residuals are
relative, the largest of all modes; eigenvalue errors are relative, by place, against ARPACK at
machine precision, in the mean over the modes. Seconds and speed-ups have a geometric mean, all else
an arithmetic one; who did not solve every member has no mean. Bold: no other method on that device
is both faster and more accurate. Stops at: the tolerance, in the sense of the method's own test;
*rounding* is machine precision, *default* what the package has set; predictions have no tolerance.

Of estimated errors: the share within a factor 3 of the true error, and of those that are too low by
more, on average and on the worst member. Where an accuracy was asked for: the largest error over
it, and on how many members it was met.

Beside each method that begins with the network: the best without it in its time, whose error is so
many times its own (less than 1: the network does not pay), and on how many models nothing without
it was both as quick and as near.

Other packages are optional: pip install lapy cholespy. For a machine without network, fetch the
wheels, theirs among them, as the study `network` explains. Results of machines with an accelerator
are kept as apps/results/MACHINE.json and .md (copies of eigensolvers.json and .md).
"""

from __future__ import annotations

import argparse
import platform
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from spectra_kit._core.validate import check_count
from spectra_kit.show import Page
from studies.command import add_threads
from studies.eigensolvers.methods import BASELINE, METHODS, QUICK, STARTS, Contender, contenders
from studies.eigensolvers.solves import KINDS, OPERATOR, Preparation, Solves, clouds_of
from studies.eigensolvers.summary import Row, Summary, leads, memory, summaries
from studies.machine import describe_machine, most_memory
from studies.plots import ParetoPoint, fronts, plot_pareto
from studies.recipes import MEMBERS, REAL, Recipe, model_sources
from studies.report import Table, ratio, write_report
from studies.store import Record, Store
from studies.study import Repeats, Result, repeats_of, run
from studies.worker import Limits

# Points by default: the NEO paper has times of about as many.
_SIZES = [8192, 65536, 500_000]
_DEMO = ("creature:2000", "creature:4000")


def options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--set", choices=("real", "models", "demo"), default="real",
        help="default: real")  # fmt: skip
    what.add_argument("--members", nargs="+", choices=list(MEMBERS), metavar="NAME",
        help=f"of the real and the made ones: {', '.join(MEMBERS)}")  # fmt: skip
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


def _problems(args: argparse.Namespace) -> list[Recipe]:
    if args.file or args.set != "real":
        sources = (args.file,) if args.file else _DEMO if args.set == "demo" else model_sources()
        return clouds_of(sources, args.sizes or _SIZES, args.models)
    members = [MEMBERS[name] for name in args.members or REAL]
    return [member for member in members if member.kind in args.geometry]


def measure(args: argparse.Namespace) -> None:
    for name in ("k", "repeats", "threads"):
        check_count(name, getattr(args, name), low=1)
    limits = Limits(
        threads=args.threads,
        seconds=args.time_limit,
        memory=most_memory() if args.memory is None else args.memory * 1e9,
    )
    prepared = Preparation(folder=args.out, problems=_problems(args), k=args.k)
    of_sizes = bool(args.file) or args.set != "real"
    store = Store(args.out)
    exact = replace(limits, seconds=args.exact_limit)
    made = run(prepared, store, limits=exact, retry=args.retry, progress=True)
    study = Solves(
        folder=args.out,
        problems=prepared.problems,
        prepared=prepared,
        contenders=contenders(args.methods or (STARTS if of_sizes else list(METHODS)), args.device),
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
    report(study, results, made, machine)


def report(
    study: Solves,
    results: Sequence[Result[Contender, Recipe]],
    prepared: Sequence[Result[str, Recipe]],
    machine: Record,
) -> Path:
    """Write ``eigensolvers.csv``, its tables and a plot for each size, or for all of the set."""
    rows = repeats_of(results)
    groups = {name: summaries(some) for name, some in _groups(rows).items()}
    told = [_told(group, one, found) for group, found in groups.items() for one in found]
    led = [
        {"size": name, **lead}
        for name, some in _groups(rows).items()
        if _size(name)
        for lead in leads(some)
    ]
    drawn = [name for name in groups if _size(name)] or [name for name in groups if name == "all"]
    figures = []
    for name in drawn:
        if len(points := _points(name, groups[name])) > 1:
            figures.append(study.folder / f"accuracy-{_size(name) or name}.png")
            plot_pareto(
                points,
                path=figures[-1],
                page=Page(f"{name}: {groups[name][0].members} shapes", dpi=150),
                xlabel="seconds: geometric mean; bars lead to the worst",
                ylabel="mean relative eigenvalue error",
            )
    return write_report(
        study.folder,
        "eigensolvers",
        [*prepared, *results],
        [
            Table("Over the set", told, _OVER),
            Table("What is promised", [r for r in told if r.get("asked") or "met" in r or
                r.get("within 3") is not None], _PROMISED),
            Table("Where the network pays", led, _LEADS),
            Table("The set", _members(repeats_of(prepared)), _MEMBERS),
            Table("Every problem", [line for row in rows for line in _solve(row, rows)], _SOLVES),
        ],
        machine,
        figures=figures,
        settings={"k": study.prepared.k, "repeats": study.repeats, "operators": KINDS},
        methods={
            row.contender.name: {
                "solver": row.contender.solver,
                "stops_at": row.contender.method.stops,
                "peer": row.contender.method.peer,
            }
            for row in rows
        },
        summaries={name: [summary_as_json(one) for one in found] for name, found in groups.items()},
    )  # fmt: skip


def _size(group: str) -> int:
    """Points, where the group is one of clouds of a size; 0 of others."""
    found = re.fullmatch(r"([\d,]+) points", group)
    return int(found[1].replace(",", "")) if found else 0


def _groups(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Gather what was measured: at each size; or on all of the set, a side, a kind, a trait."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        member = row.problem
        if any(map(_size, member.traits)):
            names = member.traits
        else:
            side = "held back" if member.held_back else "for tuning"
            names = ("all", side, member.kind, *member.traits) if member.traits else ()
        for name in names:
            groups.setdefault(name, []).append(row)
    first = ("all", "held back", "for tuning", *KINDS)
    others = sorted(groups.keys() - {*first}, key=lambda name: (_size(name), name))
    return {name: groups[name] for name in (*first, *others) if name in groups}


_OVER = {
    **{"method": "", "group": "", "stops at": "", "solved": "", "seconds": ".3g"},
    **{"slowest": ".3g", "speed-up": ".2f", "least": ".2f", "least on": ""},
    **{"error": ".1e", "worst error": ".1e", "worst on": "", "residual": ".1e", "GB": ".2f"},
}
_PROMISED = {
    **{"method": "", "group": "", "within 3": ".1%", "least within": ".0%", "too low": ".1%"},
    **{"most too low": ".0%", "asked": "g", "error over it": ".2f", "met": ""},
}


def _told(group: str, one: Summary, found: Sequence[Summary]) -> Record:
    """Return all of a summary that is shown: means and worst, the worst with its member."""
    over = {name: figure._asdict() for name, figure in one.over.items()}

    def of(figure: str, which: str = "mean") -> Any:
        return over.get(figure, {}).get(which)

    error, solved = _error(group), one.members - len(one.lost)
    row: Record = {
        **{"group": group, "method": str(one.contender), "stops at": one.contender.method.stops},
        **{"solved": f"{solved}/{one.members}", "seconds": of("seconds")},
        **{"slowest": of("seconds", "worst")},
        **{"speed-up": ratio(1.0, of("slowdown")), "error": of(error)},
        "least": None if one.lost else ratio(1.0, of("slowdown", "worst")),
        "least on": one.lost[0] if one.lost else of("slowdown", "where"),
        **{"worst error": of(error, "worst"), "worst on": of(error, "where")},
        **{"residual": of("residual_max", "worst"), "GB": ratio(of("bytes", "worst"), 1e9)},
        "best": str(one.contender) in _undominated(_points(group, found)),
    }
    asked = one.contender.method.accuracy
    if not one.contender.method.peer:  # which estimate nothing: residuals and gaps alone have told
        row |= {
            **{name: None if of("apart", key) is None else 1 - of("apart", key)
               for name, key in (("within 3", "mean"), ("least within", "worst"))},
            **{"too low": of("low"), "most too low": of("low", "worst"), "asked": asked or None},
        }  # fmt: skip
    if "over_asked" in over:
        met = f"{solved - len(one.above)}/{one.members}"
        row |= {"error over it": of("over_asked", "worst"), "met": met}
    return row


_LEADS = {
    **{"size": "", "method": "", "the best in its time": "", "times its error": ".3g"},
    **{"pays on": "d", "of": "d"},
}


_MEMBERS = dict.fromkeys(("member", "kind", "traits", "made of", "points", "for", "hash"), "")


def _members(prepared: Iterable[Repeats[str, Recipe]]) -> list[Record]:
    """List what each member is made of, and the hash of what came of it."""
    return [
        {
            **{"member": str(row.problem), "kind": row.problem.kind, "made of": row.problem.told},
            **{"traits": ", ".join(row.problem.traits), "points": row.first("n")},
            "for": "checking" if row.problem.held_back else "tuning",
            "hash": row.first("digest"),
        }
        for row in prepared
        if row.contender == OPERATOR and row.ok and row.problem.traits
    ]


_SOLVES = {
    **{"method": "", "problem": "", "points": ",d", "stops at": "", "seconds": ".3g"},
    **{"speed-up": ".2f", "with assembly": ".3g", "GB": ".2f", "residual": ".1e"},
    **{"error": ".1e", "worst mode": ".1e", "waiting": ".0%"},
}


def _solve(row: Row, rows: Sequence[Row]) -> list[Record]:
    """Tell of one method on one problem, beside the others there; nothing where it failed."""
    if not row.ok:
        return []
    here = [other for other in rows if other.problem == row.problem and other.ok]
    base = [other.median("seconds") for other in here if str(other.contender) == BASELINE]
    seconds = row.median("seconds")
    points = [
        _point(other.contender, other.median("seconds"), other.first("eigenvalue_error"))
        for other in here
        if other.first("eigenvalue_error") is not None
    ]
    return [
        {
            **{"problem": str(row.problem), "points": row.first("n"), "kind": row.problem.kind},
            **{"method": str(row.contender), "stops at": row.contender.method.stops},
            **{"seconds": seconds, "speed-up": ratio(base[0] if base else None, seconds)},
            "with assembly": (seconds or 0.0) + row.first("assembly_seconds"),
            **{"GB": memory(row) / 1e9, "residual": row.largest("residual_max")},
            **{"error": row.first("eigenvalue_error"), "waiting": row.largest("waiting")},
            "worst mode": row.first("eigenvalue_error_max"),
            "best": str(row.contender) in _undominated(points),
        }
    ]


def summary_as_json(one: Summary) -> Record:
    """Return a summary as JSON."""
    return {
        **{"method": one.contender.name, "device": one.contender.device},
        **{"members": one.members, "lost": one.lost, "above": one.above},
        **{figure: over._asdict() for figure, over in one.over.items()},
    }


def _error(group: str) -> str:
    """Name the figure that is told: clouds of a size are alike, members of a set are not."""
    return "typical_error" if _size(group) else "eigenvalue_error"


def _points(group: str, found: Iterable[Summary]) -> list[ParetoPoint]:
    """Return who solved every member as points of a Pareto plot, with their worst."""
    points = []
    for one in found:
        time, error = one.over.get("seconds"), one.over.get(_error(group))
        if time and error and not one.lost:
            worst = time.worst, error.worst
            points.append(_point(one.contender, time.mean, error.mean, worst))
    return points


def _undominated(points: Iterable[ParetoPoint]) -> set[str]:
    """Return the names of what nothing on its device beats in both time and error."""
    return {best.name for front in fronts(points) for best in front}


def _point(
    who: Contender, seconds: float | None, error: float, worst: tuple[float, float] | None = None
) -> ParetoPoint:
    """Return a point of a Pareto plot, in a league for each device."""
    assert seconds is not None
    group = f"to {who.method.stops}" if who.method.stops else "approximate"
    return ParetoPoint(
        name=str(who),
        group="other packages" if who.method.peer else group,
        seconds=seconds,
        error=error,
        league=who.device,
        worst=worst,
    )
