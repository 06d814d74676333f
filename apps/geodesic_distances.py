"""Measure geodesic distances on a mesh or cloud, and draw their isolines.

    python apps/geodesic_distances.py                # a demo animal
    python apps/geodesic_distances.py bunny.ply --source 0 1200 -o from_two
    python apps/geodesic_distances.py bunny.ply --at 0.1 0.2 0.0 --farthest 3
    python apps/geodesic_distances.py bunny.ply --farthest 1 --compare

Writes into one folder: distance.npy (one number for each point), distance.ply
(the geometry in colours, with the distance as its quality, which MeshLab
shows), report.json, and field.png, the distance with isolines from two sides.
With --compare also convergence.png: how the solvers of the Poisson step
converge by iterations and by the clock, every stage counted.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from spectra_kit.cli import Parser, add_geodesic_arguments, geodesic_distances, run


def main(argv: Sequence[str] | None = None) -> int:
    """Measure the distances and return the exit code."""
    parser = Parser(
        "geodesic_distances.py", usage="%(prog)s [FILE] [options]", purpose=__doc__ or ""
    )
    add_geodesic_arguments(parser, file="demo", output="geodesic_distances")
    return run(geodesic_distances, parser.parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
