"""The ``spectra-kit`` command; ``spectra-kit --help`` tells what it does.

Exit codes: 0 fine, 1 a bug of ours, 2 wrong usage or bad input or output, 3 a solver failed, 130
interrupted.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from spectra_kit.cli.arguments import add_compare_arguments, add_match_arguments
from spectra_kit.cli.entry import main, run
from spectra_kit.cli.geodesic_options import add_geodesic_arguments
from spectra_kit.cli.parser import Parser

if TYPE_CHECKING:
    from spectra_kit.cli.commands import compare
    from spectra_kit.cli.geodesic import geodesic_distances
    from spectra_kit.cli.match import match_shapes

__all__ = [
    "Parser",
    "add_compare_arguments",
    "add_geodesic_arguments",
    "add_match_arguments",
    "compare",
    "geodesic_distances",
    "main",
    "match_shapes",
    "run",
]

# Imported when they are asked for: reading a command line needs none of what commands do.
_HOMES = {"compare": "commands", "geodesic_distances": "geodesic", "match_shapes": "match"}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
