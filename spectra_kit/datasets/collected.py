"""Shapes of a store as one collection, by way of which the maps of all pairs agree."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from spectra_kit.datasets.files import ShapeRecord
from spectra_kit.datasets.inputs import Pair
from spectra_kit.datasets.matched import Matching, Together, prepared
from spectra_kit.datasets.store import SpectrumStore
from spectra_kit.errors import SpectraKitError
from spectra_kit.maps import match_collection

#: Columns of a pair: empty, unless it was matched by itself as well (`CollectedPair`).
OF_COLLECTED = ("score_alone", "cycle_error")
_FOLDER = "collected"  # of a store: what those pairs found, so that a run goes on


def collected(
    store: SpectrumStore,
    pairs: Sequence[Pair],
    records: Mapping[str, ShapeRecord],
    *,
    matching: Matching,
    progress: Callable[[int, int], object],
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
        folder=Path(store.path) / _FOLDER,
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
