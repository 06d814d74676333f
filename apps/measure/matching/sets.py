"""`PairSet`: subjects and the pairs of them that are matched; sets by name, and retriangulated."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from measure.matching.protocols import Protocol, make_protocol
from measure.matching.subjects import LACKING, Subject, demo_subjects, subjects_in
from measure.matching.triangulations import TRIANGULATIONS, rounding, triangulated
from measure.shapes import data_folder
from spectra_kit._core.validate import check_count
from spectra_kit.errors import InvalidInputError
from spectra_kit.show.camera import Up

#: What is measured of a set where no other protocol is asked for; of others, random pairs.
USUAL = {"smal_r": "all-pairs", "scape_a": "all-pairs", "tosca_r": "same-class"}
_UP: dict[str, Up] = {"smal_r": "-y", "scape_a": "x", "tosca_r": "z"}  # else the view tells
_ONE_CLASS = ("smal_r",)  # whose names do not tell classes by letters and digits


@dataclass(frozen=True, eq=False)
class PairSet:
    """Subjects by their names, and which pairs of them are matched."""

    name: str  #: For tables and files.
    subjects: Mapping[str, Subject]
    protocol: Protocol
    note: str = ""  #: What else a reader should know, in a sentence.
    against: str = ""  #: The name of the set whose errors these are compared with.
    up: Up | None = None  #: The axis that points up in pictures, where it is known.


def demo_set(count: int | None = None) -> PairSet:
    """Return the pairs of a demo animal in its poses, or so many of them."""
    subjects = demo_subjects()
    return PairSet(
        "demo", subjects, make_protocol("all-pairs", subjects.values(), count=count), up="z"
    )


def pair_sets(
    data: Iterable[str | os.PathLike[str]],
    *,
    protocol: str | None = None,
    count: int | None = None,
    seed: int = 0,
    only: Sequence[str] = (),
    listed: Path | None = None,
) -> list[PairSet]:
    """Read sets, given by their folders or by their names in ``$SPECTRA_KIT_DATA``.

    Each has its usual protocol, or the one that is named; `count` and `seed` are those of
    `make_protocol`. `only` subjects whose names begin so are taken. `listed` is the file of
    "ren-300", by default ``ren_pairs.txt`` in the folder.
    """
    sets: dict[str, PairSet] = {}
    for folder in map(_folder, data):
        name = folder.name
        if name in sets:
            raise InvalidInputError("data", "have names of their own", f"{name} twice")
        chosen = protocol or USUAL.get(name, "random")
        if chosen == "same-class" and name in _ONE_CLASS:
            raise InvalidInputError(
                "protocol",
                f"be another one for {name}, whose names tell no classes",
                chosen,
                advice="all-pairs and random take all of it",
            )
        subjects = subjects_in(folder)
        if only:
            subjects = {n: s for n, s in subjects.items() if n.startswith(tuple(only))}
        made = make_protocol(
            chosen,
            subjects.values(),
            count=count,
            seed=seed,
            listed=listed or folder / "ren_pairs.txt",
        )
        used = {name for pair in made.pairs for name in pair}
        sets[name] = PairSet(
            name, {n: s for n, s in subjects.items() if n in used}, made, up=_UP.get(name)
        )
    return list(sets.values())


def triangulated_sets(pairs: PairSet, *, count: int, seed: int = 0) -> list[PairSet]:
    """Return the first `count` pairs six times, the target in each of `TRIANGULATIONS`.

    Pairs whose target changes its topology in marching cubes are passed over.
    """
    check_count("count", count, low=1)
    kept: list[tuple[str, str]] = []
    made: dict[str, dict[str, Subject]] = {}
    passed: dict[str, None] = {}
    for source, target in pairs.protocol.pairs:
        if target not in made and target not in passed:
            try:
                made[target] = {
                    kind: triangulated(pairs.subjects[target], kind, seed=seed)
                    for kind in reversed(TRIANGULATIONS)  # marching cubes may refuse, early
                }
            except InvalidInputError:
                passed[target] = None
        if target in made:
            kept.append((source, target))
        if len(kept) == count:
            break
    if not kept:
        raise InvalidInputError(
            "pairs", "hold a target that keeps its topology in marching cubes", list(passed)
        )
    targets = dict.fromkeys(target for _, target in kept)
    sets = []
    for kind in TRIANGULATIONS:
        named = [(source, made[target][kind].name) for source, target in kept]
        subjects = {source: pairs.subjects[source] for source, _ in kept}
        subjects |= {made[target][kind].name: made[target][kind] for target in targets}
        off = [rounding(pairs.subjects[target], made[target][kind]) for target in targets]
        lost = [(made[target][kind].landmarks == LACKING).mean() for target in targets]
        note = f"the points of landmarks are {np.mean(off):.2f} away from them on average"
        note += f" (without {np.mean(lost):.1%} that are lost)" if any(lost) else ""
        if passed:
            note += f"; passed over, as marching cubes change their topology: {', '.join(passed)}"
        sets.append(
            PairSet(
                f"{pairs.name}-{kind.replace(' ', '_')}",
                subjects,
                Protocol(pairs.protocol.name, tuple(named)),
                note,
                against=f"{pairs.name}-isotropic",
                up=pairs.up,
            )
        )
    return sets


def _folder(data: str | os.PathLike[str]) -> Path:
    path = Path(data)
    if path.is_dir():
        return path
    known = data_folder(str(data))
    if known is None or not known.is_dir():
        raise InvalidInputError(
            "data", "be folders, or names of sets in SPECTRA_KIT_DATA", repr(str(data))
        )
    return known
