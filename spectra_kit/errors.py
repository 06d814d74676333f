"""Exceptions of spectra_kit; every one derives from `SpectraKitError`.

Each also derives from the builtin a caller would expect, so ``except ValueError`` keeps working.
A message names the argument, what was expected, what arrived, and what to do next.
"""

from __future__ import annotations

from typing import Any


class SpectraKitError(Exception):
    """Base class of every error spectra_kit raises on purpose."""


class InvalidInputError(SpectraKitError, ValueError):
    """An argument, or the content of a file, has the wrong shape, type or values."""


class InvalidSpectrumError(SpectraKitError, RuntimeError):
    """A solver returned pairs that break the invariants of `Spectrum`."""


class _PartialError(SpectraKitError):
    """A failure that hands over what had been computed before it.

    What that is depends on the solver, which its caller knows: hence `Any`.
    """

    def __init__(self, message: str, *, partial: Any = None) -> None:
        super().__init__(message)
        self.partial = partial


class ConvergenceError(_PartialError, RuntimeError):
    """An iterative solver stopped short of its tolerance.

    Attributes
    ----------
    partial : Spectrum or LinearSolution or None
        From `eigensolve`: the certified modes that had converged; None where there were none.
        From `linalg.pcg`: the last iterate, with its residuals.
    """


class OutOfMemoryError(_PartialError, MemoryError):
    """A computation needs more memory than there is; the message names one that needs less.

    Attributes
    ----------
    partial : Spectrum or None
        From `eigensolve`: the certified modes of the components that were solved before; None
        where there were none.
    """


class MissingDependencyError(SpectraKitError, ImportError):
    """An optional package is needed for this call and is not installed."""


class WeightsError(SpectraKitError, RuntimeError):
    """A weights file is missing, damaged, or does not fit the network."""
