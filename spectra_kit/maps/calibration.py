"""What was fitted to pairs whose truth is known: scores, confidence, and the limits of doubt.

**Scores** are weighted geometric means of mismatches; the weights were chosen on bodies of FAUST
and SCAPE and animals of SMAL and TOSCA.

**Confidence** is a logistic of what can be seen of a map, fitted by maximum likelihood to `match`
of 338 pairs whose truth is known (bodies of FAUST and SCAPE, animals of SMAL and TOSCA; right is a
mean error below 8 hundredths of the root of the area) and to 24 pairs of a body and an animal,
which have no right map, so weighted that right maps and wrong ones count alike: a map of 0.5 is as
often right as wrong where both are as frequent. The weight of the score was held: once neighbours
that are torn apart are known, it tells little of these pairs, and more of what is unlike them. By
ten-fold cross-validation 49 of the 53 wrong maps had less than 0.5 (25 of the 29 that have a right
one), and 25 of 309 right ones, 24 of them animals; none of the 64 pairs of SHREC'19, all right.
The intercept is raised by 0.5 beyond what was fitted: right maps of clouds, whose samples are
uneven, tear more than those of meshes. As many wrong ones are below 0.5, and 19 right ones.

**Confidence at points** is a logistic of how sure the whole map is, and of what is seen around each
point. Fitted by maximum likelihood to 22,500 points of 75 pairs (30 of SMAL, 15 each of SCAPE,
FAUST and TOSCA); a point is right within 8 hundredths of the root of the area. By eight-fold
cross-validation over pairs, a right point had more confidence than a wrong one in 88 of 100 cases,
85 within maps that are right as a whole; of points above 0.9, 97.7 % were right.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from spectra_kit._core.types import Floats

# --- scores ---------------------------------------------------------------------------------------

#: Exponents of the mismatches in a score; those of a kind that is absent are left out.
SCORE = {
    "curvature": 3.0,
    "wave": 0.1,
    "spacing": 0.5,
    "embedding": 0.2,
    "orientation": 0.2,
    "alignment": 0.5,
    "lengths": 1.0,
    "landmarks": 2.0,
}
_LEAST_MISMATCH = 1e-3  # below which mismatches count as equally good

# --- limits ---------------------------------------------------------------------------------------

#: Below which a match is ambiguous, as a rival scored as well: so it was for 31 of 309 right maps
#: of bodies and animals, and for 19 of 29 wrong ones.
CLEAR_MARGIN = 1.01
#: How many times better a map of the other orientation must be to raise doubts: it was up to 1.16
#: times better for right ones.
DOUBTFUL_MIRROR = 1.1
#: Size of the orientation below which a map may be flipped in parts: right ones had 0.7 and more.
CLEAR_ORIENTATION = 0.5
#: Share of the triangles that agree below which it is in doubt which side of a cloud is out.
CLEAR_SIDES = 0.9
#: Above which a score speaks against the map: unrelated shapes had 0.44 and more, nine of ten right
#: maps 0.37 and less.
CONVINCING_SCORE = 0.42
#: Above which it is no part: the best of many regions is better than a map of wholes.
CONVINCING_PART = 0.4
#: The same of the share that is torn: unrelated shapes had 0.014 and more, nine of ten right maps
#: 0.004 and less.
CONVINCING_DISCONTINUITY = 0.01
#: Below which coverage speaks against the map: all right maps had more.
CONVINCING_COVERAGE = 1.1

# --- confidence -----------------------------------------------------------------------------------

_WHOLE = {"score": -0.98, "discontinuity": -2.54, "margin": 23.49, "coverage": 1.34}
_WHOLE_INTERCEPT = -16.12
_LEAST = 1e-3  # added to what a logarithm is taken of
_SEEN = -6.2  # the logarithm of a share that is not known: says neither yes nor no
# Not fitted: an unclear orientation, which right maps hardly ever have, counts one to fifty; other
# genera, which those of bodies have whose hands touch them, one to five.
_AGAINST = {"orientation": -4.0, "genera": -1.6}
_MARGINS, _COVERAGES = (-0.1, 0.3), (0.8, 1.6)  # beyond which more says no more

_POINT = {"whole": 0.192, "wave": -1.073, "curvature": -0.294, "stretch": -1.225}
_POINT_INTERCEPT = -1.051
_WHOLE_ODDS = (-4.0, 6.0)  # log-odds of the whole map, beyond which more says no more


def score_of(mismatches: Mapping[str, float]) -> float:
    """Return the weighted geometric mean of mismatches: the lower, the better, at least 0.001."""
    total = sum(SCORE[name] for name in mismatches)
    logs = sum(
        SCORE[name] * np.log(max(value, 0.0) + _LEAST_MISMATCH)
        for name, value in mismatches.items()
    )
    return float(np.exp(logs / total))


def confidence_of(
    *,
    score: float,
    discontinuity: float | None,
    margin: float | None,
    coverage: float,
    against: Iterable[str] = (),
) -> float:
    """Return how likely a map with such attributes of `Match` is right, in [0, 1].

    Without a margin, as of a map that was compared with no other, as if a rival scored as well.
    `against` are doubts; those about orientation and genera count, as right maps of bodies and
    animals raise them seldom.
    """
    evidence = evidence_of(score, discontinuity, margin, coverage)
    logit = _WHOLE_INTERCEPT + sum(_WHOLE[name] * value for name, value in evidence.items())
    logit += sum(_AGAINST.get(doubt, 0.0) for doubt in against)
    return float(1 / (1 + np.exp(-logit)))


def evidence_of(
    score: float, discontinuity: float | None, margin: float | None, coverage: float
) -> dict[str, float]:
    """Return what the confidence of a map is linear in, but for a logistic."""
    return {
        "score": np.log(score),
        "discontinuity": _SEEN if discontinuity is None else np.log(discontinuity + _LEAST),
        "margin": 0.0 if margin is None else np.clip(np.log(max(margin, 1e-9)), *_MARGINS),
        "coverage": np.clip(coverage, *_COVERAGES),
    }


def confidence_at(whole: float, wave: Floats, curvature: Floats, stretch: Floats) -> Floats:
    """Return how likely each point is in its place, by what is seen around it, (n,).

    `whole` is the confidence of the map; signatures and curvatures differ so much, and edges are
    so stretched, where they are averaged over neighbours.
    """
    evidence = evidence_at(whole, wave, curvature, stretch)
    logit = _POINT_INTERCEPT + evidence @ np.array(list(_POINT.values()))
    return np.asarray(1 / (1 + np.exp(-logit)))


def evidence_at(whole: float, wave: Floats, curvature: Floats, stretch: Floats) -> Floats:
    """Return what the confidence of points is linear in, but for a logistic, (n, 4)."""
    sure = np.clip(whole, 1e-12, 1 - 1e-12)
    odds = np.clip(np.log(sure / (1 - sure)), *_WHOLE_ODDS)
    seen = np.log(np.column_stack([wave, curvature, stretch]) + _LEAST)
    return np.column_stack([np.full(len(seen), odds), seen])
