"""`matched`: from two shapes of a store to the map between them, unless the store has that too."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.checked import checked
from spectra_kit._core.fingerprint import facts_digest
from spectra_kit._core.threads import single_threaded_blas
from spectra_kit._core.validate import Brief, check_count, hearing
from spectra_kit.datasets.files import ShapeRecord, damage
from spectra_kit.datasets.store import SpectrumStore, map_facts
from spectra_kit.errors import InvalidFileError, InvalidInputError
from spectra_kit.maps import (
    Candidate,
    Collection,
    Match,
    MatchOptions,
    Prepared,
    match,
    prepare,
)
from spectra_kit.maps.prepare import LOWEST_K
from spectra_kit.maps.result import DEFAULT

#: Prepared shapes that a worker keeps: those of a tile of `match_all` and the row that it works on.
KEPT = 6
#: What a table tells of a match beside its doubts.
JUDGED = ("score", "coverage", "margin", "mirror_margin", "orientation", "confidence", "mirrored",
          "ambiguous", "convincing")  # fmt: skip
_MISMATCH = "mismatch_"  # before the names of mismatches, among those of arrays


@checked
@dataclass(frozen=True, kw_only=True)
class Matching:
    """How shapes of a store are matched; all as in `match`.

    Parameters
    ----------
    k : int, default 150
        Modes to end with; fewer where a spectrum has fewer.
    mirrored : bool, optional
        Whether maps turn the surface over; both are tried without it.
    elastic : bool, default True
        Whether to bend the source onto the target in the end.
    options : MatchOptions
        What is tried and believed.

    Raises
    ------
    InvalidInputError
        If `k` is below 30.

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
        """Return the hash of all that a map between two shapes follows from.

        Parameters
        ----------
        source, target : ShapeRecord
            What a store holds of them.

        Returns
        -------
        str
            32 hexadecimal digits, for `load_match`.
        """
        how = how_of(self, source, target)
        return facts_digest(map_facts(source.spectrum, target.spectrum, how))


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Matched(Brief):
    """What a store holds of a pair, now.

    Attributes
    ----------
    key : str
        Of the map: see `load_match`.
    score, margin, mirror_margin, coverage : float
        How good the map is: see `Match`.
    orientation : float or None
        Of it.
    confidence : float
        How likely it is right.
    mirrored, ambiguous, convincing : bool
        What it is believed to be.
    doubts : tuple of str
        What speaks against it.
    computed : bool
        Whether it was searched for, or there.
    replaced : tuple of str
        What was damaged and computed again.
    seconds : float
        That it took.
    """

    key: str
    score: float
    margin: float
    mirror_margin: float
    coverage: float
    orientation: float | None
    confidence: float
    mirrored: bool
    ambiguous: bool
    convincing: bool
    doubts: tuple[str, ...]
    computed: bool
    replaced: tuple[str, ...]
    seconds: float


class Together(NamedTuple):
    """A collection whose maps are kept, and the spectra that all of them follow from."""

    collection: Collection
    among: list[str]


@checked
def load_match(store: SpectrumStore, key: str) -> Match | None:
    """Return a match that a store keeps.

    Parameters
    ----------
    store : SpectrumStore
        Which `match_all` has filled.
    key : str
        As `Matched` has it, and the table of a run.

    Returns
    -------
    Match or None
        The very numbers; None where there is none.

    Raises
    ------
    InvalidInputError
        If the map is none of `match_all`.
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


def how_of(matching: Matching, source: ShapeRecord, target: ShapeRecord) -> dict[str, object]:
    """Return what a map follows from beside its ends; modes that are not there do not matter."""
    there = min(int(str(one.facts["k"])) for one in (source, target))
    return {**asdict(matching), "k": min(matching.k, there)}


def matched(
    store: SpectrumStore,
    source: ShapeRecord,
    target: ShapeRecord,
    matching: Matching,
    together: Together | None = None,
) -> Matched:
    """Match two shapes of a store, by themselves or `together`, unless it has that map already.

    A map that is there is read whole, so that damage is found. BLAS gets one thread, as in
    `complete`.
    """
    start, replaced = time.perf_counter(), tuple[str, ...]()
    how = how_of(matching, source, target) | ({"among": together.among} if together else {})
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
    return Matched(
        key=key,
        **{name: getattr(found, name) for name in JUDGED},
        doubts=found.doubts,
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
    clustered, *rims, genus, other = more or [1.0, 0.0, 0.0, np.nan, np.nan]  # of older releases
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
    )
