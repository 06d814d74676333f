"""The commands of many shapes: into a store, and what it holds."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from spectra_kit._core.shown import printable
from spectra_kit._core.validate import quantity
from spectra_kit.cli.options import (
    Command,
    Count,
    Operator,
    Solver,
    SolverName,
    refuse_given,
    words,
)
from spectra_kit.cli.output import check_output, tell
from spectra_kit.cli.progress import counted
from spectra_kit.cli.solving import check_solvers, make_solver
from spectra_kit.cli.workers import Workers, engine_of, opened, part_of, running, tell_run
from spectra_kit.datasets import Plan, SpectrumStore, compute_all, find_inputs
from spectra_kit.datasets.table import check_columns
from spectra_kit.errors import InvalidInputError


@dataclass(frozen=True, kw_only=True)
class BatchOptions(Operator, Solver, Workers):
    """Compute the spectra of many shapes into a store, each once, and a table of them."""

    examples = (
        "batch scans --out store",
        "batch 'scans/*.ply' --out store --csv table.csv --descriptors hks",
        "batch subjects.csv --out store --shard 3/100 --nworkers 0",
    )
    keys = "inputs, computed, known, failed, replaced, renewed, seconds, store, csv"
    operands = "INPUT... --out STORE [options]"

    paths: tuple[str, ...] = field(kw_only=False)
    """files, folders, quoted patterns, or a manifest: a .csv with a column `file`, perhaps `name`,
    and more for the table"""
    k: Count = 96
    solver: SolverName = "automatic"
    out: Annotated[Path, Parameter(alias="-o", metavar="STORE")]
    """folder of the store; made if it is missing"""
    csv: Path | None = None
    """write a row for each shape to this .csv file: eigenvalues, area, components, warnings
    (default: none)"""
    descriptors: Annotated[
        tuple[str, ...], Parameter(converter=words, n_tokens=1, metavar="NAME,...")
    ] = ()
    """also keep these: hks, wks, gps, dna (default: none)"""
    tensors: bool = False
    """also keep what networks ask for: Laplacians, frames and gradients"""
    precision: Literal["float64", "float32"] = "float64"
    """of eigenvectors, descriptors and tensors in the store"""
    strict: bool = False
    """stop at the first shape that fails"""


@dataclass(frozen=True, kw_only=True)
class StoreOptions(Command):
    """Look into a store of spectra: list what is there, read all of it, or remove what is old."""

    examples = ("store list store", "store verify store --remove", "store clean store")
    keys = "store, entries, bytes, shapes, damaged, removed"
    operands = "ACTION STORE [options]"

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
    check_solvers(asked, asked.solver)
    inputs = part_of(asked, find_inputs(asked.paths))
    if asked.csv:
        check_output(asked.csv, [".csv"], [*map(Path, asked.paths), *(one.path for one in inputs)])
        check_columns(inputs)
    plan = Plan(
        k=asked.k,
        solver=make_solver(asked.solver, asked, asked.k),
        operator=asked.operator,  # type: ignore[arg-type]
        boundary=asked.boundary,
        repair=asked.repair,
        largest=asked.largest,
        cloud=asked.cloud,
        seed=asked.seed,
        descriptors=asked.descriptors,  # type: ignore[arg-type]
        operators=("stiffness", "gradient") if asked.tensors else (),
        precision=asked.precision,
    )
    engine = engine_of(asked, "shape", lambda: len(inputs))
    store = SpectrumStore(asked.out)
    with running("computing", "shape") as progress:
        report = compute_all(
            inputs, store, plan, engine=engine, strict=asked.strict, progress=progress
        )
    tell_run(asked, report, asked.out)


def store(asked: StoreOptions) -> None:
    """List, read, or clean a store."""
    for name, action in (("remove", "verify"), ("unnamed", "clean")):
        if asked.action != action:
            refuse_given(asked, [name], f"on {asked.action}")
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
                *(
                    f"{one['spectrum']}  {one['k']:4} modes  {printable(str(one['name']))}"
                    for one in shapes
                ),
                *(printable(f"damaged: {one['path']}: {one['reason']}") for one in damaged),
                *(f"removed: {path}" for path in removed),
            ]
        ),
    )
    if damaged and not asked.remove:
        raise InvalidInputError(
            f"{quantity(len(damaged), 'entry')} of the store are damaged",
            advice="take them out with --remove; the next run computes them again",
        )
