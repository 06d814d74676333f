"""How far confidence can be trusted: of maps, and at points; as shipped, and as fitted anew.

Shapes are in two halves, every second by name, and pairs of two shapes of one half are told by
what was fitted to those of the other: no shape is seen before.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from spectra_kit._core.types import Bools, Floats, Ints
from spectra_kit.maps import calibration
from studies.matching.sets import halves
from studies.store import Record

RIGHT = 8.0  #: Hundredths of the root of the area up to which maps, and points, are right.
_BINS = (0.0, 0.1, 0.25, 0.5, 0.75, 0.9, 1.0)
_PRIOR = 1e-3  # of the squared weights of evidence of unit variance: keeps them finite
NAMES = [f"{low:g}-{high:g}" for low, high in itertools.pairwise(_BINS)]
COLUMNS = {"of": "", "by": "", **dict.fromkeys(NAMES, ""), "wrong below 0.5": "",
           "right below 0.5": ""}  # fmt: skip


def trust(folder: Path, records: Sequence[Record]) -> list[Record]:
    """Return rows of `COLUMNS`: how many of each bin were right, of how many.

    `records` are those of pairs, with their names and that of the set, of `match` alone.
    """
    shapes = {(r["set"], r[side]) for r in records for side in ("source", "target")}
    half = {
        (name, shape): i
        for name in {name for name, _ in shapes}
        for shape, i in halves(shape for of, shape in shapes if of == name).items()
    }
    sides = np.array([[half[r["set"], r[side]] for side in ("source", "target")] for r in records])
    of = np.where(sides[:, 0] == sides[:, 1], sides[:, 0], -1)
    right = np.array([r["direct"] <= RIGHT for r in records])
    shipped = np.array([r["confidence"] for r in records])
    known = [_points(folder, r) for r in records]
    rows = [_row("maps", "as shipped", shipped, right)]
    near = np.concatenate([errors <= RIGHT for _, errors in known])
    owner = np.repeat(np.arange(len(records)), [len(errors) for _, errors in known])
    points = _at_points(shipped, known)
    rows.append(_row("points", "as shipped", points, near))
    if not all(len(set(right[of == i])) == 2 for i in (0, 1)):
        return rows  # nothing to fit to
    fitted = _fitted_whole(records, right, of)
    evidence = np.concatenate(
        [calibration.evidence_at(c, *s.T) for c, (s, _) in zip(fitted, known, strict=True)]
    )
    there = of >= 0
    at = _crossed(evidence, near, of[owner], np.ones(len(near)))
    rows += [
        _row("maps of one half", "as shipped", shipped[there], right[there]),
        _row("maps of one half", "as fitted to the other", fitted[there], right[there]),
        _row("points of these", "as shipped", points[there[owner]], near[there[owner]]),
        _row("points of these", "as fitted to the other", at[there[owner]], near[there[owner]]),
    ]
    return rows


def _points(folder: Path, record: Record) -> tuple[Floats, Floats]:
    """Return what is seen at some points of a pair, and their errors."""
    [path] = (folder / name for name in record["files"] if name.endswith(".points.npz"))
    with np.load(path) as file:
        return np.asarray(file["seen"]), np.asarray(file["errors"])


def _at_points(whole: Floats, known: Sequence[tuple[Floats, Floats]]) -> Floats:
    each = zip(whole, known, strict=True)
    return np.concatenate([calibration.confidence_at(c, *seen.T) for c, (seen, _) in each])


def _fitted_whole(records: Sequence[Record], right: Bools, of: Ints) -> Floats:
    """Return confidences by what was fitted to the other half; right and wrong count alike.

    What else lowers the shipped confidence lowers these as much.
    """
    told = [{k: r[k] for k in ("score", "discontinuity", "margin", "coverage")} for r in records]
    evidence = np.array([list(calibration.evidence_of(**one).values()) for one in told])
    plain = np.array([calibration.confidence_of(**one) for one in told])
    shipped = np.array([r["confidence"] for r in records])
    weights = np.ones(len(records))
    for i in (0, 1):
        for value in (False, True):
            some = (of == i) & (right == value)
            weights[some] = 1 / max(some.sum(), 1)
    return np.asarray(np.minimum(_crossed(evidence, right, of, weights) * shipped / plain, 1.0))


def _crossed(evidence: Floats, right: Bools, of: Ints, weights: Floats) -> Floats:
    """Return the probabilities of rows of either half by a logistic fitted to the other."""
    out = np.full(len(evidence), np.nan)
    for i in (0, 1):
        some = of == 1 - i
        middle, scale = evidence[some].mean(axis=0), evidence[some].std(axis=0) + 1e-12
        scaled = np.column_stack([np.ones(len(evidence)), (evidence - middle) / scale])
        signs, share = np.where(right[some], 1.0, -1.0), weights[some] / weights[some].sum()

        def loss(
            b: Floats, x: Floats = scaled[some], s: Floats = signs, w: Floats = share
        ) -> float:
            return float(w @ np.logaddexp(0, -s * (x @ b)) + _PRIOR * (b[1:] @ b[1:]))

        found = minimize(loss, np.zeros(scaled.shape[1])).x
        out[of == i] = expit(scaled[of == i] @ found)
    return out


def _row(of: str, by: str, confidence: Floats, right: Bools) -> Record:
    place = np.clip(np.searchsorted(_BINS, confidence, side="right") - 1, 0, len(NAMES) - 1)
    row: Record = {"of": of, "by": by}
    for i, name in enumerate(NAMES):
        row[name] = f"{right[place == i].sum()}/{(place == i).sum()}"
    for name, some in (("wrong", ~right), ("right", right)):
        row[f"{name} below 0.5"] = f"{(confidence[some] < 0.5).sum()}/{some.sum()}"
    return row
