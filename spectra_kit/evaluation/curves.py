"""How a network's error fell while it was trained, from the record in its weights file."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spectra_kit._types import Floats
from spectra_kit._validate import frozen
from spectra_kit.errors import InvalidInputError
from spectra_kit.evaluation.methods import Weights
from spectra_kit.neo.pretrained import load_pretrained


@dataclass(frozen=True, eq=False, kw_only=True)
class Curve:
    """Validations of one network.

    Attributes
    ----------
    name : str
        Of the weights.
    m : int
        Functions that the network predicts.
    samples : ndarray of shape (r,)
        Seen before each validation, positive and ascending.
    errors : ndarray of shape (r,)
        Mean span error of each.
    """

    name: str
    m: int
    samples: Floats
    errors: Floats

    @property
    def exponent(self) -> float:
        """Slope between first and last validation, logarithm over logarithm; NaN for one alone."""
        if len(self.samples) < 2:
            return float("nan")
        fall = np.log(self.errors[-1] / self.errors[0])
        return float(fall / np.log(self.samples[-1] / self.samples[0]))


def training_curve(weights: Weights) -> Curve:
    """Read the validations in a weights file.

    Parameters
    ----------
    weights : Weights
        Which network.

    Returns
    -------
    Curve
        Those of its last run; a leg counts the samples of the runs before it too.

    Raises
    ------
    InvalidInputError
        If the file records no validation.

    Examples
    --------
    >>> from spectra_kit.evaluation import Weights, training_curve
    >>> curve = training_curve(Weights("small"))
    >>> bool(curve.errors[-1] < curve.errors[0])
    True
    """
    found = load_pretrained(weights.source)
    rows = [row for row in found.record.get("history", []) if row.get("validation")]
    if not rows:
        raise InvalidInputError(
            f"`weights` must hold the validations of their training, found none in {weights.source}"
            "; train with validation samples"
        )
    samples, errors = np.array([[row["samples"], row["validation"]] for row in rows], float).T
    return Curve(
        name=weights.label, m=found.config.m, samples=frozen(samples), errors=frozen(errors)
    )
