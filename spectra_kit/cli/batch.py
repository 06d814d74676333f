"""The commands of many shapes: into a store, and what it holds."""

from __future__ import annotations

from pathlib import Path

from spectra_kit._core.records import printable
from spectra_kit._core.validate import quantity
from spectra_kit.cli import program
from spectra_kit.cli.options import refuse_given
from spectra_kit.cli.output import check_output, tell
from spectra_kit.cli.progress import counted
from spectra_kit.cli.solving import check_solvers, make_solver
from spectra_kit.cli.workers import engine_of, opened, part_of, running, tell_run
from spectra_kit.datasets import Plan, SpectrumStore, compute_all, find_inputs
from spectra_kit.datasets.table import check_columns
from spectra_kit.errors import InvalidInputError


def batch(asked: program.Batch) -> None:
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


def store(asked: program.Store) -> None:
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
