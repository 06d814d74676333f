"""`match_all`: the maps of pairs of shapes of a store, each searched for once."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.checked import checked
from spectra_kit._core.fingerprint import facts_digest
from spectra_kit._core.threads import single_threaded_blas
from spectra_kit._core.validate import check_count
from spectra_kit._core.warn import hearing
from spectra_kit.datasets.files import MapRecord, ShapeRecord, damage
from spectra_kit.datasets.inputs import Pair, records_of, refuse_twice
from spectra_kit.datasets.plan import Plan
from spectra_kit.datasets.run import BatchReport, Completed, Engine, Job, Progress, own_order, run
from spectra_kit.datasets.store import SpectrumStore, map_facts
from spectra_kit.errors import InvalidFileError, InvalidInputError, SpectraKitError
from spectra_kit.maps import (
    Candidate,
    Collection,
    Match,
    MatchOptions,
    Prepared,
    match,
    match_collection,
    prepare,
)
from spectra_kit.maps.prepare import LOWEST_K
from spectra_kit.maps.result import DEFAULT

_TILE = 4  # sources by targets that are matched one after the other: shapes are prepared anew less
#: Prepared shapes that a worker keeps: those of a tile and the row that it works on.
KEPT = 6
#: Columns of a pair: empty, unless it was matched by itself as well (`CollectedPair`).
OF_COLLECTED = ("score_alone", "cycle_error")
_COLLECTED = "collected"  # folder in a store: what those pairs found, so that a run goes on
_MISMATCH = "mismatch_"  # before the names of mismatches, among those of arrays


@checked
@dataclass(frozen=True, kw_only=True)
class Matching:
    """How shapes of a store are matched; all as in `match`.

    Parameters
    ----------
    k : int, default 150
        Modes to end with, at least 30; fewer where a spectrum has fewer.
    mirrored : bool, optional
        Whether maps turn the surface over; both are tried without it.
    elastic : bool, default True
        Whether to bend the source onto the target in the end.
    options : MatchOptions
        What is tried and believed.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> sk.datasets.Matching(mirrored=False).k
    150
    """

    k: int = 150
    mirrored: bool | None = None
    elastic: bool = True
    options: MatchOptions = DEFAULT

    def __post_init__(self) -> None:
        check_count("k", self.k, low=LOWEST_K)

    def key(self, source: ShapeRecord, target: ShapeRecord) -> str:
        """Return the hash of all that a map between two shapes follows from, for `load_match`."""
        return facts_digest(map_facts(source.spectrum, target.spectrum, self._how(source, target)))

    def _how(self, source: ShapeRecord, target: ShapeRecord) -> dict[str, object]:
        """What a map follows from beside its ends: modes that are not there decide nothing."""
        there = min(int(str(one.facts["k"])) for one in (source, target))
        return {**asdict(self), "k": min(self.k, there)}


@checked
def match_all(
    pairs: Sequence[Pair],
    store: SpectrumStore,
    plan: Plan | None = None,
    *,
    matching: Matching = Matching(),
    engine: Engine | None = None,
    strict: bool = False,
    progress: Progress | None = None,
) -> BatchReport[Pair, MapRecord]:
    """Match pairs of shapes of a store, but for those whose map it has already.

    Interrupted and called again, it goes on; several runs may share a store: see `compute_all`.

    Parameters
    ----------
    pairs : sequence of Pair
        As `find_pairs` returns them.
    store : SpectrumStore
        What holds the shapes and their spectra, and keeps the maps.
    plan : Plan, optional
        By which the spectra were computed, where the store has several.
    matching : Matching
        How they are matched.
    engine, strict, progress
        As of `compute_all`.

    Returns
    -------
    BatchReport
        Results and failures. The maps themselves are in the store: `load_match`.

    Raises
    ------
    StoreError
        If the store cannot be written: no other map could be kept either.
    SpectraKitError
        Of the first pair that fails, if it is `strict`; if the engine is lost.

    Notes
    -----
    A pair fails by itself if a name is not in the store, a shape is one that `match` refuses (of
    several components, of fewer than 30 modes), or what the store holds of it is damaged.

    Pairs are taken in tiles of four sources by four targets, and each worker keeps the last six
    shapes that it has prepared.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import spectra_kit as sk
    >>> folder = Path(tempfile.mkdtemp())
    >>> animal = sk.geometry.creature(600)
    >>> sk.geometry.write(animal, folder / "animal.off")
    >>> sk.geometry.write(sk.geometry.mirrored(animal), folder / "image.off")
    >>> store, plan = sk.datasets.SpectrumStore(folder / "store"), sk.datasets.Plan(k=60)
    >>> inputs = [
    ...     sk.datasets.Input(name=name, path=folder / f"{name}.off")
    ...     for name in ("animal", "image")
    ... ]
    >>> _ = sk.datasets.compute_all(inputs, store, plan)
    >>> report = sk.datasets.match_all(sk.datasets.find_pairs("all", store), store)
    >>> pair, found = report.completed[0]
    >>> pair.name, found.record.mirrored
    ('animal to image', True)
    >>> sk.datasets.load_match(store, found.record.key).point_map[:4]
    array([0, 1, 2, 3])
    """
    records = records_of(store, None if plan is None else plan.facts)
    return match_records(
        pairs, store, records, matching=matching, engine=engine, strict=strict, progress=progress
    )


class Together(NamedTuple):
    """A collection whose maps are kept, and the spectra that all of them follow from."""

    collection: Collection
    among: list[str]


def match_records(
    pairs: Sequence[Pair],
    store: SpectrumStore,
    records: Mapping[str, ShapeRecord],
    *,
    matching: Matching,
    together: Together | None = None,
    strict: bool = False,
    **options: Any,
) -> BatchReport[Pair, MapRecord]:
    """Match pairs of which `records` tell what the store holds: see `match_all`."""
    refuse_twice("pairs", [repr((pair.source, pair.target)) for pair in pairs])
    do = partial(matched, matching=matching, together=together)

    def look(pair: Pair) -> InvalidInputError | Job:
        ends = {"source": pair.source, "target": pair.target}
        for end, name in ends.items():
            if name not in records:
                return InvalidInputError(
                    end,
                    "be the name of a shape in the store",
                    repr(name),
                    advice="compute it first; `spectra-kit store list` tells all names",
                )
        return Job(pair.name, Path(store.path), (records[pair.source], records[pair.target]), do)

    def order(todo: list[int]) -> list[int]:
        return in_tiles(pairs, todo, list if strict else own_order)

    return run("pairs", pairs, look, order, strict=strict, **options)


def in_tiles(
    pairs: Sequence[Pair],
    todo: Sequence[int],
    order: Callable[[Sequence[int]], list[int]] = list,
) -> list[int]:
    """Return the places of pairs so that few shapes take part in those of a while.

    `order` says in which the rows of tiles come.
    """
    places: dict[str, int] = {}
    for pair in pairs:
        for name in (pair.source, pair.target):
            places.setdefault(name, len(places))
    rows = order(range(-(-len(places) // _TILE)))

    def tile(place: int) -> tuple[int, ...]:
        i, j = places[pairs[place].source], places[pairs[place].target]
        return rows[i // _TILE], j // _TILE, i, j

    return sorted(todo, key=tile)


def collected(
    pairs: Sequence[Pair],
    store: SpectrumStore,
    records: Mapping[str, ShapeRecord],
    *,
    matching: Matching,
    progress: Progress,
) -> tuple[Together, list[Pair]]:
    """Match the shapes of the pairs as one collection; return the pairs with what is told of each.

    Shapes that cannot be matched are left out: their pairs will fail, and say why.
    """
    shapes = {}
    named = {end for pair in pairs for end in (pair.source, pair.target)}
    for name in sorted(named & {*records}):
        with suppress(SpectraKitError):
            shape, spectrum = records[name].shape, records[name].spectrum
            shapes[name] = prepared(os.fspath(store.path), shape, spectrum)
    collection = match_collection(
        shapes,
        mirrored=matching.mirrored,
        folder=Path(store.path) / _COLLECTED,
        options=matching.options,
        progress=progress,
    )
    alone = {frozenset((one.source, one.target)): one for one in collection.pairs}

    def told(pair: Pair) -> dict[str, str]:
        one = alone.get(frozenset((pair.source, pair.target)))
        return {name: f"{getattr(one, name):.6g}" if one else "" for name in OF_COLLECTED}

    among = [records[name].spectrum for name in shapes]
    more = [replace(pair, columns={**pair.columns, **told(pair)}) for pair in pairs]
    return Together(collection, among), more


@checked
def load_match(store: SpectrumStore, key: str) -> Match | None:
    """Return a match that a store keeps.

    Parameters
    ----------
    store : SpectrumStore
        Which `match_all` has filled.
    key : str
        As `MapRecord` has it, and the table of a run.

    Returns
    -------
    Match or None
        The very numbers; None where there is none.

    Raises
    ------
    InvalidFileError
        If the entry is damaged.

    Examples
    --------
    >>> import tempfile
    >>> import spectra_kit as sk
    >>> sk.datasets.load_match(sk.datasets.SpectrumStore(tempfile.mkdtemp()), "0" * 32) is None
    True
    """
    found = store.load_map(key)
    if found is None:
        return None
    facts, arrays = found
    if "options" not in facts["how"]:
        raise InvalidInputError("key", "be that of a match", repr(key))
    return _restored(arrays)


def matched(
    store: SpectrumStore,
    source: ShapeRecord,
    target: ShapeRecord,
    matching: Matching,
    together: Together | None = None,
) -> Completed[MapRecord]:
    """Match two shapes of a store, by themselves or `together`, unless it has that map already.

    A map that is there is read whole, so that damage is found. BLAS gets one thread, as in
    `complete`.
    """
    start, replaced = time.perf_counter(), tuple[str, ...]()
    how = matching._how(source, target) | ({"among": together.among} if together else {})
    key = facts_digest(map_facts(source.spectrum, target.spectrum, how))
    try:
        found = load_match(store, key)
    except InvalidFileError as error:
        found, replaced = None, (damage(error),)
    if computed := found is None:
        with single_threaded_blas(), hearing():  # `convincing` tells of doubts
            if together and {source.name, target.name} <= {*together.collection.shapes}:
                found = together.collection.pair(
                    source.name, target.name, k=matching.k, elastic=matching.elastic
                )
            else:
                place, ends = os.fspath(store.path), (source, target)
                found = match(
                    *(prepared(place, one.shape, one.spectrum) for one in ends),
                    k=matching.k,
                    mirrored=matching.mirrored,
                    elastic=matching.elastic,
                    options=matching.options,
                )
        store.keep_map(source.spectrum, target.spectrum, how, _arrays(found))
    judged = {one.name: getattr(found, one.name) for one in fields(MapRecord) if one.name != "key"}
    return Completed(
        record=MapRecord(key=key, **judged),
        computed=computed,
        replaced=replaced,
        seconds=time.perf_counter() - start,
    )


@lru_cache(maxsize=KEPT)
def prepared(store: str, shape: str, spectrum: str) -> Prepared:
    """Return a shape of a store, ready to be matched; the last few are kept for further pairs."""
    place = SpectrumStore(store)
    modes = place.load(spectrum)
    if modes is None:
        raise InvalidInputError(
            "store", "hold the spectrum of each shape", f"none of {spectrum}", advice="compute it"
        )
    return prepare(modes, place.shape(shape))


def _arrays(match: Match) -> dict[str, NDArray[Any]]:
    """Return a match as arrays."""
    candidates = match.candidates
    judged = [
        float(match.mirrored),
        *(np.nan if one is None else one for one in (match.orientation, match.discontinuity)),
        *(match.margin, match.mirror_margin, match.consistent, match.coverage),
        *(match.clustered, *match.rims, *(match.genera or (np.nan, np.nan))),
        *(float(match.unconnected), float(match.n_source or 0)),
    ]
    return {
        "point_map": match.point_map,
        "functional_map": match.functional_map,
        "judged": np.array(judged),
        "candidate_maps": np.array([one.functional_map for one in candidates]),
        "candidate_scores": np.array([one.score for one in candidates]),
        "candidates_mirrored": np.array([one.mirrored for one in candidates], dtype=np.int8),
        **{
            _MISMATCH + name: np.array([one.mismatches[name] for one in candidates])
            for name in candidates[0].mismatches
        },
    }


def _restored(arrays: Mapping[str, NDArray[Any]]) -> Match:
    """Return the match of such arrays."""
    judged: list[float] = arrays["judged"].tolist()
    mirrored, orientation, discontinuity, margin, mirror_margin, consistent, coverage, *more = (
        judged
    )
    # Older releases told less.
    clustered, *rims, genus, other = more[:5] or [1.0, 0.0, 0.0, np.nan, np.nan]
    mismatches = {
        name.removeprefix(_MISMATCH): values.tolist()
        for name, values in arrays.items()
        if name.startswith(_MISMATCH)
    }
    candidates = tuple(
        Candidate(
            functional_map=C,
            score=score,
            mismatches={name: values[i] for name, values in mismatches.items()},
            mirrored=bool(arrays["candidates_mirrored"][i]),
        )
        for i, (C, score) in enumerate(
            zip(arrays["candidate_maps"], arrays["candidate_scores"].tolist(), strict=True)
        )
    )
    return Match(
        point_map=arrays["point_map"],
        functional_map=arrays["functional_map"],
        mirrored=bool(mirrored),
        orientation=None if np.isnan(orientation) else orientation,
        margin=margin,
        mirror_margin=mirror_margin,
        consistent=consistent,
        coverage=coverage,
        discontinuity=None if np.isnan(discontinuity) else discontinuity,
        candidates=candidates,
        clustered=clustered,
        rims=(rims[0], rims[1]),
        genera=None if np.isnan(genus) else (int(genus), int(other)),
        unconnected=bool(sum(more[5:6])),
        n_source=int(sum(more[6:7])) or None,
    )
