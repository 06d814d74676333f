"""Draw chosen modes of a shape: exact | predicted | difference; print a table.

    python apps/compare_modes.py                     # a demo animal
    python apps/compare_modes.py bunny.obj -o bunny.png
    python apps/compare_modes.py bunny.obj --solver polished --modes 1,5,20

The options are those of spectra-kit compare.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from spectra_kit.cli import Parser, add_compare_arguments, compare, run


def main(argv: Sequence[str] | None = None) -> int:
    """Run the comparison and return the exit code."""
    parser = Parser(
        "compare_modes.py", usage="%(prog)s [FILE] [options]", purpose=(__doc__ or "").strip()
    )
    add_compare_arguments(parser, file="demo", picture="compare_modes.png")
    return run(compare, parser.parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
