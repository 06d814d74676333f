"""The ``spectra-kit`` command.

``spectra-kit spectrum FILE`` solves and saves, ``spectra-kit compare FILE`` sets a prediction
beside the exact modes, ``spectra-kit match SOURCE TARGET`` finds corresponding points,
``spectra-kit geodesic FILE`` measures distances along a surface, ``spectra-kit info FILE`` says
what a file holds. Exit codes: 0 fine, 2 wrong usage or bad input, 3 a solver failed, 130
interrupted.
"""

from spectra_kit.cli.commands import compare
from spectra_kit.cli.entry import main, run
from spectra_kit.cli.geodesic import geodesic_distances
from spectra_kit.cli.geodesic_options import add_geodesic_arguments
from spectra_kit.cli.match import match_shapes
from spectra_kit.cli.options import add_compare_arguments, add_match_arguments

__all__ = [
    "add_compare_arguments",
    "add_geodesic_arguments",
    "add_match_arguments",
    "compare",
    "geodesic_distances",
    "main",
    "match_shapes",
    "run",
]
