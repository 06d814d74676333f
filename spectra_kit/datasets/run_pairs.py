"""`match_all`: the maps of many pairs, by whoever works, into the store that holds their shapes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spectra_kit._core.checked import checked
from spectra_kit._core.clock import Clock
from spectra_kit.datasets.files import ShapeRecord
from spectra_kit.datasets.inputs import Pair, refuse_twice
from spectra_kit.datasets.matched import Matched, Matching, Together, matched
from spectra_kit.datasets.pairs import records_of
from spectra_kit.datasets.plan import Plan
from spectra_kit.datasets.run import BatchReport, Engine, own_order, report_of, work
from spectra_kit.datasets.store import SpectrumStore
from spectra_kit.errors import InvalidInputError

_TILE = 4  # sources by targets that are matched one after the other: shapes are prepared anew less


@dataclass(frozen=True)
class _Search:
    """A pair that is to be matched."""

    pair: Pair
    source: ShapeRecord
    target: ShapeRecord
    store: Path
    matching: Matching
    together: Together | None = None

    @property
    def name(self) -> str:
        return self.pair.name

    def __call__(self) -> Matched:
        ends = (self.source, self.target)
        return matched(SpectrumStore(self.store), *ends, self.matching, self.together)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle it with paths from the root: who works may have another folder as theirs."""
        return _Search, (
            *(self.pair, self.source, self.target),
            self.store.absolute(),
            *(self.matching, self.together),
        )


@checked
def match_all(
    store: SpectrumStore,
    pairs: Sequence[Pair],
    plan: Plan | None = None,
    *,
    matching: Matching = Matching(),  # noqa: B008
    engine: Engine | None = None,
    strict: bool = False,
    progress: Callable[[int, int], object] | None = None,
) -> BatchReport[Pair, Matched]:
    """Match pairs of shapes of a store, but for those whose map it has already.

    Interrupted, it loses what is in work; called again, it goes on. Several runs may share a store:
    each goes in an order of its own, and meets what others have done.

    Parameters
    ----------
    store : SpectrumStore
        What holds the shapes and their spectra, and keeps the maps.
    pairs : sequence of Pair
        As `find_pairs` returns them.
    plan : Plan, optional
        By which the spectra were computed, where the store has several.
    matching : Matching
        How they are matched.
    engine : Engine, optional
        Who works, such as a `DaskEngine`; by default this process, one pair after the other.
    strict : bool, default False
        Stop at the first failure, and raise it.
    progress : callable, optional
        Told how many pairs of how many are done.

    Returns
    -------
    BatchReport
        Results and failures. The maps themselves are in the store: `load_match`.

    Raises
    ------
    InvalidInputError
        If the store has no spectra, or those of several plans and none is given; if a pair is named
        twice.
    StoreError
        If the store cannot be written: no other map could be kept either.
    SpectraKitError
        Of the first pair that fails, if it is `strict`; or if the engine is lost.

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
    >>> report = sk.datasets.match_all(store, sk.datasets.find_pairs("all", store))
    >>> pair, found = report.completed[0]
    >>> pair.name, found.mirrored
    ('animal to image', True)
    >>> sk.datasets.load_match(store, found.key).point_map[:4]
    array([0, 1, 2, 3])
    """
    records = records_of(store, None if plan is None else plan.facts)
    return match_records(
        store,
        pairs,
        records,
        matching=matching,
        engine=engine,
        strict=strict,
        progress=progress,
    )


def match_records(
    store: SpectrumStore,
    pairs: Sequence[Pair],
    records: Mapping[str, ShapeRecord],
    *,
    matching: Matching,
    engine: Engine | None,
    strict: bool,
    progress: Callable[[int, int], object] | None,
    together: Together | None = None,
) -> BatchReport[Pair, Matched]:
    """Match pairs of which `records` tell what the store holds: see `match_all`."""
    clock = Clock()
    refuse_twice("pairs", [repr((pair.source, pair.target)) for pair in pairs])
    searches, found = list[_Search](), dict[tuple[str, str], Any]()
    for pair in in_tiles(pairs, list if strict else own_order):
        if unknown := _unknown(pair, records):
            if strict:
                raise unknown
            found[pair.source, pair.target] = unknown
        else:
            ends = (records[pair.source], records[pair.target])
            searches.append(_Search(pair, *ends, Path(store.path), matching, together))
    results = work(searches, engine=engine, strict=strict, progress=progress)
    found |= {
        (one.pair.source, one.pair.target): result
        for one, result in zip(searches, results, strict=True)
    }
    return report_of([(pair, found[pair.source, pair.target]) for pair in pairs], clock)


def in_tiles(
    pairs: Sequence[Pair], order: Callable[[Sequence[int]], list[int]] = list
) -> Iterator[Pair]:
    """Yield the pairs so that few shapes take part in those of a while.

    `order` says in which the rows of tiles come.
    """
    places: dict[str, int] = {}
    for pair in pairs:
        for name in (pair.source, pair.target):
            places.setdefault(name, len(places))
    rows = order(range(-(-len(places) // _TILE)))

    def tile(pair: Pair) -> tuple[int, ...]:
        i, j = places[pair.source], places[pair.target]
        return rows[i // _TILE], j // _TILE, i, j

    yield from sorted(pairs, key=tile)


def _unknown(pair: Pair, records: Mapping[str, ShapeRecord]) -> InvalidInputError | None:
    """Return what is wrong with the names of a pair, if anything is."""
    for end, name in (("source", pair.source), ("target", pair.target)):
        if name not in records:
            return InvalidInputError(
                end,
                "be the name of a shape in the store",
                repr(name),
                advice="compute it first; `spectra-kit store list` tells all names",
            )
    return None
