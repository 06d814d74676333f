"""Match many pairs of shapes of a store."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

import spectra_kit as sk
from spectra_kit.cli import options
from spectra_kit.cli.batch import Workers, engine_of, opened, part_of, running, tell_run
from spectra_kit.cli.output import check_output
from spectra_kit.errors import InvalidInputError

_OF_WORKERS = ("nworkers", "nthreads", "memory_limit", "scheduler", "scheduler_file", "shard")


@dataclass(frozen=True, kw_only=True)
class _Kept(options.Sides, group="input"):
    """The store, and what to match of it."""

    store: Path = field(kw_only=False)
    """a folder that `batch` has filled"""
    pairs: Annotated[Path, Parameter(metavar="all|FILE")]
    """all shapes with all others, each two once; or a .csv file with columns `source` and `target`,
    names of the store, and more for the table"""
    k: options.Count | None = None
    """number of modes: match the spectra that have so many (default: those there are)"""


@dataclass(frozen=True, kw_only=True)
class MatchAllOptions(_Kept, Workers):
    """Match shapes of a store in pairs, each once; the maps go into the store."""

    examples = (
        "match-all store --pairs all",
        "match-all store --pairs pairs.csv --csv maps.csv",
        "match-all store --pairs all --together --csv maps.csv",
    )
    keys = (
        "pairs, computed, known, failed, ambiguous, not_convincing, groups, foreign, replaced,"
        " seconds, store, csv"
    )
    operands = "STORE --pairs all|FILE [options]"
    needs = ("datasets.match_all",)

    csv: Path | None = None
    """write a row for each pair to this .csv file: score, margin, doubts, key of the map
    (default: none)"""
    strict: bool = False
    """stop at the first pair that fails"""
    together: bool = False
    """match the shapes as one collection, by this process alone: maps agree over all cycles (cycle
    errors are in the table); groups of shapes that fit, and those that fit none, are named"""


def match_pairs(asked: MatchAllOptions) -> None:
    """Match pairs of a store, tell what failed, write the table."""
    from spectra_kit.datasets.inputs import only_plan, pairs_of, records_of
    from spectra_kit.datasets.pairs import OF_COLLECTED, collected, match_records
    from spectra_kit.datasets.table import OF_PAIRS, check_columns
    from spectra_kit.maps.prepare import LOWEST_K

    store = opened(asked.store)
    if asked.together:
        options.refuse_given(
            asked, _OF_WORKERS, "with --together, which one process does; match alone"
        )
        if asked.sides == "reversed":
            raise InvalidInputError("--sides", "be either or kept with --together", asked.sides)
    if asked.csv:
        check_output(asked.csv, [".csv"], [asked.pairs])
    plan = only_plan(store, asked.k)
    if (k := int(str(plan["k"]))) < LOWEST_K:
        raise InvalidInputError(
            "store",
            f"hold spectra of at least {LOWEST_K} modes to match",
            f"those of {k}",
            advice="compute them with more (150 match best)",
        )
    records = records_of(store, plan)
    pairs = part_of(asked, pairs_of(asked.pairs, store, plan))
    if asked.csv:
        check_columns(pairs, OF_PAIRS + OF_COLLECTED * asked.together)
    matching = sk.datasets.Matching(k=k, mirrored=asked.mirrored)

    def missing() -> int:
        ends = [(records.get(pair.source), records.get(pair.target)) for pair in pairs]
        return sum(
            a is not None and b is not None and not store.has_map(matching.key(a, b))
            for a, b in ends
        )

    together = engine = None
    if asked.together:
        with running("joining", "shape") as progress:
            together, pairs = collected(pairs, store, records, matching=matching, progress=progress)
    else:
        engine = engine_of(asked, "pair", missing)
    with running("matching", "pair") as progress:
        report = match_records(
            pairs,
            store,
            records,
            matching=matching,
            engine=engine,
            strict=asked.strict,
            progress=progress,
            together=together,
        )
    found = [done.record for _, done in report.completed]
    doubts = {
        "ambiguous": sum(one.ambiguous for one in found),
        "not_convincing": sum(not one.convincing for one in found),
        "groups": together and together.collection.groups,
        "foreign": together and together.collection.foreign,
    }
    tell_run(asked, report, asked.store, doubts)
