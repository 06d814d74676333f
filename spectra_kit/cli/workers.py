"""What the commands of many shapes share: their part of the work, who does it, what came of it."""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from spectra_kit._core.shown import printable
from spectra_kit._core.validate import quantity
from spectra_kit.cli.options import Command, refuse_given
from spectra_kit.cli.output import tell
from spectra_kit.cli.progress import counted, say
from spectra_kit.cli.words import told
from spectra_kit.datasets import BatchReport, DaskEngine, Engine, SpectrumStore, shard, write_table
from spectra_kit.datasets.files import MARK
from spectra_kit.datasets.inputs import Named
from spectra_kit.datasets.run import Spared
from spectra_kit.errors import InvalidInputError

if TYPE_CHECKING:
    from spectra_kit.cli.batch import BatchOptions
    from spectra_kit.cli.match_all import MatchAllOptions

_NAMED = 3  # names that a line tells


@dataclass(frozen=True, kw_only=True)
class Workers(Command, group="workers"):
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


def opened(folder: Path) -> SpectrumStore:
    """Return the store in a folder; unlike `SpectrumStore`, make none."""
    if not (folder / MARK).is_file():
        raise InvalidInputError(f"{str(folder)!r} is no store", advice="name one")
    return SpectrumStore(folder)


def part_of(asked: Workers, inputs: Sequence[Named]) -> Sequence[Named]:
    """Return the part that `--shard` asks for."""
    if asked.shard is None:
        return inputs
    part, _, parts = asked.shard.partition("/")
    if not (part.isdecimal() and parts.isdecimal()):
        raise InvalidInputError("--shard", "be like 3/100, counted from 1", asked.shard)
    return shard(inputs, int(part), int(parts))


def engine_of(asked: Workers, noun: str, missing: Callable[[], int]) -> Engine | None:
    """Return who works: workers, unless this process alone is asked for or is enough.

    It is enough if nothing is `missing`, which is counted only where it matters.
    """
    own = ("nthreads", "memory_limit", "scheduler", "scheduler_file")
    if asked.nworkers == 0:
        refuse_given(asked, own, "with --nworkers 0, which is this process alone")
        return None
    scheduler = asked.scheduler
    local = asked.nworkers, asked.nthreads, asked.memory_limit
    if not asked.scheduler_file and local == (None, 1, "auto"):  # no workers here are described
        scheduler = scheduler or os.environ.get("DASK_ADDRESS")
    engine = DaskEngine(
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
    asked: "BatchOptions | MatchAllOptions",
    report: BatchReport[Any, Any],
    store: Path,
    more: Mapping[str, int | Sequence[str | Sequence[str]] | None] | None = None,
) -> None:
    """Write the table, and say what came of a run; failures last, where they are seen.

    `more` is told of results.
    """
    if asked.csv:
        write_table(asked.csv, report)
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
