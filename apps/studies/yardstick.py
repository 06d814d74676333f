"""Measure this machine in ten minutes: the toolkit beside whatever peers are installed.

    python apps/studies/run.py yardstick OUT
    python apps/studies/run.py yardstick OUT --device cuda

No data are needed: animals are made, one smooth, one with triangles of very different size, five
side by side, and a noisy cloud. The studies `eigensolvers`, `geodesics`, `walking` and `matching`
run on them, each in a folder of its own within OUT, where all of their tables are; here stand the
seconds beside those of others. *Times sooner*: geometric mean over the shapes, and on the worst of
them; the rows with the worst come first. *Noise*: by how much the median run of a measurement was
longer than the quickest, in the worst case of the row, where it was measured more than once.
Nothing else should run meanwhile. Figures for papers come from real shapes, by the studies' own
commands.

Optional, and measured where they are there: pip install lapy cholespy pygeodesic.
"""

from __future__ import annotations

import argparse
import csv
import json
import statistics
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import redirect_stdout
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from spectra_kit.show import Page
from studies.command import add_threads
from studies.geodesics.contenders import UNAIDED
from studies.machine import describe_machine
from studies.plots import plot_ratios
from studies.recipes import MADE
from studies.report import Table, write_report
from studies.store import Record

_MESHES = [name for name, member in MADE.items() if member.kind == "mesh"]
_OURS = {"lanczos": "exact", "automatic-1e-3": "within 1e-3", "automatic-1e-2": "within 1e-2"}
_THEIRS = ("eigsh", "lapy")
# Rows of `walking`: the table, what is timed, our seconds and those of others.
_WALKS = (
    (
        "Paths",
        "distances for paths",
        "search s",
        {"libigl s": "libigl", "pygeodesic s": "pygeodesic"},
    ),
    ("Vectors", "a first vector carried", "first s", {"theirs s": "potpourri3d"}),
    ("Curvature", "curvature", "ours s", {"libigl s": "libigl", "LaPy s": "LaPy"}),
)
_COLUMNS = {
    **{"task": "", "beside": "", "times sooner": ".2f", "worst": ".2f", "worst on": ""},
    **{"seconds there": ".3g", "noise": ".0%"},
}
_FAILED = ("study", "contender", "problems", "reason")
_MAPS = {"method": "", "pairs": "d", "mean": ".2f", "worst": ".2f", "over 8": ".0%", "s": ".2f"}


class Timed(NamedTuple):
    """Seconds of one task on one shape, ours and theirs, and how far repeats were apart."""

    task: str
    beside: str
    shape: str
    ours: float
    theirs: float
    noise: float | None = None


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"), help="(%(default)s)")
    parser.add_argument("--repeats", type=int, default=2, help="of each solve (%(default)s)")
    add_threads(parser)


def measure(args: argparse.Namespace) -> None:
    begin = time.perf_counter()
    shared = ["--threads", str(args.threads), "--repeats", str(args.repeats)]
    methods = [*_THEIRS, *_OURS, "neo"]
    devices = ["cpu", "cuda"] if args.device == "cuda" else ["cpu"]
    failed = list[Record]()
    study = partial(_study, failed, args.out)
    solved = study("eigensolvers", "--members", *MADE, "--methods", *methods,
        "--device", *devices, *shared)  # fmt: skip
    far = study("geodesics", "--race", "--meshes", *_MESHES, *shared)
    walked = study("walking", "--models", *_MESHES, "--dirty", "0", "--targets", "20")
    matched = study("matching", "--demo", "--no-pictures")
    timed = [*_solves(solved, args.out), *_distances(far), *_walks(walked)]
    rows = sorted(_rows(timed), key=lambda row: row["worst"])
    drawn = args.out / "yardstick.png"
    told = "geometric mean over made shapes, and the worst"
    plot_ratios(
        {f"{r['task']}; {r['beside']}": (r["times sooner"], r["worst"]) for r in rows},
        path=drawn,
        page=Page("How many times sooner than others", told, dpi=150),
    )
    write_report(
        args.out,
        "yardstick",
        [],
        [
            Table("Beside others, the worst first", rows, _COLUMNS),
            Table("Maps of an animal in four poses", matched["Errors"], _MAPS),
            Table("What failed", failed, dict.fromkeys(_FAILED, "")),
        ],
        describe_machine(name=args.machine, threads=args.threads, device=args.device),
        figures=[drawn],
        settings={"seconds": round(time.perf_counter() - begin)},
    )


def _study(failed: list[Record], out: Path, name: str, *options: str) -> dict[str, Any]:
    """Run a study, whose report is left in its folder, and return its tables; tell what failed."""
    from studies.run import main  # which knows this study, too

    folder = out / name
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "printed.txt").open("w") as file, redirect_stdout(file):
        main([name, str(folder), *options])
    found: dict[str, Any] = json.loads((folder / f"{name}.json").read_text())
    failed += [{"study": name, **row} for row in found["failed"]]
    return defaultdict(list, found["tables"])


def _solves(tables: dict[str, Any], out: Path) -> Iterator[Timed]:
    """Exact and approximate modes, beside others' exact ones."""
    apart = _noise(out / "eigensolvers" / "eigensolvers.csv")
    rows = tables["Every problem"]
    seconds = {(row["method"], row["problem"]): row["seconds"] for row in rows}
    for (method, shape), ours in seconds.items():
        name, _, device = method.partition(" ")
        if name in _THEIRS:
            continue
        task = f"96 modes {_OURS.get(name, 'by NEO')}{device and ' '}{device}"
        for beside in _THEIRS:
            if theirs := seconds.get((beside, shape)):
                noise = max(apart[method, shape], apart[beside, shape])
                yield Timed(task, beside, shape, ours, theirs, noise)


def _distances(tables: dict[str, Any]) -> Iterator[Timed]:
    """The first field from the arrays on, and others asked for at once."""
    rows = tables["Seconds to the first field"]
    ours = {row["mesh"]: row for row in rows if row["solver"] == UNAIDED}
    for prefix, task in (("", "a first distance field"), ("many: ", "20 more fields")):
        for row in rows:
            pair = ours[row["mesh"]], row
            if row["solver"] == UNAIDED or not all(one.get(f"{prefix}least") for one in pair):
                continue
            mine, theirs = (one[f"{prefix}least"] for one in pair)
            noise = max(one[f"{prefix}seconds"] / one[f"{prefix}least"] - 1 for one in pair)
            yield Timed(task, row["solver"], row["mesh"], mine, theirs, noise)


def _walks(tables: dict[str, Any]) -> Iterator[Timed]:
    for title, task, ours, others in _WALKS:
        for row in tables[title]:
            for column, beside in others.items():
                if row.get(column):
                    yield Timed(task, beside, row["model"], row[ours], row[column])


def _rows(timed: Sequence[Timed]) -> list[Record]:
    """Gather the shapes of each task and peer."""
    groups: dict[tuple[str, str], list[Timed]] = {}
    for one in timed:
        groups.setdefault((one.task, one.beside), []).append(one)
    rows = []
    for (task, beside), some in groups.items():
        worst = min(some, key=lambda one: one.theirs / one.ours)
        ratios = [one.theirs / one.ours for one in some]
        known = [one.noise for one in some if one.noise is not None]
        rows.append(
            {
                **{
                    "task": task,
                    "beside": beside,
                    "shapes": len(some),
                    "noise": max(known, default=None),
                },
                **{"times sooner": statistics.geometric_mean(ratios), "worst": min(ratios)},
                **{"worst on": worst.shape, "seconds there": worst.ours},
            }
        )
    return rows


def _noise(path: Path) -> dict[tuple[str, str], float]:
    """Return by how much repeats of a solve differ, by who and what."""
    runs: dict[tuple[str, str], list[float]] = {}
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            if row["seconds"]:
                some = runs.setdefault((row["contender"], row["problem"]), [])
                some.append(float(row["seconds"]))
    return {key: statistics.median(some) / min(some) - 1 for key, some in runs.items()}
