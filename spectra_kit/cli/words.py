"""What the library calls its functions and arguments, in the words of the command line."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from spectra_kit.catalogue import OPERATORS, SOLVERS

_SOLVED = ("accuracy", "modes", "rtol", "seed", "operator", "boundary", "cloud", "descriptors")
_SHOWN = ("dpi", "turn", "landmarks", "initial")
_MANY = ("nworkers", "nthreads", "memory_limit", "scheduler", "scheduler_file")  # of Dask
_OPTIONS = {
    "k": "-k",
    "plan": "-k",
    "n_points": "--points",
    **{name: f"--{name.replace('_', '-')}" for name in _SOLVED + _SHOWN + _MANY},
    "name_or_path": "--weights",
    "coordinate": "--at",
    "mesh.without_unreferenced()": "--repair",
    "mesh.without_degenerate_faces()": "--repair",
    "mesh.without_duplicate_faces()": "--repair",
    "mesh.with_merged_vertices()": "--repair",
    "geometry.repair(mesh)": "--repair",
    "Plan(repair=True)": "--repair",
    "geometry.largest_component(mesh)": "--largest",
    "maps.match_components": "match --components",
    "cloud.without_duplicates()": "--repair",
    "geometry.without_nan()": "--repair",
    "exact_distances": "--method auto, without --spectrum, --solver and --compare",
    **{f"{name}_laplacian": f"--operator {name}" for name in OPERATORS},
    **{name.capitalize(): f"--solver {name}" for name in SOLVERS},
    # What no command can be told.
    **dict.fromkeys(
        ("max_steps", "max_sweeps", "max_restarts", "max_shifts", "max_points", "tol"), ""
    ),
    'kind="cloud"': "",
}


def option_of(name: str) -> str:
    """Return the option that stands for an argument, a method or a class; or its name.

    Nothing stands for what no command can be told.
    """
    return _OPTIONS.get(name, name)


def told(message: object) -> str:
    """Return an error, a warning or a problem with options in place of arguments and methods."""
    tell = getattr(message, "told", None)
    return str(tell(option_of) if tell else message)  # a warning may be another package's


def stem(file: str) -> str:
    """Return the name of a file for a title: no folder, no ending, bytes of no text as such."""
    return os.fsencode(Path(file).stem).decode(errors="backslashreplace")


def listed(names: Sequence[str]) -> str:
    """Return ``a, b and c``."""
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))
