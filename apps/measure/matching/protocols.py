"""Protocols: which ordered pairs are matched, and which truth counts."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from measure.matching.subjects import Subject
from spectra_kit._core.validate import check_count
from spectra_kit.errors import InvalidInputError

Pairs = list[tuple[str, str]]

_SMALLER = "; at each correspondence the smaller of the direct and the symmetric error"
PROTOCOLS = {
    "random": "ordered pairs drawn at random, without self pairs",
    "all-pairs": "all ordered pairs, without self pairs",
    "ren-300": f"the pairs listed by Ren et al. 2018 as far as present{_SMALLER}",
    "same-class": "ordered pairs within each class, without self pairs",
}
_SYMMETRIC = ("ren-300",)
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
) -> Protocol:
    """Choose the pairs, of subjects in the order that random ones are drawn from.

    `count` of them are drawn at random with `seed`; without it "random" takes 100, the others all.
    A larger number adds pairs to those of a smaller one. `listed` is the file of "ren-300", two
    names in each line; those of which one is missing are left out.
    """
    if name not in PROTOCOLS:
        raise InvalidInputError("name", f"be one of {', '.join(PROTOCOLS)}", repr(name))
    everyone = list(subjects)
    if name == "ren-300":
        present = {subject.name for subject in everyone}
        pairs = [pair for pair in _listed(listed) if set(pair) <= present]
    else:
        pairs = [
            (a.name, b.name)
            for a, b in itertools.permutations(everyone, 2)
            if name != "same-class" or a.species == b.species
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


def _listed(path: Path | None) -> Pairs:
    if path is None or not path.is_file():
        advice = "the pairs of Ren et al. come with their data set"
        expected = "be a file with two names in each line"
        raise InvalidInputError("listed", expected, str(path), advice=advice)
    rows = [line.split() for line in path.read_text().splitlines() if line.strip()]
    for number, row in enumerate(rows, start=1):
        if len(row) != 2:
            raise InvalidInputError(f"line {number} of {path} must hold two names, got {row}")
    return [(row[0], row[1]) for row in rows]
