"""Exceptions and warnings of spectra_kit: `SpectraKitError`, `SpectraKitWarning` and theirs.

Each error also derives from the builtin a caller would expect, so ``except ValueError`` keeps
working. A message names the argument, what was expected, what arrived, and what to do next.
Warnings are about results that are returned all the same; `warnings.filterwarnings` silences them,
or makes them errors.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

Advice = str | tuple[str, ...]


class _Advised(Exception):  # noqa: N818  # the part that errors and warnings share
    """What was found, and what to do about it, apart: so that it can be told in other words."""

    where = ""  # which of several things it is about, as ``laplacians[3]``

    def __init__(self, *facts: object, advice: Advice = "", remedies: tuple[str, ...] = ()) -> None:
        super().__init__(*facts)
        self.advice, self.remedies = advice, remedies

    def told(self, word: Callable[[str], str] = str) -> str:
        """Return one line, with `word` applied to each argument and call that it names.

        `word` takes a name as Python has it and returns what its reader calls it, as the command
        line does. Where it returns nothing, that alternative is left out.
        """
        message = "; ".join(filter(None, (self._finding(word), self._advised(word))))
        return f"{self.where}: {message}" if self.where else message

    def _advised(self, word: Callable[[str], str]) -> str:
        words = map(word, self.remedies)
        if isinstance(self.advice, str):
            return self.advice.format(*words) if self.remedies else self.advice
        pairs = zip(self.advice, words, strict=True)
        *others, last = [""] + [text.format(known) for text, known in pairs if known]
        return ", ".join([*others[1:], f"or {last}" if others[1:] else last])

    def _finding(self, word: Callable[[str], str]) -> str:
        return " ".join(map(str, self.args))

    def __str__(self) -> str:
        return self.told()


class SpectraKitError(_Advised):
    """Base class of every error spectra_kit raises on purpose.

    Attributes
    ----------
    advice : str or tuple of str
        What to do next; ``{}`` stands where each of the `remedies` is named. Of a tuple, the
        alternatives, each has one.
    remedies : tuple of str
        The arguments and calls that the advice names, as Python has them.
    where : str
        Which of several things it is about, where a call was given many; empty elsewhere.
    """


class _ArgumentError(SpectraKitError):
    """An argument is not what it must be; see `InvalidInputError`."""

    def __init__(
        self,
        argument: str,
        expected: str = "",
        got: object = "",
        *,
        advice: Advice = "",
        remedies: tuple[str, ...] = (),
    ) -> None:
        super().__init__(argument, expected, got, advice=advice, remedies=remedies)
        self.argument, self.expected, self.got = argument, expected, got

    def _finding(self, word: Callable[[str], str]) -> str:
        if not self.expected:
            return self.argument
        got = "" if self.got == "" else f", got {self.got}"
        return f"`{word(self.argument)}` must {self.expected}{got}"


class InvalidInputError(_ArgumentError, ValueError):
    """An argument, or the content of a file, has the wrong shape, type or values.

    Parameters
    ----------
    argument : str
        Its name; or, if nothing else is given, a sentence about what is no argument.
    expected : str, optional
        What it must be or do: "be positive", "have shape (n, 3)".
    got : object, optional
        What arrived, as it is to be shown.
    advice : str or tuple of str, optional
        As in `SpectraKitError`.
    remedies : tuple of str, optional
        As in `SpectraKitError`.

    Examples
    --------
    >>> from spectra_kit.errors import InvalidInputError
    >>> error = InvalidInputError(
    ...     "mass", "be positive", "3 entries <= 0", advice="drop them with {}",
    ...     remedies=("mesh.without_unreferenced()",),
    ... )
    >>> print(error)
    `mass` must be positive, got 3 entries <= 0; drop them with mesh.without_unreferenced()
    >>> print(error.told({"mesh.without_unreferenced()": "--repair", "mass": "mass"}.get))
    `mass` must be positive, got 3 entries <= 0; drop them with --repair
    """


class InvalidFileError(InvalidInputError):
    """A file is not there, or does not hold what it must.

    Parameters
    ----------
    path : path-like
        The file.
    problem : InvalidInputError or str
        What is wrong with its content, whose argument, expectation and advice this error takes on.

    Examples
    --------
    >>> from spectra_kit.errors import InvalidFileError
    >>> error = InvalidFileError("a.off", "the file is empty")
    >>> print(error)
    a.off: the file is empty
    >>> print(error.problem)
    the file is empty
    """

    def __init__(self, path: str | os.PathLike[str], problem: InvalidInputError | str) -> None:
        if isinstance(problem, str):
            problem = InvalidInputError(problem)
        super().__init__(
            problem.argument,
            problem.expected,
            problem.got,
            advice=problem.advice,
            remedies=problem.remedies,
        )
        self.path, self.problem = path, problem
        self.args = (path, problem)  # with which pickle makes it again

    def _finding(self, word: Callable[[str], str]) -> str:
        return f"{os.fspath(self.path)}: {super()._finding(word)}"


class InvalidSpectrumError(_ArgumentError, RuntimeError):
    """A solver returned pairs that break the invariants of `Spectrum`."""


class _PartialError(SpectraKitError):
    """A failure that hands over what had been computed before it.

    What that is depends on the solver, which its caller knows: hence `Any`.
    """

    def __init__(self, message: str, *, partial: Any = None, **advised: Any) -> None:
        super().__init__(message, **advised)
        self.partial = partial


class ConvergenceError(_PartialError, RuntimeError):
    """An iterative solver stopped short of its tolerance.

    Attributes
    ----------
    partial : Spectrum or LinearSolution or None
        From `eigensolve`: the modes there were, certified, so that each tells how far it came; None
        where there were none. From `_sparse.pcg`: the last iterate, with its residuals.
    n_converged : int or None
        From `eigensolve`: how many modes of `partial` had reached the tolerance.
    """

    def __init__(
        self, message: str, *, partial: Any = None, n_converged: int | None = None, **advised: Any
    ) -> None:
        super().__init__(message, partial=partial, **advised)
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


class StoreError(SpectraKitError, OSError):
    """A store cannot be written: the disk is full, or not ours to write to."""


class WorkerError(SpectraKitError, RuntimeError):
    """A process that worked for this one has died."""


class EngineLostError(SpectraKitError, ConnectionError):
    """The scheduler of a run cannot be reached any more."""


class SpectraKitWarning(_Advised, UserWarning):
    """Base class of every warning spectra_kit gives on purpose; with advice as errors have it."""


class IgnoredContentWarning(SpectraKitWarning):
    """A file or object holds more than was taken from it; the message says what was passed over."""


class SplitSurfaceWarning(SpectraKitWarning):
    """A surface falls into parts that touch, or nearly do, as along seams or between scan lines."""


class DoubtfulSpectrumWarning(SpectraKitWarning):
    """Eigenvalues of an approximate solver are proved to be far too high."""


class DoubtfulDistanceWarning(SpectraKitWarning):
    """Geodesic distances are blurred, or cannot be told from the heat that they are read from."""


class DoubtfulCurvatureWarning(SpectraKitWarning):
    """Curvature is not known at some points, and NaN there; or its sign is in doubt."""


class DoubtfulMatchWarning(SpectraKitWarning):
    """A map between two surfaces is no better than one between shapes that do not correspond.

    Or what tells left from right is in doubt: which side of a surface is out.
    """


class AmbiguousModesWarning(SpectraKitWarning):
    """Modes leave a choice: others have about the same eigenvalue, or another cut is as good."""


class DamagedEntryWarning(SpectraKitWarning):
    """An entry of a store is damaged, and computed again, or left out."""
