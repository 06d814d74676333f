"""The commands of many shapes: into a store, and what it holds."""

from __future__ import annotations

import os
from importlib.util import find_spec
from pathlib import Path
from typing import get_args

from spectra_kit._validate import quantity
from spectra_kit.batch import (
    BatchReport,
    DaskEngine,
    Engine,
    Input,
    compute_all,
    find_inputs,
    shard,
    write_table,
)
from spectra_kit.cli import program
from spectra_kit.cli.options import refuse_given
from spectra_kit.cli.output import check_output, tell
from spectra_kit.cli.progress import counted, say
from spectra_kit.cli.solving import check_solvers, make_solver
from spectra_kit.cli.words import told
from spectra_kit.errors import InvalidInputError
from spectra_kit.store import Plan, SpectrumStore
from spectra_kit.store.files import MARK
from spectra_kit.store.plan import Descriptor

_SOME = 20  # failures that are told of at most, where a table has room for all


def batch(asked: program.Batch) -> None:
    """Compute many shapes, tell what failed, write the table."""
    check_solvers(asked, asked.solver)
    known = get_args(Descriptor)
    if odd := [name for name in asked.descriptors if name not in known]:
        raise InvalidInputError("--descriptors", f"be among {', '.join(known)}", ", ".join(odd))
    inputs = _part(asked, find_inputs(asked.paths))
    if asked.csv:
        check_output(asked.csv, [".csv"], [one.path for one in inputs])
    plan = Plan(
        k=asked.k,
        solver=make_solver(asked.solver, asked, asked.k),
        operator=asked.operator,  # type: ignore[arg-type]
        boundary=asked.boundary,
        repair=asked.repair,
        cloud=asked.cloud,
        seed=asked.seed,
        descriptors=asked.descriptors,  # type: ignore[arg-type]
        precision=asked.precision,
    )
    engine = _engine(asked, inputs)
    store = SpectrumStore(asked.out)
    try:
        with counted("computing", "shape") as progress:
            report = compute_all(
                inputs, store, plan, engine=engine, strict=asked.strict, progress=progress
            )
    except KeyboardInterrupt:
        say("what is done is kept; the same command goes on with what is not")
        raise
    if asked.csv:
        write_table(asked.csv, report)
    _tell(asked, report, len(inputs))


def _part(asked: program.Batch, inputs: list[Input]) -> list[Input]:
    if asked.shard is None:
        return inputs
    part, _, parts = asked.shard.partition("/")
    if not (part.isdecimal() and parts.isdecimal()):
        raise InvalidInputError("--shard", "be like 3/100, counted from 1", asked.shard)
    return shard(inputs, int(part), int(parts))


def _engine(asked: program.Batch, inputs: list[Input]) -> Engine | None:
    """Return who works: workers, unless this process alone is asked for or is enough."""
    own = ("nthreads", "memory_limit", "scheduler", "scheduler_file")
    if asked.nworkers == 0:
        refuse_given(asked, own, "with --nworkers 0, which is this process alone")
        return None
    scheduler = asked.scheduler
    if not asked.scheduler_file and asked.nworkers is None:
        scheduler = scheduler or os.environ.get("DASK_ADDRESS")
    engine = DaskEngine(
        scheduler=scheduler,
        scheduler_file=asked.scheduler_file,
        nworkers=asked.nworkers,
        nthreads=asked.nthreads,
        memory_limit=asked.memory_limit,
    )
    told_to = scheduler or asked.scheduler_file or asked.nworkers is not None
    if not told_to and (len(inputs) == 1 or find_spec("distributed") is None):
        if len(inputs) > 1:
            say("one shape at a time; pip install 'spectra_kit[batch]' lets all cores work")
        return None
    return engine


def _tell(asked: program.Batch, report: BatchReport, count: int) -> None:
    """Say what came of it; failures last, where they are seen."""
    computed, done = report.computed, len(report.completed)
    for text in report.replaced:
        say(f"warning: {text}")
    failed = [{"name": one.input.name, "reason": told(one.error)} for one in report.failed]
    record = {
        "inputs": count,
        "computed": computed,
        "known": done - computed,
        "failed": failed,
        "replaced": list(report.replaced),
        "seconds": round(report.seconds, 3),
        "store": asked.out,
        "csv": asked.csv,
    }
    rate = f", {computed / report.seconds:.3g} a second" if computed else ""
    lines = [
        f"{quantity(count, 'shape')}: {computed:,} computed, {done - computed:,} known,"
        f" {len(failed):,} failed; {report.seconds:.1f} s{rate}",
        f"store: {asked.out}",
    ]
    tell(asked, record, "\n".join([*lines, *([f"table: {asked.csv}"] if asked.csv else [])]))
    for one in failed:
        say(f"failed: {one['name']}: {one['reason']}")
    if failed:
        raise InvalidInputError(
            f"{quantity(len(failed), 'shape')} of {count:,} failed, as told above",
            advice="mend or leave them out; what is done is kept",
        )


def store(asked: program.Store) -> None:
    """List, read, or clean a store."""
    if asked.action != "verify":
        refuse_given(asked, ["remove"], f"on {asked.action}")
    if not (asked.store / MARK).is_file():
        raise InvalidInputError(f"{str(asked.store)!r} is no store", advice="name one")
    kept = SpectrumStore(asked.store)
    damaged, removed = list[dict[str, str]](), list[Path]()
    if asked.action == "verify":
        with counted(f"reading {asked.store}", "file") as progress:
            found = kept.verify(remove=asked.remove, progress=progress)
        damaged = [{"path": str(one.path), "reason": one.reason} for one in found]
        removed = [one.path for one in found] if asked.remove else []
    elif asked.action == "clean":
        removed = kept.clean()
    entries = list(kept.entries())
    size = sum(entry.size for entry in entries)
    shapes = []
    if asked.action == "list":
        shapes = [
            {"name": one.name, "k": one.facts["k"], "spectrum": one.spectrum}
            for one in sorted(kept.records(), key=lambda one: one.name)
        ]
    spectra = sum(entry.kind == "spectra" for entry in entries)
    tell(
        asked,
        {
            "store": asked.store,
            "entries": len(entries),
            "bytes": size,
            "shapes": shapes,
            "damaged": damaged,
            "removed": removed,
        },
        "\n".join(
            [
                f"{asked.store}: {quantity(len(entries), 'entry')}, {spectra:,} of them spectra;"
                f" {size / 1e6:,.1f} MB",
                *(f"{one['spectrum']}  {one['k']:4} modes  {one['name']}" for one in shapes),
                *(f"damaged: {one['path']}: {one['reason']}" for one in damaged),
                *(f"removed: {path}" for path in removed),
            ]
        ),
    )
    if damaged and not asked.remove:
        raise InvalidInputError(
            f"{quantity(len(damaged), 'entry')} of the store are damaged",
            advice="take them out with --remove; the next run computes them again",
        )
