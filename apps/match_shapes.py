"""Match two meshes or clouds: find the source point of each target point.

    python apps/match_shapes.py                    # a demo animal in two poses
    python apps/match_shapes.py cat.off lion.off -o cat_to_lion
    python apps/match_shapes.py cat.off lion.off --landmarks pairs.txt

Writes into one folder: point_map.npy (the source point of each target point),
functional_map.npy, report.json (what can be said of the map, and its error
where the truth is given), a picture of the source in colours and of the target
in those that the map gives it, and one of the functional map.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from spectra_kit.cli import Parser, add_match_arguments, match_shapes, run


def main(argv: Sequence[str] | None = None) -> int:
    """Run the match and return the exit code."""
    parser = Parser(
        "match_shapes.py", usage="%(prog)s [SOURCE TARGET] [options]", purpose=__doc__ or ""
    )
    add_match_arguments(parser, files=("demo", "demo"), output="match_shapes")
    return run(match_shapes, parser.parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
