"""What the library calls its functions and arguments, in the words of the command line."""

from __future__ import annotations

import difflib
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

from spectra_kit.catalogue import OPERATORS, SOLVERS

_OPTIONS = {
    "k": "-k",
    "n_points": "--points",
    **{name: f"--{name}" for name in ("modes", "rtol", "seed", "dpi", "turn", "landmarks")},
    "name_or_path": "--weights",
    "coordinate": "--at",
    "mesh.without_unreferenced()": "--repair",
    "mesh.without_degenerate_faces()": "--repair",
    "mesh.without_duplicate_faces()": "--repair",
    "mesh.with_merged_vertices()": "--repair",
    "cloud.without_duplicates()": "--repair",
    **{f"{name}_laplacian": f"--operator {name}" for name in OPERATORS},
    **{name.capitalize(): f"--solver {name}" for name in SOLVERS},
    # What no command can be told.
    **dict.fromkeys(("max_steps", "max_sweeps", "max_restarts", "max_points", "tol"), ""),
    'kind="cloud"': "",
}


@runtime_checkable
class _Told(Protocol):
    def told(self, word: Callable[[str], str]) -> str: ...


def option_of(name: str) -> str:
    """Return the option that stands for an argument, a method or a class; or its name.

    Nothing stands for what no command can be told.

    Examples
    --------
    >>> from spectra_kit.cli.words import option_of
    >>> from spectra_kit.errors import InvalidInputError
    >>> InvalidInputError("k", "be at least 1", 0).told(option_of)
    '`-k` must be at least 1, got 0'
    """
    return _OPTIONS.get(name, name)


def told(message: object) -> str:
    """Return an error, a warning or a problem with options in place of arguments and methods."""
    # A warning may be another package's.
    return message.told(option_of) if isinstance(message, _Told) else str(message)


def stem(file: str) -> str:
    r"""Return the name of a file for a title: no folder, no ending, bytes of no text as such.

    Examples
    --------
    >>> from spectra_kit.cli.words import stem
    >>> print(stem("cats/b\udcffb.off"))
    b\xffb
    """
    return os.fsencode(Path(file).stem).decode(errors="backslashreplace")


def did_you_mean(wrong: str, known: Sequence[str]) -> str:
    """Return "did you mean ...?" with the likeliest of `known`, or nothing if none is near."""
    near = difflib.get_close_matches(wrong, known, n=1)
    return f"did you mean {near[0]!r}?" if near else ""


def listed(names: Sequence[str]) -> str:
    """Return ``a, b and c``."""
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))
