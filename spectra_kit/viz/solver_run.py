"""`SolverRun`: the seconds and residuals of one solver."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from spectra_kit._checked import checked
from spectra_kit._types import Floats
from spectra_kit._validate import Brief, frozen, real_array
from spectra_kit.errors import InvalidInputError


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class SolverRun(Brief):
    """One solver at work: what it did before its first iteration, and its residuals since.

    Attributes
    ----------
    name : str
        Of the solver.
    stages : mapping of str to float
        Seconds of what comes before the iterations, in this order.
    spectrum_seconds : float, default 0
        Seconds that the modes took which it uses; 0 if it uses none.
    times : ndarray of shape (i,)
        Seconds from the start of the solve to when each residual was known, ascending.
    residuals : ndarray of shape (i,)
        Relative residuals: at the start and after each iteration, or of a direct solver the one
        that it ends with. Without any, only the seconds are drawn.

    Raises
    ------
    InvalidInputError
        If `times` are not ascending, or not as many as `residuals`.
    """

    name: str
    stages: Mapping[str, float]
    spectrum_seconds: float = 0.0
    times: Floats = field(default_factory=lambda: np.zeros(0))
    residuals: Floats = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        times = real_array("times", self.times)
        residuals = real_array("residuals", self.residuals)
        if times.ndim != 1 or residuals.shape != times.shape or (np.diff(times) < 0).any():
            raise InvalidInputError(
                "times",
                "be ascending seconds, one for each of `residuals`",
                f"shapes {times.shape} and {residuals.shape}",
            )
        object.__setattr__(self, "times", frozen(times))
        object.__setattr__(self, "residuals", frozen(residuals))

    @property
    def start(self) -> float:
        """Seconds before the iterations, those of the spectrum left out."""
        return float(sum(self.stages.values()))

    @property
    def seconds(self) -> float:
        """Seconds in all, those of the spectrum left out."""
        return self.start + self.solve_seconds

    @property
    def solve_seconds(self) -> float:
        """Seconds of the iterations."""
        return float(self.times[-1]) if len(self.times) else 0.0

    @property
    def iterations(self) -> int | None:
        """How many there were; None for a solver that has none."""
        count = len(self.residuals)
        return count - 1 if count > 1 else None
