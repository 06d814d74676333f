"""The commands of many shapes: into a store, and what it holds; who works for them."""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

import spectra_kit as sk
from spectra_kit._core.shown import printable
from spectra_kit._core.validate import quantity
from spectra_kit.cli import options, solving
from spectra_kit.cli.output import check_output, tell
from spectra_kit.cli.progress import counted, say
from spectra_kit.cli.words import told
from spectra_kit.errors import InvalidInputError

if TYPE_CHECKING:
    from spectra_kit.datasets.inputs import Named

_NAMED = 3  # names that a line tells


@dataclass(frozen=True, kw_only=True)
class Workers(options.Command, group="workers"):
    """Who works on many shapes, or on many pairs of them."""

    nworkers: int | None = None
    """processes on this machine, 0 for none but this one (default: one for each core that may
    be used, once that is worth their start)"""
    nthreads: int = 1
    """shapes or pairs that each works on at a time"""
    memory_limit: Annotated[str, Parameter(metavar="SIZE")] = "auto"
    """of each process, such as 3GB"""
    scheduler: str | None = None
    """address of a Dask scheduler of a cluster, as $DASK_ADDRESS is (default: none, workers on this
    machine)"""
    scheduler_file: Path | None = None
    """file in which a scheduler has written its address (default: none)"""
    shard: Annotated[str | None, Parameter(metavar="I/N")] = None
    """compute the I-th of N parts alone, as the tasks of a job array do (default: all)"""


@dataclass(frozen=True, kw_only=True)
class BatchOptions(options.Operator, options.Solver, Workers):
    """Compute the spectra of many shapes into a store, each once, and a table of them."""

    examples = (
        "batch scans --out store",
        "batch 'scans/*.ply' --out store --csv table.csv --descriptors hks",
        "batch 'subjects/{subject}/surf/{hemisphere}.pial' --out store --csv table.csv",
        "batch subjects.csv --out store --shard 3/100 --nworkers 0",
    )
    keys = "inputs, computed, known, failed, replaced, renewed, seconds, store, csv"
    operands = "INPUT... --out STORE [options]"
    needs = ("datasets.compute_all",)

    paths: tuple[str, ...] = field(kw_only=False)
    """files, folders, quoted patterns, in which {subject} names a column of the table, or a
    manifest: a .csv with a column `file`, perhaps `name`, and more for the table"""
    k: options.Count = 96
    solver: options.SolverName = "automatic"
    out: Annotated[Path, Parameter(alias="-o", metavar="STORE")]
    """folder of the store; made if it is missing"""
    csv: Path | None = None
    """write a row for each shape to this .csv file: eigenvalues, area, components, warnings
    (default: none)"""
    distances: Path | None = None
    """write how far shapes are apart by their ShapeDNA to this .csv file (default: none)"""
    descriptors: Annotated[
        tuple[str, ...], Parameter(converter=options.words, n_tokens=1, metavar="NAME,...")
    ] = ()
    """also keep these: hks, wks, gps, dna (default: none)"""
    tensors: bool = False
    """also keep what networks ask for: Laplacians, frames and gradients"""
    precision: Literal["float64", "float32"] = "float64"
    """of eigenvectors, descriptors and tensors in the store"""
    strict: bool = False
    """stop at the first shape that fails"""


@dataclass(frozen=True, kw_only=True)
class StoreOptions(options.Command):
    """Look into a store of spectra: list what is there, read all of it, or remove what is old."""

    examples = ("store list store", "store verify store --remove", "store clean store")
    keys = "store, entries, bytes, shapes, damaged, removed"
    operands = "ACTION STORE [options]"
    needs = ("datasets.SpectrumStore",)
    solves = False

    action: Literal["list", "verify", "clean"] = field(kw_only=False)
    """list names; verify that every file is whole; clean away what is of other releases"""
    store: Path = field(kw_only=False)
    """the folder"""
    remove: bool = False
    """of verify: take out what is damaged, to be computed again"""
    unnamed: bool = False
    """of clean: also what belongs to no name any more, as of files that have changed"""


def batch(asked: BatchOptions) -> None:
    """Compute many shapes, tell what failed, write the table."""
    from spectra_kit.datasets.table import check_columns

    solving.check_solvers(asked, asked.solver)
    inputs = part_of(asked, sk.datasets.find_inputs(asked.paths))
    for path in filter(None, (asked.csv, asked.distances)):
        check_output(path, [".csv"], [*map(Path, asked.paths), *(one.path for one in inputs)])
    check_columns(inputs)
    wanted = asked.descriptors
    if asked.distances and "dna" not in wanted:
        wanted = (*wanted, "dna")
    plan = sk.datasets.Plan(
        k=asked.k,
        solver=solving.make_solver(asked.solver, asked, asked.k),
        operator=asked.operator,  # type: ignore[arg-type]
        boundary=asked.boundary,
        mass=asked.mass,
        repair=asked.repair,
        largest=asked.largest,
        cloud=asked.cloud,
        seed=asked.seed,
        descriptors=wanted,  # type: ignore[arg-type]
        operators=("stiffness", "gradient") if asked.tensors else (),
        precision=asked.precision,
    )
    engine = engine_of(asked, "shape", lambda: len(inputs))
    store = sk.datasets.SpectrumStore(asked.out)
    with running("computing", "shape") as progress:
        report = sk.datasets.compute_all(
            inputs, store, plan, engine=engine, strict=asked.strict, progress=progress
        )
    if asked.distances and len(report.completed) > 1:
        sk.datasets.write_distances(asked.distances, report)
    tell_run(asked, report, asked.out)


def store(asked: StoreOptions) -> None:
    """List, read, or clean a store."""
    for name, action in (("remove", "verify"), ("unnamed", "clean")):
        if asked.action != action:
            options.refuse_given(asked, [name], f"on {asked.action}")
    kept = opened(asked.store)
    damaged, removed = list[dict[str, str]](), list[Path]()
    if asked.action == "verify":
        with counted(f"reading {asked.store}", "file") as progress:
            found = kept.verify(remove=asked.remove, progress=progress)
        damaged = [{"path": str(one.path), "reason": one.reason} for one in found]
        removed = [one.path for one in found] if asked.remove else []
    elif asked.action == "clean":
        removed = kept.clean(unnamed=asked.unnamed)
    entries = list(kept.entries())
    size = sum(entry.size for entry in entries)
    shapes = []
    if asked.action == "list":
        shapes = [
            {"name": one.name, "k": one.facts["k"], "spectrum": one.spectrum}
            for one in sorted(kept.records(), key=lambda one: one.name)
        ]
    spectra = sum(entry.kind == "spectra" for entry in entries)
    lines = [
        f"{asked.store}: {quantity(len(entries), 'entry')}, {spectra:,} of them spectra;"
        f" {size / 1e6:,.1f} MB"
    ]
    lines += [
        f"{one['spectrum']}  {one['k']:4} modes  {printable(str(one['name']))}" for one in shapes
    ]
    lines += [printable(f"damaged: {one['path']}: {one['reason']}") for one in damaged]
    lines += [f"removed: {path}" for path in removed]
    record = {
        "store": asked.store,
        "entries": len(entries),
        "bytes": size,
        "shapes": shapes,
        "damaged": damaged,
        "removed": removed,
    }
    tell(asked, record, "\n".join(lines))
    if damaged and not asked.remove:
        raise InvalidInputError(
            f"{quantity(len(damaged), 'entry')} of the store are damaged",
            advice="take them out with --remove; the next run computes them again",
        )


def opened(folder: Path) -> "sk.datasets.SpectrumStore":
    """Return the store in a folder; unlike `SpectrumStore`, make none."""
    from spectra_kit.datasets.files import MARK

    if not (folder / MARK).is_file():
        raise InvalidInputError(f"{str(folder)!r} is no store", advice="name one")
    return sk.datasets.SpectrumStore(folder)


def part_of(asked: Workers, inputs: "Sequence[Named]") -> "Sequence[Named]":
    """Return the part that `--shard` asks for."""
    if asked.shard is None:
        return inputs
    part, _, parts = asked.shard.partition("/")
    if not (part.isdecimal() and parts.isdecimal()):
        raise InvalidInputError("--shard", "be like 3/100, counted from 1", asked.shard)
    return sk.datasets.shard(inputs, int(part), int(parts))


def engine_of(asked: Workers, noun: str, missing: Callable[[], int]) -> "sk.datasets.Engine | None":
    """Return who works: workers, unless this process alone is asked for or is enough.

    It is enough if nothing is `missing`, which is counted only where it matters.
    """
    from spectra_kit.datasets.run import Spared

    own = ("nthreads", "memory_limit", "scheduler", "scheduler_file")
    if asked.nworkers == 0:
        options.refuse_given(asked, own, "with --nworkers 0, which is this process alone")
        return None
    scheduler = asked.scheduler
    local = asked.nworkers, asked.nthreads, asked.memory_limit
    if not asked.scheduler_file and local == (None, 1, "auto"):  # no workers here are described
        scheduler = scheduler or os.environ.get("DASK_ADDRESS")
    engine = sk.datasets.DaskEngine(
        scheduler=scheduler,
        scheduler_file=asked.scheduler_file,
        nworkers=asked.nworkers,
        nthreads=asked.nthreads,
        memory_limit=asked.memory_limit,
    )
    count = missing()
    if not count:
        return None
    told_to = scheduler or asked.scheduler_file or asked.nworkers is not None
    if not told_to and (count == 1 or find_spec("distributed") is None):
        if count > 1:
            say(f"one {noun} at a time; pip install 'spectra_kit[batch]' lets all cores work")
        return None
    return engine if told_to or local != (None, 1, "auto") else Spared(engine)


def _listed(value: int | Sequence[str | Sequence[str]]) -> str:
    if isinstance(value, int):
        return f"{value:,}"
    names = (one if isinstance(one, str) else f"({', '.join(one)})" for one in value)
    return printable(", ".join(names)) or "none"


@contextmanager
def running(text: str, noun: str) -> Iterator[Callable[[int, int], None]]:
    """Show a bar while a run goes on; say that one that was interrupted has lost nothing."""
    try:
        with counted(text, noun) as progress:
            yield progress
    except KeyboardInterrupt:
        say("what is done is kept; the same command goes on with what is not")
        raise


def tell_run(
    asked: Any,
    report: "sk.datasets.BatchReport[Any, Any]",
    store: Path,
    more: Mapping[str, int | Sequence[str | Sequence[str]] | None] | None = None,
) -> None:
    """Write the table, and say what came of a run; failures last, where they are seen.

    `more` is told of results.
    """
    if asked.csv:
        sk.datasets.write_table(asked.csv, report)
    for text in report.replaced:
        say(f"warning: {text}")
    renewed = [one.name for one, done in report.completed if done.renewed]
    if renewed:
        rest = f" and {len(renewed) - _NAMED:,} more" if len(renewed) > _NAMED else ""
        say(
            f"warning: {quantity(len(renewed), 'name')} stood for other files before, or for other"
            f" bytes, and now for these: {', '.join(renewed[:_NAMED])}{rest}"
        )
    failed = [{"name": one.name, "reason": told(error)} for one, error in report.failed]
    count = len(report.completed) + len(failed)
    computed, known = report.computed, len(report.completed) - report.computed
    of_shapes = report.of == "shapes"
    noun = "shape" if of_shapes else "pair"
    record = {
        "inputs" if of_shapes else "pairs": count,
        "computed": computed,
        "known": known,
        "failed": failed,
        **(more or {}),
        "replaced": list(report.replaced),
        **({"renewed": renewed} if of_shapes else {}),
        "seconds": round(report.seconds, 3),
        "store": store,
        "csv": asked.csv,
    }
    rate = f", {computed / report.seconds:.3g} a second" if computed else ""
    lines = [
        f"{quantity(count, noun)}: {computed:,} computed, {known:,} known,"
        f" {len(failed):,} failed; {report.seconds:.1f} s{rate}",
        *(
            f"{name.replace('_', ' ')}: {_listed(value)}"
            for name, value in (more or {}).items()
            if value is not None
        ),
        f"store: {store}",
        *([f"table: {asked.csv}"] if asked.csv else []),
    ]
    tell(asked, record, "\n".join(lines))
    for one in failed:
        say(f"failed: {one['name']}: {one['reason']}")
    if failed:
        raise InvalidInputError(
            f"{quantity(len(failed), noun)} of {count:,} failed, as told above",
            advice="mend or leave them out; what is done is kept",
        )
