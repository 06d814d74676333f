"""`Protocol`: which pairs are matched; `PairSet`: these with subjects, named or retriangulated."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from spectra_kit._core.validate import check_count
from spectra_kit.errors import InvalidInputError
from spectra_kit.show.camera import Up
from studies.matching.subjects import LACKING, Subject, demo_subjects, subjects_in
from studies.matching.triangulations import REFUSE, Maker, named, remade, rounding
from studies.shapes import data_folder

# --- which pairs ---

_Listed = list[tuple[str, str]]

_SMALLER = "; at each correspondence the smaller of the direct and the symmetric error"
PROTOCOLS = {
    "random": "ordered pairs drawn at random, without self pairs",
    "all-pairs": "all ordered pairs, without self pairs",
    "ren-300": f"the pairs listed by Ren et al. 2018 as far as present{_SMALLER}",
    "same-class": "ordered pairs within each class, without self pairs",
    "halves": "ordered pairs within each class and each half of the shapes, every second by name",
    "given": "the pairs whose truth comes with the set",
}
_SYMMETRIC = ("ren-300",)
_WITHIN = ("same-class", "halves")  # protocols of pairs within a class
_RANDOM = 100  # pairs, where no other number is asked for


@dataclass(frozen=True)
class Protocol:
    """Ordered pairs of names, of source and target, chosen as one of `PROTOCOLS` says."""

    name: str
    pairs: tuple[tuple[str, str], ...]

    @property
    def symmetric(self) -> bool:
        """Whether the smaller of direct and symmetric error counts at each correspondence."""
        return self.name in _SYMMETRIC


def make_protocol(
    name: str,
    subjects: Iterable[Subject],
    *,
    count: int | None = None,
    seed: int = 0,
    listed: Path | None = None,
    one_class: bool = False,
) -> Protocol:
    """Choose the pairs, of subjects in the order that random ones are drawn from.

    `count` of them are drawn at random with `seed`; without it "random" takes 100, the others all.
    A larger number adds pairs to those of a smaller one. `listed` is the file of "ren-300", two
    names in each line; those of which one is missing are left out.
    """
    everyone = list(subjects)
    if name == "ren-300":
        present = {subject.name for subject in everyone}
        pairs = [pair for pair in _listed(listed) if set(pair) <= present]
    elif name == "given":  # of A_B each vertex of A gets one of B
        present = {subject.name for subject in everyone}
        pairs = [(b, one.name) for one in everyone for b in one.images if b in present]
    else:
        half = halves(subject.name for subject in everyone)
        pairs = [
            (a.name, b.name)
            for a, b in itertools.permutations(everyone, 2)
            if (name not in _WITHIN or one_class or a.species == b.species)
            and (name != "halves" or half[a.name] == half[b.name])
        ]
    if not pairs:
        raise InvalidInputError(
            f"protocol {name!r} must have a pair, found none among {len(everyone)} subjects"
        )
    if count is None and name == "random":
        count = _RANDOM
    if count is not None:
        rng = np.random.default_rng(check_count("seed", seed, low=0))
        # The first of one order: a larger draw begins with a smaller one, and goes on from it.
        order = rng.permutation(len(pairs))[: check_count("count", count, low=1)]
        pairs = [pairs[i] for i in order]
    return Protocol(name, tuple(pairs))


def halves(names: Iterable[str]) -> dict[str, int]:
    """Return the half, 0 or 1, that each name is of: every second."""
    return {name: i % 2 for i, name in enumerate(sorted(names))}


def _listed(path: Path | None) -> _Listed:
    if path is None or not path.is_file():
        advice = "the pairs of Ren et al. come with their data set"
        expected = "be a file with two names in each line"
        raise InvalidInputError("listed", expected, str(path), advice=advice)
    rows = [line.split() for line in path.read_text().splitlines() if line.strip()]
    for number, row in enumerate(rows, start=1):
        if len(row) != 2:
            raise InvalidInputError(f"line {number} of {path} must hold two names, got {row}")
    return [(row[0], row[1]) for row in rows]


# --- sets ---

#: What is measured of a set where no other protocol is asked for; of others, random pairs.
USUAL = {
    "smal_r": "all-pairs",
    "scape_a": "all-pairs",
    "tosca_r": "same-class",
    "shrec19": "given",
}
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
            one_class=name in _ONE_CLASS,
        )
        used = {name for pair in made.pairs for name in pair}
        sets[name] = PairSet(
            name, {n: s for n, s in subjects.items() if n in used}, made, up=_UP.get(name)
        )
    return list(sets.values())


def remade_sets(
    pairs: PairSet, makers: Mapping[str, Maker], *, count: int, seed: int = 0
) -> list[PairSet]:
    """Return the first `count` pairs many times, the target as each of the makers makes it.

    The first of these returns it as it is. Pairs whose target one of them refuses are passed over:
    it changes its topology in marching cubes, or no parts of it touch.
    """
    check_count("count", count, low=1)
    kept: list[tuple[str, str]] = []
    made: dict[str, dict[str, Subject]] = {}
    passed: dict[str, str] = {}
    for source, target in pairs.protocol.pairs:
        if target not in made and target not in passed:
            try:
                made[target] = {
                    kind: remade(pairs.subjects[target], kind, makers, seed=seed)
                    for kind in sorted(makers, key=lambda kind: kind not in REFUSE)
                }
            except InvalidInputError as refused:
                passed[target] = str(refused)
        if target in made:
            kept.append((source, target))
        if len(kept) == count:
            break
    if not kept:
        raise InvalidInputError(
            "pairs", "hold a target of which all can be made", next(iter(passed.values()))
        )
    targets = dict.fromkeys(target for _, target in kept)
    sets = []
    for kind in makers:
        names = [(source, made[target][kind].name) for source, target in kept]
        subjects = {source: pairs.subjects[source] for source, _ in kept}
        subjects |= {made[target][kind].name: made[target][kind] for target in targets}
        off = [rounding(pairs.subjects[target], made[target][kind]) for target in targets]
        lost = [(made[target][kind].landmarks == LACKING).mean() for target in targets]
        note = f"the points of landmarks are {np.mean(off):.2f} away from them on average"
        note += f" (without {np.mean(lost):.1%} that are lost)" if any(lost) else ""
        if passed:
            note += f"; passed over, as they cannot be made so: {', '.join(passed)}"
        sets.append(
            PairSet(
                named(pairs.name, kind),
                subjects,
                Protocol(pairs.protocol.name, tuple(names)),
                note,
                against=named(pairs.name, next(iter(makers))),
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
