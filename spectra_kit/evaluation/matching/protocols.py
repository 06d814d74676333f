"""Protocols: which ordered pairs an evaluation matches, and which truth it counts."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from spectra_kit._validate import check_count
from spectra_kit.errors import InvalidInputError
from spectra_kit.evaluation.matching.subjects import Subject

#: What each protocol is, in words.
PROTOCOLS = {
    "random": "ordered pairs drawn at random, without self pairs",
    "all-pairs": "all ordered pairs, without self pairs",
    "ren-300": "the pairs listed by Ren et al. 2018 as far as present; at each correspondence the"
    " smaller of the direct and the symmetric error",
    "same-class": "ordered pairs within each class, without self pairs; at each correspondence the"
    " smaller of the direct and the symmetric error",
}


@dataclass(frozen=True)
class Protocol:
    """Ordered pairs to match.

    Attributes
    ----------
    name : str
        One of `PROTOCOLS`.
    pairs : tuple of (str, str)
        Names of source and target.
    symmetric : bool
        Whether the smaller of direct and symmetric error counts at each correspondence.
    """

    name: str
    pairs: tuple[tuple[str, str], ...]
    symmetric: bool = False


def make_protocol(
    name: str,
    subjects: Iterable[Subject],
    *,
    count: int | None = None,
    seed: int = 0,
    listed: str | os.PathLike[str] | None = None,
) -> Protocol:
    """Choose the pairs.

    Parameters
    ----------
    name : {"random", "all-pairs", "ren-300", "same-class"}
        See `PROTOCOLS`.
    subjects : iterable of Subject
        In the order that random pairs are drawn from.
    count : int, optional
        So many of the pairs, drawn at random; "random" takes 100 by default, others all. A
        larger number adds pairs to those of a smaller one.
    seed : int, default 0
        Of the draw.
    listed : path, optional
        File of two names in each line, for "ren-300".

    Returns
    -------
    Protocol
        Listed pairs of which a subject is missing are left out.

    Raises
    ------
    InvalidInputError
        If `name` is another, the list is missing or no pair is left.

    Examples
    --------
    >>> from spectra_kit.evaluation.matching import demo_subjects, make_protocol
    >>> subjects = demo_subjects(500, poses=3).values()
    >>> make_protocol("random", subjects, count=2, seed=1).pairs
    (('creature...', 'creature...'), ('creature...', 'creature...'))
    >>> len(make_protocol("all-pairs", subjects).pairs)
    6
    """
    if name not in PROTOCOLS:
        raise InvalidInputError(f"`name` must be one of {', '.join(PROTOCOLS)}, got {name!r}")
    everyone = list(subjects)
    if name == "ren-300":
        present = {subject.name for subject in everyone}
        pairs = [pair for pair in _listed(listed) if set(pair) <= present]
    else:
        pairs = [
            (a.name, b.name)
            for a, b in itertools.permutations(everyone, 2)
            if name != "same-class" or a.kind == b.kind
        ]
    if not pairs:
        raise InvalidInputError(
            f"protocol {name!r} must have a pair, found none among {len(everyone)} subjects"
        )
    if count is None and name == "random":
        count = 100
    if count is not None:
        pairs = _drawn(pairs, check_count("count", count, low=1), seed)
    return Protocol(name, tuple(pairs), symmetric=name in ("ren-300", "same-class"))


def _drawn(pairs: Sequence[tuple[str, str]], count: int, seed: int) -> list[tuple[str, str]]:
    rng = np.random.default_rng(check_count("seed", seed, low=0))
    # The first of one order: a larger draw begins with a smaller one, and goes on from it.
    return [pairs[i] for i in rng.permutation(len(pairs))[:count]]


def _listed(path: str | os.PathLike[str] | None) -> list[tuple[str, str]]:
    if path is None or not Path(path).is_file():
        raise InvalidInputError(
            f"`listed` must be a file with two names in each line, got {path}; the pairs of Ren et"
            " al. come with their data set"
        )
    rows = [line.split() for line in Path(path).read_text().splitlines() if line.strip()]
    for number, row in enumerate(rows, start=1):
        if len(row) != 2:
            raise InvalidInputError(f"line {number} of {path} must hold two names, got {row}")
    return [(row[0], row[1]) for row in rows]
