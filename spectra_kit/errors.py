"""Exceptions and warnings of spectra_kit: `SpectraKitError`, `SpectraKitWarning` and theirs.

Each error also derives from the builtin a caller would expect, so ``except ValueError`` keeps
working. A message names the argument, what was expected, what arrived, and what to do next.
Warnings are about results that are returned all the same; `warnings.filterwarnings` silences them,
or makes them errors.
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
        From `eigensolve`: the modes there were, certified, so that each tells how far it came; None
        where there were none. From `linalg.pcg`: the last iterate, with its residuals.
    n_converged : int or None
        From `eigensolve`: how many modes of `partial` had reached the tolerance.
    """

    def __init__(
        self, message: str, *, partial: Any = None, n_converged: int | None = None
    ) -> None:
        super().__init__(message, partial=partial)
        self.n_converged = n_converged


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


class SpectraKitWarning(UserWarning):
    """Base class of every warning spectra_kit gives on purpose."""


class DoubtfulSpectrumWarning(SpectraKitWarning):
    """Eigenvalues of an approximate solver are proved to be far too high."""


class DoubtfulDistanceWarning(SpectraKitWarning):
    """Geodesic distances are blurred, or cannot be told from the heat that they are read from."""


class DoubtfulMatchWarning(SpectraKitWarning):
    """A map between two surfaces is no better than one between shapes that do not correspond."""
