"""How likely a map is right: a logistic of what can be seen of it.

Fitted by maximum likelihood to `match` of 296 pairs whose truth is known (bodies of FAUST and
SCAPE, animals of SMAL and TOSCA; right is a mean error below 8 hundredths of the root of the area)
and to 30 pairs of a body and an animal, which have no right map, so weighted that right maps and
wrong ones count alike: a map of 0.5 is as often right as wrong where both are as frequent. By
ten-fold cross-validation 52 of the 54 wrong maps had less than 0.5 (22 of the 24 that have a right
one), and 20 of 272 right ones.
"""

from __future__ import annotations

import numpy as np

_WEIGHTS = {"score": -0.98, "torn": -2.13, "margin": 13.55, "coverage": 10.29}
_INTERCEPT = -23.83
_LEAST = 1e-3  # added to the share that is torn
_SEEN = -5.0  # its logarithm where it is not known: says neither yes nor no
# Of what right maps hardly ever have, and which was not fitted for want of them: one to fifty.
_AGAINST = -4.0
_MARGINS, _COVERAGES = (-0.1, 0.3), (0.8, 1.6)  # beyond which more says no more


def confidence_of(
    *,
    score: float,
    torn: float | None,
    margin: float | None,
    coverage: float,
    against: int = 0,
) -> float:
    """Return how likely a map with such attributes of `Match` is right, in [0, 1].

    Without a margin, as of a map that was compared with no other, as if a rival scored as well.
    `against` counts the doubts that right maps of bodies and animals hardly ever raise: an unclear
    orientation, and other genera.
    """
    evidence = {
        "score": np.log(score),
        "torn": _SEEN if torn is None else np.log(torn + _LEAST),
        "margin": 0.0 if margin is None else np.clip(np.log(max(margin, 1e-9)), *_MARGINS),
        "coverage": np.clip(coverage, *_COVERAGES),
    }
    logit = _INTERCEPT + sum(_WEIGHTS[name] * value for name, value in evidence.items())
    logit += _AGAINST * against
    return float(1 / (1 + np.exp(-logit)))
